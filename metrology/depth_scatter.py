"""Fringes in two cameras: where depths scatter farther than the frames' noise makes them.

σ of depths follows from the noise of the frames. Errors that are no noise of a frame (the projector's own pixels
between those of the cameras, light thrown from one part to another) are seen by both cameras at other places, and move
depths from pixel to pixel. Third differences tell them from the surface, whose bending grows with the third power of
the distance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrology.arrays import Float32
from metrology.robust import MAD
from metrology.stripe_scatter import BLOCK, by_block, differences, without_bending

_APART = (6, 9)  # pixels: no farther than the match takes pixels together, plus one; and half as far again
_EVERY = 4  # rows that tell it
_FIRST_LOOK = 16  # rows that tell whether there is anything to be told
_LEAST_SEEN = 0.68  # of the values in a block (700 of 1024): fewer would tell its scatter to worse than a tenth
_LEAST = 1.2  # of σ: what is below is left as it is


def raised_sigma(points: Float32, sigma_z: Float32, flags: NDArray[np.uint16], along_rows: bool) -> Float32:
    """σ of depths, raised block by block where depths scatter 1.2 times as far and more, as most of the picture does.

    Parameters
    ----------
    points : (h, w, 3) float32, mm
    sigma_z : (h, w) float32, mm
    flags : (h, w) uint16
    along_rows : bool
        Whether the coordinate changes along the image's rows: there the errors change.

    Returns
    -------
    (h, w) float32, mm
    """
    if not along_rows:
        return np.ascontiguousarray(raised_sigma(points.transpose(1, 0, 2), sigma_z.T, flags.T, True).T)
    told = [off[np.isfinite(off)] for off in _off(points, sigma_z, flags, _FIRST_LOOK)]
    # A dent or a joint alone bends more than the model of bending takes off.
    if not all(off.size for off in told) or _scatter(*(MAD * np.median(off) for off in told)) < _LEAST:
        return sigma_z
    least = int(_LEAST_SEEN * BLOCK**2 / _EVERY)
    ratio = _scatter(*(by_block(off[None], _EVERY, least) for off in _off(points, sigma_z, flags, _EVERY)))
    raised = np.where(ratio >= _LEAST, ratio, 1).astype(np.float32).repeat(_EVERY, axis=0)
    return sigma_z * raised[: len(sigma_z)]


def _off(points: Float32, sigma_z: Float32, flags: NDArray[np.uint16], every: int) -> list[Float32]:
    """Third differences of depths along every so many rows, over both distances, in units of their σ."""
    good = flags[::every] == 0
    # Of a plane it runs straight along the rows.
    near = np.where(good, 1 / np.where(good, points[::every, :, 2], 1), np.nan).astype(np.float32)
    deviation = np.where(good, sigma_z[::every] * near**2, np.nan).astype(np.float32)
    return [differences(near, deviation, apart) for apart in _APART]


def _scatter(short: ArrayLike, long: ArrayLike) -> Float32:
    """What depths scatter, in units of their σ, from what third differences over both distances do."""
    return np.asarray(np.sqrt(without_bending(np.square(short), np.square(long))), np.float32)

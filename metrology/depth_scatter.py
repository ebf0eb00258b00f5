"""Fringes in two cameras: where depths scatter farther than the frames' noise makes them.

σ of depths follows from the noise of the frames. Errors that are no noise of a frame (the projector's own pixels
between those of the cameras, light thrown from one part to another) are seen by both cameras at other places, and move
depths from pixel to pixel. Third differences tell them from the surface, whose bending grows with the third power of
the distance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Float32
from metrology.stripe_scatter import by_block, third_differences

_APART = (6, 9)  # pixels: no farther than the match takes pixels together, plus one; and half as far again
_BENT = (_APART[1] / _APART[0]) ** 6  # by which a bent surface's squares grow from one distance to the other
_EVERY = 4  # rows that tell it
_LEAST_VALUES = 700  # of the 1024 in a block: fewer would tell its scatter to worse than a tenth
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
    part = np.s_[::_EVERY] if along_rows else np.s_[:, ::_EVERY]
    depth = points[..., 2][part]
    good = flags[part] == 0
    near = np.where(good, 1 / np.where(good, depth, 1), np.nan).astype(np.float32)  # of a plane straight along the rows
    deviation = np.where(good, sigma_z[part] * near**2, np.nan).astype(np.float32)
    if not along_rows:
        near, deviation = np.ascontiguousarray(near.T), np.ascontiguousarray(deviation.T)
    short, long = (
        by_block(third_differences(near, deviation, apart)[None], _EVERY, _LEAST_VALUES) ** 2 for apart in _APART
    )
    ratio = np.sqrt(np.maximum((_BENT * short - long) / (_BENT - 1), 0))
    if not np.median(ratio) >= _LEAST:  # a dent or a joint alone bends more than the model of bending takes off
        return sigma_z
    raised = np.where(ratio >= _LEAST, ratio, 1).astype(np.float32).repeat(_EVERY, axis=0)[: max(sigma_z.shape)]
    raised = raised if along_rows else raised.T
    return sigma_z * raised[: sigma_z.shape[0], : sigma_z.shape[1]]

"""Gray code alone in two cameras: what depths between stripes' borders scatter.

A border that the projector, or its scaling of the pattern, shows beside its place is seen by both cameras alike: it is
an error of the coordinate, and none of the depth. What a camera's pixels make of a blurred border is an error of the
depth, and does not show in the course of one camera's borders. So σ of depths follows from the depths themselves.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Float32
from metrology.cloud import DecodedView
from metrology.gray import runs_along_rows
from metrology.robust import MAD

# Stripes: places so far apart share no border. Several distances, since borders may err in turn: over one distance
# alone, what recurs after twice as many stripes would count three times, and what recurs after as many not at all.
_APART = (3, 4, 5)
_WINDOW = 5  # pixels that the match takes together
_THIRD = (1.0, -3.0, 3.0, -1.0)  # third differences, which no plane and no bent skin shows
BLOCK = 64  # pixels
_LEAST = 200  # differences in a block that tell its scatter


def scatter_ratio(left: DecodedView, points: Float32, sigma_z: Float32, flags: NDArray[np.uint16]) -> Float32:
    """What depths scatter, in units of `sigma_z`, block by block; 1 where nothing tells it.

    Parameters
    ----------
    left : DecodedView
        Of a code without fringes: `stripe_px` is not None.
    points : (h, w, 3) float32, mm
    sigma_z : (h, w) float32, mm
    flags : (h, w) uint16

    Returns
    -------
    (h, w) float32
    """
    assert left.stripe_px is not None
    good = flags == 0
    near = np.where(good, 1 / np.where(good, points[..., 2], 1), np.nan)  # of a plane straight along the rows
    deviation = np.where(good, sigma_z * near**2, np.nan)
    along_rows = runs_along_rows(left.coordinate)
    coordinate = left.coordinate if along_rows else left.coordinate.T
    gradient = np.abs(np.diff(coordinate[::8], axis=1))
    gradient = gradient[np.isfinite(gradient) & (gradient > 0)]
    if gradient.size == 0:
        return np.ones_like(sigma_z)
    stripe = left.stripe_px / float(np.median(gradient))
    if not along_rows:
        near, deviation = near.T, deviation.T
    off = np.stack([third_differences(near, deviation, _WINDOW + int(np.ceil(stripes * stripe))) for stripes in _APART])
    ratio = by_block(off)
    return ratio if along_rows else np.ascontiguousarray(ratio.T)


def third_differences(near: Float32, deviation: Float32, apart: int) -> Float32:
    """(h, w) sizes of third differences along rows in units of what `deviation` says of them; NaN where none."""
    height, width = near.shape
    off = np.full((height, width), np.nan, np.float32)
    length = width - 3 * apart
    if length <= 0:
        return off
    bent, expected = np.zeros((height, length), np.float32), np.zeros((height, length), np.float32)
    for k, factor in enumerate(_THIRD):
        part = np.s_[:, k * apart : k * apart + length]
        bent += np.float32(factor) * near[part]
        expected += np.float32(factor**2) * deviation[part] ** 2
    off[:, 3 * apart // 2 : 3 * apart // 2 + length] = np.abs(bent) / np.sqrt(expected)
    return off


def by_block(off: Float32, every: int = 1, least: int = _LEAST) -> Float32:
    """(h, w) standard deviation, block by block, of values with the (k, h, w) sizes; 1 where too few tell it.

    Parameters
    ----------
    every : int
        Rows of the image of which `off` has one; blocks are square in the image.
    least : int
        Values that tell a block's own; others have the whole image's.
    """
    height, width = off.shape[1:]
    told = off[np.isfinite(off)]
    if told.size < least:
        return np.ones((height, width), np.float32)
    tall = BLOCK // every
    rows, columns = -(-height // tall), -(-width // BLOCK)
    blocks = np.full((rows, columns), MAD * np.median(told), np.float32)
    for i, j in np.ndindex(rows, columns):
        block = off[:, i * tall : (i + 1) * tall, j * BLOCK : (j + 1) * BLOCK]
        seen = block[np.isfinite(block)]
        if seen.size >= least:
            blocks[i, j] = MAD * np.median(seen)
    whole = cv2.resize(blocks, (columns * BLOCK, rows * tall), interpolation=cv2.INTER_LINEAR)
    return np.asarray(whole[:height, :width], np.float32)

"""Gray code alone in two cameras: what depths between stripes' borders scatter.

A border that the projector, or its scaling of the pattern, shows beside its place is seen by both cameras alike: it is
an error of the coordinate, and none of the depth. What a camera's pixels make of a blurred border is an error of the
depth, and does not show in the course of one camera's borders. So σ of depths follows from the depths themselves.

Borders are found in every line of pixels by itself: lines a few pixels apart tell their scatter, however strong the
relief. What all of them have in common shows only across stripes, many pixels apart, and is told where the surface is
even over so many. Between borders a bent surface is taken for straight: how much it bends tells that error.
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
_LINES = (2, 3)  # pixels across the stripes' course: the match takes three lines of the right camera together
# Squared third differences over two lines are this share of those over three, of equal errors in both cameras: the
# right one's windows share a line of their three, and so half of 1/3, beside the left one's 1.
_SHARED = (1 + 1 / 6) / (1 + 1 / 3)
_WINDOW = 5  # pixels along the stripes' course that the match takes together
_EVEN = 2.0  # of the scatter between near lines: what far lines of an even surface scatter at most
# Of the scatter along the stripes' course: what far lines scatter at least where relief does it, which runs in all
# directions; errors of borders differ far less from line to line than from border to border. Where bits cross their
# inverses no level moves borders in turn; what the projector's own columns displace has 0.12 to 0.3.
_ALIKE, _ALIKE_CROSSING = 0.5, 1 / 3
_SECOND = (1.0, -2.0, 1.0)
_THIRD = (1.0, -3.0, 3.0, -1.0)  # third differences, which no plane and no bent skin shows
_BENT = 1.5**6  # by which a bent surface's squares grow from one distance to half as far again
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
    if not along_rows:
        near, deviation = near.T, deviation.T
    stripe = left.stripe_px / float(np.median(gradient))
    far = [_WINDOW + int(np.ceil(stripes * stripe)) for stripes in _APART]
    across = by_block(np.stack([differences(near, deviation, apart) for apart in far]))
    short, long, far_lines = (
        by_block(differences(near.T, deviation.T, apart).T[None]) ** 2 for apart in (*_LINES, far[0])
    )
    between = without_bending(short, long, _SHARED)
    bent = by_block(differences(near, deviation, max(1, round(stripe)), _SECOND)[None]) ** 2
    on_relief = np.minimum(across, np.sqrt(between + _interpolation(bent, between, stripe)))
    alike = _ALIKE_CROSSING if left.borders_cross else _ALIKE
    bumpy = (far_lines > _EVEN**2 * between) & (far_lines > (alike * across) ** 2)
    # Where most of the picture is relief, a part that runs one way only is relief as well.
    mostly = np.median(bumpy[::8, ::8]) > 0
    ratio = np.where(bumpy | mostly, on_relief, across).astype(np.float32)
    return ratio if along_rows else np.ascontiguousarray(ratio.T)


def without_bending(short: Float32, long: Float32, shared: float = 1.0) -> Float32:
    """Squared scatter, without what a surface bends, from squared third differences over a distance and 1.5 times it.

    Parameters
    ----------
    shared : float
        Share of the scatter over the longer distance that there is over the shorter one.
    """
    return np.maximum((_BENT * short - long) / (_BENT * shared - 1), 0)


def _interpolation(bent: Float32, between: Float32, stripe: float) -> Float32:
    """Squared error of a bent surface that is straight between borders and even within the match's window.

    Over a stripe s the depth bends by c: second differences have c² beside the scatter of border and border, which
    neighbours share. Straight lines between borders err by c t (1 − t)/2, 0 ≤ t ≤ 1; a plane through five pixels of
    the right camera by c/s² at most, which is where the projector stands beside the left one.
    """
    c2 = np.maximum(6 * bent - 4 * between, 0)
    return c2 * (1 / 120 + 1 / (6 * stripe**2) + 1 / stripe**4)


def differences(near: Float32, deviation: Float32, apart: int, factors: tuple[float, ...] = _THIRD) -> Float32:
    """(h, w) sizes of differences along rows in units of what `deviation` says of them; NaN where none."""
    height, width = near.shape
    off = np.full((height, width), np.nan, np.float32)
    span = (len(factors) - 1) * apart
    length = width - span
    if length <= 0:
        return off
    bent, expected = np.zeros((height, length), np.float32), np.zeros((height, length), np.float32)
    for k, factor in enumerate(factors):
        part = np.s_[:, k * apart : k * apart + length]
        bent += np.float32(factor) * near[part]
        expected += np.float32(factor**2) * deviation[part] ** 2
    off[:, span // 2 : span // 2 + length] = np.abs(bent) / np.sqrt(expected)
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

"""Second pictures of the fringes: reflections within a lens, or from something beside the skin, that each frame holds.

A weak copy of the fringes, displaced, adds a phasor of its own to that of every count. Its phase differs from the
skin's by 2π f Δ/W, Δ the distance between both on the projector, and so differently for each count f: the counts then
miss a common position by an amount that hardly changes from pixel to pixel. Noise averages out over a block of pixels,
and harmonics over the fringes in it. What moves while it is scanned makes counts disagree, too, but little: steps of
one count share the movement, and 15 µm of it leave one to three milliradians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.epipolar import middle_of_view
from metrology.flicker import LEAST_COUNT
from metrology.fringe import Axis
from metrology.rig import Rig
from metrology.robust import MAD

_BLOCKS = 8  # along each side of the picture
_LEAST_PIXELS = 40
_FEWEST_BLOCKS = 12
_OF_NOISE = 2.0  # the scatter of blocks that noise explains: seldom 1.5 times what is expected
_MEDIAN = np.pi / 2  # variance of a median, relative to a mean's
_STEP_MM = 1e-3
_SEEN_BY_BOTH = 0.1  # of the movement, squared, that the camera sees that sees less of it


@dataclass(frozen=True)
class Disagreement:
    """What the counts of one camera miss a common position by."""

    mean: Array
    """(counts,) over the picture, rad."""
    square: Array
    """(counts,) mean over blocks of its square, rad²."""
    noise: Array
    """(counts,) variance that noise gives it in a block, rad²."""

    def beyond_noise(self, mean: Array | None = None) -> float:
        """The root mean square over blocks in the worst count, rad, 0 where noise explains it.

        With `mean` as if what the whole picture misses by were that.
        """
        found = self.square if mean is None else self.square - self.mean**2 + mean**2
        return float(np.sqrt(np.where(found > _OF_NOISE**2 * self.noise, found - self.noise, 0.0).max()))


def disagreement(missed: Array, counts: tuple[int, ...], use: NDArray[np.bool_], rows: int) -> Disagreement | None:
    """What the counts miss a common position by, in blocks of pixels.

    Parameters
    ----------
    missed : (counts, n) ndarray
        What each count's phase misses the common position by, in turns, on a grid of so many `rows`.
    counts : tuple of int
        Fringes over the projector.
    use : (n,) bool

    Returns
    -------
    Disagreement or None
        None where too little is seen, or a count has too few fringes for a block.
    """
    if len(counts) < 2 or min(counts) < LEAST_COUNT:
        return None
    grid, good = missed.reshape(len(counts), rows, -1) * 2 * np.pi, use.reshape(rows, -1)
    columns = good.shape[1]
    middles, expected = [], []
    for top in np.array_split(np.arange(rows), _BLOCKS):
        for side in np.array_split(np.arange(columns), _BLOCKS):
            block = np.ix_(top, side)
            seen = good[block]
            if seen.sum() < max(_LEAST_PIXELS, seen.size / 2):
                continue
            values = grid[:, block[0], block[1]][:, seen]
            middle = np.median(values, axis=1)
            scatter = MAD * np.median(np.abs(values - middle[:, None]), axis=1)
            middles.append(middle)
            expected.append(_MEDIAN * scatter**2 / seen.sum())
    if len(middles) < _FEWEST_BLOCKS:
        return None
    return Disagreement(np.mean(middles, axis=0), np.square(middles).mean(0), np.mean(expected, axis=0))


def moved_by(rig: Rig, axis: Axis) -> tuple[float, float] | None:
    """By how many projector pixels the coordinate that each camera sees grows, per mm by which the skin comes nearer.

    Of a skin that faces both cameras in the middle of their view; None without a right camera or a projector.
    """
    if rig.right is None or rig.projector is None:
        return None
    cameras, place = (rig.left, rig.right), middle_of_view(rig)
    rays = np.stack([(place - camera.centre) / np.linalg.norm(place - camera.centre) for camera in cameras])
    normal = -rays.sum(0) / np.linalg.norm(rays.sum(0))
    seen = rig.projector.project(np.concatenate([place + _STEP_MM * rays / (rays @ normal)[:, None], place[None]]))
    column = seen[:, 0 if axis == "x" else 1]
    return float(column[0] - column[2]) / _STEP_MM, float(column[1] - column[2]) / _STEP_MM


def beyond_movement(left: Disagreement, right: Disagreement, moved: tuple[float, float]) -> tuple[float, float]:
    """What each camera's counts miss each other by, rad, that a movement of the skin between them does not explain.

    Both cameras see one movement, in proportion to what `moved_by` gives. Whatever else one camera alone sees is taken
    for movement in part, and is told in full here; what both see alike is told as it is.
    """
    (a, b), (ours, theirs) = moved, (left.mean, right.mean)
    weight = np.square(moved) / max(a**2 + b**2, 1e-12)
    if min(weight) < _SEEN_BY_BOTH:
        return left.beyond_noise(ours), right.beyond_noise(theirs)
    shared = (a * ours + b * theirs) / (a**2 + b**2)
    rest = (ours - a * shared) / weight[1], (theirs - b * shared) / weight[0]
    return left.beyond_noise(_lesser(ours, rest[0])), right.beyond_noise(_lesser(theirs, rest[1]))


def _lesser(one: Array, other: Array) -> Array:
    return np.where(np.abs(one) < np.abs(other), one, other)

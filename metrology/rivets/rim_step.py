"""Whether the surface steps at a ring: a head stands off the skin there or is tilted, a dent only goes on bending.

Skin and inside are fitted together, in 1/z, in which a plane is linear over the image:

    1/z = q(x, y) + [inside] (c_0 + c_1 x + c_2 y + c_3 (ℓ² − 1)) / z²

q is a quadric, ℓ the radius relative to the ring's own, x and y run from −1 to 1 across it. c_0 … c_2 are the step at
the ring itself, c_3 is a head's dome: a bowl or bump that crosses the ring smoothly has no step, whatever its depth.
Of a small ring few pixels are clear of it, and they hardly tell c_0 from c_3. Whether it steps at all is asked with a
prior of c_3: by how much inside and outside are bent differently grows with the ring's area.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.cloud import PixelFlag, Reconstruction
from metrology.rivets.ellipse import Ellipse
from metrology.robust import from_scratch

_REACH = 1.9  # radii of the skin round the ring that is looked at
_CLEAR_PX = 3.0  # from the ring, where phase is mixed
_LEAST_INSIDE = 0.5  # of the radius, where a ring is so small that nothing is clear
_ENOUGH = 800  # points inside, and outside
_FEWEST = 40
_RECESS = 5.0  # standard deviations by which the step told by all of the inside departs from that told beside the rim
_CORRELATED = 4.0  # pixels of a cloud that are worth one: matching correlates neighbours
_WAVES_MM = 0.004  # of the skin that no quadric follows
_RIM_SHARE = 0.5  # of a head's height that is at its rim; of a dent's depth nothing is
_BENT_MM = 100.0  # radius of curvature: standard deviation of the inside's bend against the skin's, the prior of c_3


@dataclass(frozen=True)
class RimStep:
    """The step of the surface at a ring."""

    mean_mm: float
    """Height of the inside over the outside, mean over the ring."""
    rise_mm: float
    """By how much that differs from the mean where it differs most: a tilt."""
    significance: float
    """Length of both over their standard deviation (χ of three components), where the inside is bent no more than the
    prior has it: above 3.4 in one flat ring of a hundred."""
    mean_significance: float
    """Size of the mean alone over its standard deviation."""

    def tells(self, height_mm: float) -> bool:
        """Whether a step of that height would show: three standard deviations do not exceed it."""
        return 3.0 * abs(self.mean_mm) <= height_mm * self.mean_significance


def steps_up(height_mm: float, step: RimStep | None) -> bool:
    """Whether a height is that of a head: at its rim it is there at once, where a dent only begins."""
    return step is not None and bool(step.mean_mm * np.sign(height_mm) > _RIM_SHARE * abs(height_mm))


def rim_step(reconstruction: Reconstruction, ellipse: Ellipse) -> RimStep | None:
    """The step at a ring; None where points are too few on either side."""
    reach = int(_REACH * ellipse.a) + 2
    height, width = reconstruction.points.shape[:2]
    rows = slice(max(0, int(ellipse.v) - reach), min(height, int(ellipse.v) + reach + 1))
    columns = slice(max(0, int(ellipse.u) - reach), min(width, int(ellipse.u) + reach + 1))
    v, u = np.mgrid[rows, columns]
    z = reconstruction.points[rows, columns, 2]
    good = np.isfinite(z) & ((reconstruction.flags[rows, columns] & np.uint16(PixelFlag.SLOPE)) == 0)
    level = ellipse.level(u, v)
    clear = _CLEAR_PX / ellipse.b
    sides = good & (level < max(1 - clear, _LEAST_INSIDE)), good & (level > 1 + clear) & (level < _REACH)
    chosen, thinned = zip(*(_thinned(side) for side in sides), strict=True)
    if min(len(part) for part in chosen) < _FEWEST:
        return None
    at = np.concatenate(chosen)
    inside = np.arange(len(at)) < len(chosen[0])
    x, y = (u.ravel()[at] - ellipse.u) / ellipse.a, (v.ravel()[at] - ellipse.v) / ellipse.a
    depth = z.ravel()[at].astype(float)
    middle = float(np.median(depth))
    heights = (1 / depth - 1 / middle) * middle**2
    one = np.ones_like(x)
    skin = np.stack([one, x, y, x * x, x * y, y * y], axis=1)
    head = np.stack([one, x, y, level.ravel()[at] ** 2 - 1], axis=1) * inside[:, None]
    design = np.hstack([head, skin])
    solved = _robust(design, heights)
    near = ~inside | (level.ravel()[at] > _LEAST_INSIDE)
    at_rim = _robust(design[near], heights[near]) if (near & inside).sum() >= _FEWEST else None
    if solved is not None and at_rim is not None:
        # Where a recess is the larger part of a head, the rest is what departs: then the top beside the rim tells.
        sd = np.sqrt(max(1.0, _CORRELATED / min(thinned)) * (solved[1][0, 0] + at_rim[1][0, 0]))
        if abs(solved[0][0] - at_rim[0][0]) > _RECESS * np.hypot(sd, _WAVES_MM):
            solved = at_rim
    if solved is None:
        return None
    solution, covariance = solved[0][:4], solved[1][:4, :4] * max(1.0, _CORRELATED / min(thinned))
    waves = _WAVES_MM**2 * np.eye(3)
    radius_mm = ellipse.radius * middle / reconstruction.rig.left.K[0, 0]
    step, spread = _with_prior(solution, covariance, radius_mm**2 / (2 * _BENT_MM))
    return RimStep(
        mean_mm=float(solution[0]),
        rise_mm=float(np.hypot(solution[1], solution[2])),
        significance=float(np.sqrt(step @ np.linalg.solve(spread + waves, step))),
        mean_significance=float(abs(solution[0]) / np.sqrt(covariance[0, 0] + _WAVES_MM**2)),
    )


def _with_prior(solution: Array, covariance: Array, dome_sd: float) -> tuple[Array, Array]:
    """The step and its covariance where the dome is 0 but for a standard deviation."""
    gain = covariance[:3, 3] / (covariance[3, 3] + dome_sd**2)
    return solution[:3] - gain * solution[3], covariance[:3, :3] - np.outer(gain, covariance[3, :3])


def _thinned(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], int]:
    """Flat indices of at most about `_ENOUGH` pixels of a mask, and every how many of them that is."""
    every = np.flatnonzero(mask)
    stride = max(1, len(every) // _ENOUGH)
    return every[::stride], stride


def _robust(design: Array, values: Array) -> tuple[Array, Array] | None:
    """Solution and covariance of least squares in which a recess, a scratch or a wrong match does not count.

    A recess may be a third of the head.
    """
    solved = from_scratch(design, values, absolute=7, iterations=12)
    if solved is None:
        return None
    squares = solved.weights * (values - design @ solved.values) ** 2
    variance = float(squares.sum() / max(solved.weights.sum() - design.shape[1], 1.0))
    try:
        return solved.values, np.asarray(np.linalg.inv(solved.normal) * variance, float)
    except np.linalg.LinAlgError:
        return None

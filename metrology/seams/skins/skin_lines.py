"""Both skin lines of a section by weighted least squares (paper §4.2: L1 and L2).

Each side has its line ``h = c_0 + c_1 x + c_2 x²``; both sides share the curvature c_2 (one skin, bent as a whole),
which a strip of a dozen millimetres on one side alone determines poorly. A slope along the seam on each side takes out
what the strip's finite length would smear.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from metrology.arrays import Array
from metrology.jit import kernel
from metrology.robust import MAD

_ROUNDS = 6
_CLIP_SIGMAS = 4.0
_MIN_SIDE_POINTS = 10
# Each side is cut into so many stretches (3.5 mm each) to see whether the residuals of neighbours go together; five of
# the seven coefficients are as coarse as that and take the stretches' common part with them.
_STRETCHES = 4
_COARSE = 5
# Median of a χ² variable of as many degrees of freedom as are left, over its mean: of many sections' clumping.
CLUMPING_MEDIAN = 0.789


class SkinFit(NamedTuple):
    """Both skin lines."""

    solution: Array
    """(7,): A's c_0, c_1, B's c_0, c_1, common c_2, slopes along the seam on A and B."""
    normal: Array
    """(7, 7): matrix of the normal equations."""
    chi: float
    """Residuals over their expected standard deviation; 1 where σ is right."""
    n_a: int
    n_b: int
    """n_a, n_b: points used."""
    clumping: float
    """Variance of the residuals' sums over a stretch of points, in units of what independent points would give."""
    stretches: Array
    """(8,): those sums, in standard deviations of what independent points would give; 0 for a stretch without points.
    """
    misfit: Array
    """(3, 8): of each stretch its number of points, their mean x and their mean residual, mm."""
    own_curvatures_step: float
    """By how much the step at x = 0 would be another if each side had a curvature of its own, mm."""

    @property
    def covariance(self) -> Array:
        """(7, 7) covariance of the solution as if the points were independent."""
        return np.asarray(np.linalg.inv(self.normal) * self.chi**2)


def fit_skin_lines(points: Array, inner_a: float, inner_b: float, max_height: float) -> SkinFit | None:
    """Both skin lines at once, outliers clipped; None where there are too few points.

    Parameters
    ----------
    points : (n, ≥4) ndarray
        x, y, h, σ_h.
    inner_a, inner_b : float
        Side A is x < inner_a, side B is x > inner_b, mm.
    max_height : float
        Points farther from h = 0 than this are not skin.
    """
    x, y, h, sigma = (np.ascontiguousarray(column) for column in points[:, :4].T)
    normal, solution, stretches = np.zeros((7, 7)), np.zeros(7), np.zeros((6, 2 * _STRETCHES))
    spread, n_a, n_b, clumping, good = _fit(x, y, h, sigma, inner_a, inner_b, max_height, normal, solution, stretches)
    if not good:
        return None
    moved = _own_curvatures_step(normal, *stretches[4:].reshape(2, 2, _STRETCHES).sum(axis=2))
    return SkinFit(solution, normal, spread, n_a, n_b, clumping, stretches[0] / spread, stretches[1:4], moved)


def _own_curvatures_step(normal: Array, fourth: Array, carried: Array) -> float:
    """By how much the step changes with one more unknown β, which adds βx² on side A and takes it off on side B.

    Parameters
    ----------
    normal : (7, 7) ndarray
    fourth, carried : (2,) ndarray
        Of either side the sums of x⁴/σ² and of x² times the residual over σ².
    """
    with_others = normal[:, 4] * np.array([1.0, 1.0, -1.0, -1.0, 0.0, 1.0, -1.0])
    with_others[4] = fourth[0] - fourth[1]
    taken = np.linalg.solve(normal, with_others)
    left = fourth.sum() - with_others @ taken
    return float((taken[0] - taken[2]) * (carried[0] - carried[1]) / left) if left > 0 else 0.0


@kernel
def _fit(x, y, h, sigma, inner_a, inner_b, max_height, normal, solution, stretches):  # type: ignore[no-untyped-def]
    """Least squares on what is kept, again and again until that does not change."""
    n = x.size
    kept, residual, sizes = np.zeros(n, np.bool_), np.zeros(n), np.empty(n)
    for i in range(n):
        kept[i] = (x[i] < inner_a or x[i] > inner_b) and abs(h[i]) < max_height
    spread, n_a, n_b = 1.0, 0, 0
    for _round in range(_ROUNDS):
        if not _solve(x, y, h, sigma, inner_a, kept, normal, solution):
            return spread, n_a, n_b, 1.0, False
        count = 0
        for i in range(n):
            a = x[i] < inner_a
            if a or x[i] > inner_b:
                k = 0 if a else 2
                fitted = solution[k] + solution[k + 1] * x[i] + solution[4] * x[i] * x[i]
                residual[i] = (h[i] - fitted - solution[5 if a else 6] * y[i]) / sigma[i]
                if kept[i]:
                    sizes[count] = abs(residual[i])
                    count += 1
        spread = MAD * np.median(sizes[:count]) + 1e-9
        n_a, n_b, changed = 0, 0, False
        for i in range(n):
            a = x[i] < inner_a
            now = (a or x[i] > inner_b) and abs(residual[i]) < _CLIP_SIGMAS * spread
            changed = changed or now != kept[i]
            kept[i] = now
            n_a += 1 if now and a else 0
            n_b += 1 if now and not a else 0
        if n_a < _MIN_SIDE_POINTS or n_b < _MIN_SIDE_POINTS:
            return spread, n_a, n_b, 1.0, False
        if not changed:
            break
    return spread, n_a, n_b, _clumping(x, sigma, inner_a, inner_b, kept, residual, stretches) / spread**2, True


@kernel
def _solve(x, y, h, sigma, inner_a, kept, normal, solution):  # type: ignore[no-untyped-def]
    """Normal equations and their solution by Cholesky; False where a side has too few points."""
    row, columns = np.empty(4), np.empty(4, np.int64)
    lower, right = np.zeros((7, 7)), np.zeros(7)
    normal[:] = 0.0
    n_a, n_b = 0, 0
    for i in range(x.size):
        if not kept[i]:
            continue
        a = x[i] < inner_a
        n_a += 1 if a else 0
        n_b += 0 if a else 1
        columns[0], columns[1], columns[2], columns[3] = 0 if a else 2, 1 if a else 3, 4, 5 if a else 6
        row[0], row[1], row[2], row[3] = 1.0, x[i], x[i] * x[i], y[i]
        weight = 1.0 / (sigma[i] * sigma[i])
        for j in range(4):
            right[columns[j]] += weight * row[j] * h[i]
            for k in range(4):
                normal[columns[j], columns[k]] += weight * row[j] * row[k]
    if n_a < _MIN_SIDE_POINTS or n_b < _MIN_SIDE_POINTS:
        return False
    for i in range(7):
        for j in range(i + 1):
            total = normal[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if not total > 1e-12 * normal[i, i]:
                    return False
                lower[i, i] = math.sqrt(total)
            else:
                lower[i, j] = total / lower[j, j]
    for i in range(7):
        total = right[i]
        for k in range(i):
            total -= lower[i, k] * solution[k]
        solution[i] = total / lower[i, i]
    for i in range(6, -1, -1):
        total = solution[i]
        for k in range(i + 1, 7):
            total -= lower[k, i] * solution[k]
        solution[i] = total / lower[i, i]
    return True


@kernel
def _clumping(x, sigma, inner_a, inner_b, kept, residual, told):  # type: ignore[no-untyped-def]
    """Mean square of the stretches' sums over their numbers of points.

    `told` gets of each stretch its sum over the root of its number of points, that number, mean x and mean residual,
    and the sums of x⁴/σ² and of x² times the residual over σ².
    """
    low, high = x.min(), x.max()
    told[:] = 0.0
    for i in range(x.size):
        if not kept[i]:
            continue
        if x[i] < inner_a:
            k = int(_STRETCHES * (inner_a - x[i]) / (inner_a - low + 1e-9))
        else:
            k = _STRETCHES + int(_STRETCHES * (x[i] - inner_b) / (high - inner_b + 1e-9))
        told[0, k] += residual[i]
        told[1, k] += 1.0
        told[2, k] += x[i]
        told[3, k] += residual[i] * sigma[i]
        told[4, k] += (x[i] * x[i] / sigma[i]) ** 2
        told[5, k] += x[i] * x[i] * residual[i] / sigma[i]
    total, used = 0.0, 0
    for k in range(2 * _STRETCHES):
        if told[1, k] > 0:
            told[0, k] /= math.sqrt(told[1, k])
            told[2, k] /= told[1, k]
            told[3, k] /= told[1, k]
            total += told[0, k] * told[0, k]
            used += 1
    return total / max(used - _COARSE, 1)

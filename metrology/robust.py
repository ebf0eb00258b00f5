"""Robust least squares: what departs far from the model that most points share does not count.

Tukey's weights need a start that is near, since they know no outlier from a wrong model. It comes of a sample that most
points agree with (RANSAC, see `surfaces`), or of least absolute deviations, which a third of outliers bends little.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array

MAD = 1.4826  # standard deviation of normal values over their median absolute deviation
# Tukey's limit in standard deviations: 95 % efficient on normal noise.
TUKEY = 4.685
# E ψ² / (E ψ')² · E w of that weight: variance against that of least squares with the weights taken for exact.
TUKEY_COVARIANCE = 0.956
TUKEY_VARIANCE = 1.217
_CONVERGED = 0.01  # change of the model, standard deviations of a point
_LEAST_OF_SCALE = 0.1  # residuals below this share of the scale weigh alike in least absolute deviations


@dataclass(frozen=True)
class Solution:
    """Coefficients of a model that is linear in them."""

    values: Array
    """(k,)."""
    weights: Array
    """(n,): 0 for outliers."""
    normal: Array
    """(k, k): Designᵀ · weights · design."""


def median(values: Array) -> float:
    """The middle value, the upper one of two: np.median's check for NaN costs more than the rest of it."""
    middle = len(values) // 2
    return float(np.partition(values, middle)[middle])


def tukey(t: Array) -> Array:
    """Tukey's weights of residuals in units of his limit."""
    return np.where(np.abs(t) < 1, (1 - t**2) ** 2, 0.0)


def reweighted(
    design: Array, target: Array, start: Array, iterations: int, scale: float | None = None
) -> Solution | None:
    """Iteratively reweighted least squares with Tukey's weights; None where the system is singular.

    Parameters
    ----------
    design : (n, k) ndarray
    target : (n,) ndarray
    start : (k,) ndarray
    scale : float
        Standard deviation of the target where it is known; else taken from the residuals.
    """
    solution = start
    for iteration in range(iterations):
        residual = target - design @ solution
        weights = tukey(residual / (TUKEY * (scale or MAD * median(np.abs(residual)) + 1e-12)))
        weighted = weights[:, None] * design
        normal = design.T @ weighted
        try:
            updated = np.asarray(np.linalg.solve(normal, weighted.T @ target), float)
        except np.linalg.LinAlgError:
            return None
        change = np.abs(design @ (updated - solution)).max()
        solution = updated
        if iteration > 0 and change < _CONVERGED:
            break
    return Solution(solution, weights, normal)


def from_scratch(
    design: Array,
    target: Array,
    absolute: int,
    iterations: int,
    least: float = 1e-9,
    distance: Callable[[Array], Array | None] | None = None,
) -> Solution | None:
    """Least absolute deviations first, then Tukey's weights; None where the system is singular.

    Parameters
    ----------
    design : (n, k) ndarray
    target : (n,) ndarray
    absolute, iterations : int
        Steps of least absolute deviations, and of all.
    least : float
        The residuals' scale is taken to be larger than that.
    distance : callable
        (n,) distances of the points from a model with given coefficients, None where there is no such model; the
        residuals' sizes without it.
    """
    weights = np.ones(len(target))
    for iteration in range(iterations):
        weighted = design * weights[:, None]
        normal = weighted.T @ design
        try:
            solution = np.asarray(np.linalg.solve(normal, weighted.T @ target), float)
        except np.linalg.LinAlgError:
            return None
        off = np.abs(target - design @ solution) if distance is None else distance(solution)
        if off is None:
            return None
        scale = MAD * median(off) + least
        early = iteration < absolute
        weights = 1 / np.maximum(off, _LEAST_OF_SCALE * scale) if early else tukey(off / (TUKEY * scale))
    return Solution(solution, weights, (design * weights[:, None]).T @ design)


@dataclass(frozen=True)
class Circle:
    """A circle, and the weight of each point that it goes through."""

    x: float
    y: float
    radius: float
    weights: Array

    def off(self, x: Array, y: Array) -> Array:
        """(n,) distances of points from it, outwards."""
        return np.asarray(np.hypot(x - self.x, y - self.y) - self.radius)


def fit_circle(x: Array, y: Array, least: float) -> Circle | None:
    """The circle through most of the points; None where they lie on none.

    Parameters
    ----------
    x, y : (n,) ndarray
    least : float
        How far points lie off a circle at least.
    """

    def circle(solution: Array, weights: Array) -> Circle | None:
        cx, cy = 0.5 * solution[:2]
        squared = float(solution[2] + cx**2 + cy**2)
        return Circle(float(cx), float(cy), float(np.sqrt(squared)), weights) if squared > 0 else None

    def distance(solution: Array) -> Array | None:
        found = circle(solution, x)
        return None if found is None else np.abs(found.off(x, y))

    # x² + y² = 2 cx x + 2 cy y + (r² − cx² − cy²)
    solved = from_scratch(np.column_stack([x, y, np.ones_like(x)]), x**2 + y**2, 8, 15, least, distance)
    return None if solved is None else circle(solved.values, solved.weights)

"""Polylines in the image: length, equal steps, directions, and smoothing that keeps ends and gentle bends in place."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.spatial import cKDTree

from metrology.arrays import Array, Mask

# An entry of no weight still holds the curve where nothing else does: between far nodes, beyond the last.
_LEAST_WEIGHT = 1e-4
# Fourth differences: cubics are free, for the curvature of a seam changes smoothly, too. Their penalties tried lie
# within a factor of two of any, from nearly none (points stay) to nearly all (a cubic through 300 points).
_PENALTY_ORDER = 4
_STIFFNESSES = 4.0 ** np.arange(-3.0, 21.0)


def arc_length(points: Array) -> Array:
    """(n,) length along a polyline (n, ≥2) up to each point; u, v are the first two columns."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1))])


def polyline_length(points: Array) -> float:
    """Length of a polyline (n, 2)."""
    return float(arc_length(points)[-1])


def resample(points: Array, step: float) -> Array:
    """Points every `step` (about: both ends are kept) along a polyline (n, k) with straight pieces."""
    arc = arc_length(points)
    stops = np.linspace(0, arc[-1], max(2, round(arc[-1] / step) + 1))
    return np.stack([np.interp(stops, arc, column) for column in points.T], axis=-1)


def interpolated(points: Array, step: float) -> Array:
    """Points every `step` (about) on the smooth curve (cubic spline) through a polyline's nodes (n ≥ 4, k)."""
    arc = arc_length(points)
    stops = np.linspace(0, arc[-1], max(2, round(arc[-1] / step) + 1))
    return np.asarray(CubicSpline(arc, points)(stops))


def tangents(points: Array) -> Array:
    """(n, 2) unit vectors along a polyline."""
    along = np.gradient(points[:, :2], axis=0)
    return np.asarray(along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12))


def normals(points: Array) -> Array:
    """(n, 2) unit vectors across a polyline: its tangents turned from u towards v."""
    along = tangents(points)
    return np.stack([-along[:, 1], along[:, 0]], axis=-1)


def smoothed(points: Array, scale_px: float, weights: ArrayLike | None = None) -> Array:
    """Each point replaced by a parabola fitted to its neighbours with Gaussian weights of their distance.

    A parabola follows a gently curved seam without flattening it and does not shrink at the ends.

    Parameters
    ----------
    points : (n, k) ndarray
    scale_px : float
        Standard deviation of the Gaussian along the line.
    weights : (n,) array, optional
        Further weights, such as 0 where a point could not be measured.
    """
    arc = arc_length(points)
    d = (arc[None] - arc[:, None]) / scale_px
    kernel = np.exp(-0.5 * d * d)
    if weights is not None:
        kernel *= np.maximum(np.asarray(weights, float), _LEAST_WEIGHT)
    d2 = d * d
    moments = [np.sum(kernel * power, axis=1) for power in (1.0, d, d2, d * d2, d2 * d2)]
    normal = np.stack([np.stack(moments[k : k + 3], axis=-1) for k in range(3)], axis=1)
    # A little stiffness where too few neighbours are left for a parabola.
    normal += 1e-9 * moments[0][:, None, None] * np.eye(3)
    first = np.linalg.solve(normal, np.broadcast_to([[1.0], [0.0], [0.0]], (len(points), 3, 1)))[..., 0]
    influence = kernel * (first[:, :1] + first[:, 1:2] * d + first[:, 2:] * d2)
    return np.asarray(influence @ points)


def smoothest(points: Array, weights: ArrayLike) -> Array:
    """The curve through evenly spaced points that their own scatter asks for, as smooth or as bent as that may be.

    Least squares with the fourth differences' squares as penalty, which leaves cubics free; how much they count is
    what makes the points likeliest (restricted maximum likelihood of the mixed model; G. Wahba, Ann. Stat. 13 (1985)
    1378–1402), told by the coordinate across the chord. The noise's size comes out of the same likelihood.

    Parameters
    ----------
    points : (n, 2) ndarray
        u, v.
    weights : (n,) array
        Inverse variances, up to a factor; 0 where a point could not be measured.
    """
    w = np.maximum(np.asarray(weights, float), _LEAST_WEIGHT)
    free = len(points) - _PENALTY_ORDER
    along = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    across = np.array([-along[1], along[0]])
    # The cubic is free of penalty; without it little is left to lose digits on.
    powers, root = legvander(np.linspace(-1, 1, len(points)), _PENALTY_ORDER - 1), np.sqrt(w)[:, None]
    cubic = powers @ np.linalg.lstsq(root * powers, root * points)[0]
    points = points - cubic
    curves, unlikelihoods = [], []
    for stiffness in _STIFFNESSES:
        system = stiffness * _penalty(len(points))
        system[-1] += w
        try:
            factor = cholesky_banded(system)
        except np.linalg.LinAlgError:
            # Stiffer than the weights have digits for.
            break
        smooth = cho_solve_banded((factor, False), w[:, None] * points)
        bends = np.diff(smooth @ across, _PENALTY_ORDER)
        residual = float(w @ ((points - smooth) @ across) ** 2 + stiffness * bends @ bends)
        determinant = 2 * float(np.log(factor[-1]).sum()) - free * np.log(stiffness)
        curves.append(smooth)
        unlikelihoods.append(free * np.log(residual + 1e-300) + determinant)
    odds = np.exp(-0.5 * (np.array(unlikelihoods) - min(unlikelihoods)))
    return np.asarray(cubic + np.tensordot(odds / odds.sum(), curves, axes=1))


@cache
def _penalty(n: int) -> Array:
    """(order + 1, n) bands of the matrix of differences' squares, upper form of LAPACK: the diagonal comes last."""
    order = _PENALTY_ORDER
    weights = np.diff(np.eye(order + 1), order, axis=0)[0]
    bands = np.zeros((order + 1, n))
    for i, first in enumerate(weights):
        for j in range(i, order + 1):
            bands[order - (j - i), j : n - order + j] += first * weights[j]
    return bands


class Course:
    """A line to measure distances from."""

    def __init__(self, points: Array) -> None:
        self._points = points
        self._tangents = tangents(points)
        self._tree = cKDTree(points)

    def beside(self, points: Array, reach_px: float, least_cosine: float = 0.9) -> Mask:
        """Which points (n, 2) of another line lie within the reach of this one and run along with it."""
        distance, index = self._tree.query(points, distance_upper_bound=reach_px)
        near = np.isfinite(distance)
        index = np.where(near, index, 0)
        along = np.abs(np.sum(self._tangents[index] * tangents(points), axis=1))
        return np.asarray(near & (along > least_cosine))

    def nearest(self, place: Array) -> int:
        """Index of the point of the line nearest to a place (2,)."""
        return int(self._tree.query(place)[1])

    def normal(self, index: int) -> Array:
        """(2,) unit vector across the line at one of its points."""
        along = self._tangents[index]
        return np.array([-along[1], along[0]])

"""Spheres of known size in an organised cloud: found by their centres, fitted with their covariance."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import cv2
import numpy as np

from metrology.arrays import Array
from metrology.robust import MAD
from metrology.verification.form import Form, form, inflation

_STEEPEST = np.cos(np.radians(60.0))  # least cosine between a surface's normal and the ray it is seen by
_SMOOTH_PX = 5  # window of the normals
_RIM_PX = 3  # beside a sphere's outline points are mixed with what lies behind
_LEAST_POINTS = 1000
_NEAR = 0.12  # of the radius: how far from a sphere its own points may lie at first
_OUTLIER = 6.0  # standard deviations
_STEPS = 12
_CONVERGED_MM = 1e-6
_MOST_CELLS = 2**20  # along an axis


@dataclass(frozen=True)
class SphereFit:
    """A sphere fitted to points."""

    centre: Array
    """(3,): rig frame, mm."""
    diameter_mm: float
    covariance: Array
    """(4, 4): of centre and radius, mm²."""
    form: Form

    @property
    def diameter_u95_mm(self) -> float:
        """Expanded uncertainty of the diameter from the points' noise."""
        return float(4 * np.sqrt(self.covariance[3, 3]))


def find_spheres(points: Array, radius_mm: float, most: int) -> list[Array]:
    """Centres of the spheres of one radius that a cloud shows, those with the most points first.

    On a sphere every point, a radius back along its normal, leads to the same centre; on anything else to many places.

    Parameters
    ----------
    points : (h, w, 3) ndarray
        Rig frame, mm; NaN where none.
    """
    normals = _normals(points)
    centres = points - radius_mm * normals
    known = np.isfinite(centres).all(axis=-1)
    votes = centres[known]
    found: list[Array] = []
    cell = radius_mm / 4
    while len(votes) >= _LEAST_POINTS and len(found) < most:
        cells = np.floor((votes - votes.min(axis=0)) / cell).astype(np.int64)
        key = (cells[:, 0] * _MOST_CELLS + cells[:, 1]) * _MOST_CELLS + cells[:, 2]
        _, member, counts = np.unique(key, return_inverse=True, return_counts=True)
        middle = np.median(votes[member == counts.argmax()], axis=0)
        for _ in range(3):
            middle = np.median(votes[np.linalg.norm(votes - middle, axis=1) < 1.5 * cell], axis=0)
        near = np.linalg.norm(votes - middle, axis=1) < 1.5 * cell
        if near.sum() < _LEAST_POINTS:
            break
        found.append(middle)
        votes = votes[np.linalg.norm(votes - middle, axis=1) > 2 * radius_mm]
    return found


def _normals(points: Array) -> Array:
    """(h, w, 3) unit normals towards the rig, of the points' means over windows; NaN beside what has no point."""
    size = (_SMOOTH_PX, _SMOOTH_PX)
    known = np.isfinite(points[..., 2])
    filled = np.where(known[..., None], points, 0.0)
    whole = cv2.erode(known.astype(np.uint8), np.ones(size, np.uint8)) > 0
    mean = np.where(whole[..., None], cv2.blur(filled, size), np.nan)
    across, down = (np.gradient(mean, axis=axis) for axis in (1, 0))
    normal = np.cross(across, down)
    with np.errstate(invalid="ignore"):
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return np.asarray(np.where((normal * points).sum(-1, keepdims=True) > 0, -normal, normal))


def fit_sphere(points: Array, sigma_z: Array, centre: Array, radius_mm: float) -> SphereFit | None:
    """Least-squares sphere of free radius through the points near one; None where there are too few.

    Points seen more steeply than 60° and those beside the outline do not count. A point errs along its viewing ray; the
    fit sees of that the part along the sphere's normal.

    Parameters
    ----------
    points, sigma_z : (h, w, 3) and (h, w) ndarray
        Organised cloud.
    centre : (3,) ndarray
        About where the sphere's centre is, mm.
    radius_mm : float
        About its radius.
    """
    off = points - centre
    with np.errstate(invalid="ignore"):
        on_it = np.abs(np.linalg.norm(off, axis=-1) - radius_mm) < _NEAR * radius_mm
        facing = -(off * points).sum(-1) > _STEEPEST * radius_mm * np.linalg.norm(points, axis=-1)
    inside = cv2.erode((on_it & facing).astype(np.uint8), np.ones((2 * _RIM_PX + 1,) * 2, np.uint8)) > 0
    if inside.sum() < _LEAST_POINTS:
        return None
    p, s = points[inside].astype(float), sigma_z[inside].astype(float)
    ray = p / p[:, 2:]
    unknown = np.array([*centre, radius_mm], float)
    weight = np.ones(len(p))
    for _ in range(_STEPS):
        off = p - unknown[:3]
        length = np.linalg.norm(off, axis=1)
        normal = off / length[:, None]
        sigma = np.maximum(s * np.abs((ray * normal).sum(1)), 1e-9)
        residual = length - unknown[3]
        scale = MAD * np.median(np.abs(residual / sigma)) + 1e-12
        weight = (np.abs(residual / sigma) < _OUTLIER * scale) / sigma**2
        rows = np.column_stack([-normal, -np.ones(len(p))])
        matrix = rows.T @ (weight[:, None] * rows)
        change = np.linalg.solve(matrix, rows.T @ (weight * residual))
        unknown = unknown - change
        if np.abs(change).max() < _CONVERGED_MM:
            break
    image = np.full(inside.shape, np.nan)
    image[inside] = residual
    factor = inflation(image)
    used = weight > 0
    chi2 = float((weight * residual**2).sum() / (used.sum() - 4))
    return SphereFit(unknown[:3], float(2 * unknown[3]), np.linalg.inv(matrix) * chi2 * factor, form(residual, factor))


def distance_u95(one: SphereFit, other: SphereFit) -> tuple[float, float]:
    """Distance of two spheres' centres and its expanded uncertainty from the points' noise, mm."""
    off = other.centre - one.centre
    length = float(np.linalg.norm(off))
    direction = off / length
    both = one.covariance[:3, :3] + other.covariance[:3, :3]
    return length, float(2 * np.sqrt(direction @ both @ direction))


def identify(centres: Array, distances: dict[tuple[int, int], float]) -> tuple[int, ...]:
    """Which found centre is which sphere, by the certified distances between spheres (i, j).

    Parameters
    ----------
    centres : (n, 3) ndarray
        One for each sphere, in any order.
    """
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)

    def misfit(order: tuple[int, ...]) -> float:
        return sum((apart[order[i], order[j]] - length) ** 2 for (i, j), length in distances.items())

    return min(permutations(range(len(centres))), key=misfit)

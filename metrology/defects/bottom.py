"""The bottom of a defect: its depth with its uncertainty, and how sharply it is bent there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array, Mask
from metrology.defects.bottom_fit import Form, Points, Vertex, fitted
from metrology.defects.patch import CORRELATED, SUPPORT_PX, Patch

_REACH = 0.75  # of the radii at half depth: points that far from the deepest one tell its shape
_FAR_REACH = 1.25  # where noise hides by how much the forms are not real ones: the flanks tell a point from a bowl
_HIDES = 300.0  # depth over the standard deviation of all near points' mean: three over a hundredth
_LEAST_STEPS, _LEAST_PX = 3.0, 6.0
_FEWEST = 12
_FORMS: tuple[Form, ...] = ("smooth", "point", "fold")
_TEMPERED = 0.5  # evidence counts half: real forms are none of these exactly
_POSSIBLE = 0.1  # probability of a form that counts for the curvature
_FLATTEST = 1e-6  # 1/mm


@dataclass(frozen=True)
class Bottom:
    """The deepest point."""

    x: float
    y: float
    """x, y: mm in the patch's frame."""
    depth: float
    sd: float
    """depth, sd: mm; standard deviation by the noise of the points and by what its form may be."""
    radius: float
    radius_sd: float
    """radius, radius_sd: least radius of curvature, the skin's own left out, mm."""
    hidden: bool
    """Whether it lies at the border of what was seen: it may be deeper behind it."""


def bottom_of(patch: Patch, inside: Mask, at: tuple[int, int], radii: tuple[float, float, float]) -> Bottom | None:
    """Depth at the bottom of a defect; None where too little of it was seen.

    A bottom is smooth, pointed, or a fold. Each form is fitted; the depth is their mean, weighted by how probable the
    points make each (its evidence), and their scatter is part of its uncertainty.

    Parameters
    ----------
    inside : (rows, columns) bool
        Within its outline at half depth.
    at : (row, column)
        Its deepest grid cell, about.
    radii : (float, float, float)
        Half its length and width at half depth, mm, and the length's direction.
    """
    points = _points(patch, inside, (float(patch.x[at]), float(patch.y[at])), radii)
    if points is None:
        return None
    found = [fitted(points, form) for form in _FORMS]
    evidence = np.array([vertex.evidence for vertex in found])
    weights = np.exp(_TEMPERED * (evidence - evidence.max()))
    weights /= weights.sum()
    x, y, depth = (_mean(weights, found, name) for name in ("x", "y", "depth"))
    sd = _scatter(weights, found, "depth", depth)
    # A form that is hardly possible, but much sharper, would decide a mean of curvatures.
    likely = np.where(weights > _POSSIBLE, weights, 0.0) / weights[weights > _POSSIBLE].sum()
    curvature = _mean(likely, found, "curvature")
    bent = max(curvature, _FLATTEST)
    near = np.hypot(patch.x - x, patch.y - y) < max(2.5 * patch.step_mm, 0.15 * radii[1])
    hidden = not near.any() or bool((~patch.skin[near]).mean() > 0.2)
    return Bottom(x, y, depth, sd, 1 / bent, _scatter(likely, found, "curvature", curvature) / bent**2, hidden)


def _mean(weights: Array, found: list[Vertex], name: str) -> float:
    return float(weights @ [getattr(vertex, name) for vertex in found])


def _scatter(weights: Array, found: list[Vertex], name: str, mean: float) -> float:
    """Standard deviation of a mixture: of the forms' own and of their difference."""
    off = np.array([np.hypot(getattr(vertex, f"{name}_sd"), getattr(vertex, name) - mean) for vertex in found])
    return float(np.sqrt(weights @ off**2))


def _points(
    patch: Patch, inside: Mask, centre: tuple[float, float], radii: tuple[float, float, float]
) -> Points | None:
    """The points near the bottom in units of its radii; None of too few."""
    half_length, half_width, turn = radii
    step_mm, pixel_mm = patch.step_mm, patch.step_mm / patch.step_px
    least = max(_LEAST_STEPS, _LEAST_PX / patch.step_px) * step_mm
    c, s = np.cos(turn), np.sin(turn)
    dx, dy = patch.x - centre[0], patch.y - centre[1]
    p, q = (c * dx + s * dy) / half_length, (c * dy - s * dx) / half_width
    sd = patch.sigma * patch.reference.noise * CORRELATED

    def within(reach: float) -> Mask:
        far = max(reach, least / half_length), max(reach, least / half_width)
        return np.asarray(patch.skin & ((p / far[0]) ** 2 + (q / far[1]) ** 2 < 1))

    near = inside & within(_REACH)
    if near.sum() < _FEWEST:
        return None
    if np.sqrt(np.sum((patch.depth[near] / sd[near]) ** 2)) < _HIDES:
        near = patch.plate & ~patch.others & within(_FAR_REACH)
    return Points(
        p=p[near],
        q=q[near],
        depth=patch.depth[near],
        sd=sd[near],
        centre=centre,
        radii=radii,
        # Points and grid cells are means over an area.
        blur_mm=float(np.sqrt((SUPPORT_PX * pixel_mm) ** 2 + (step_mm**2 - pixel_mm**2) / 12)),
    )

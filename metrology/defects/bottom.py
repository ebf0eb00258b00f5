"""The bottom of a defect: its depth with its uncertainty, and how sharply it is bent there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrology.defects.patch import Patch

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SHARES = (0.4, 0.25, 0.15, 0.1)  # of the radius at half depth: paraboloids through so much of the bottom
_LEAST_STEPS = 2.3
_FEWEST = 12
_AGREE = 2.0  # standard deviations by which a narrower paraboloid may lie deeper
_CORRELATED = 1.3  # standard deviation of means over areas against that of the grid's cells alone
_FLATTEST = 1e-6  # 1/mm
_SUPPORT_PX = 1.4  # standard deviation of the area that a point is an average of


@dataclass(frozen=True)
class Bottom:
    """The deepest point.

    Attributes
    ----------
    x, y : float
        mm in the patch's frame.
    depth, sd : float
        mm; standard deviation by the noise of the points and by how the paraboloids differ.
    radius, radius_sd : float
        Least radius of curvature, the skin's own left out, mm.
    hidden : bool
        Whether it lies at the border of what was seen: it may be deeper behind it.
    """

    x: float
    y: float
    depth: float
    sd: float
    radius: float
    radius_sd: float
    hidden: bool


@dataclass(frozen=True)
class _Vertex:
    x: float
    y: float
    depth: float
    sd: float
    curvature: float
    curvature_sd: float


def bottom_of(patch: Patch, inside: Mask, at: tuple[int, int], radii: tuple[float, float, float]) -> Bottom | None:
    """Depth at the bottom of a defect; None where too little of it was seen.

    The widest paraboloid that a narrower one does not contradict: a smooth bottom is known the better the more of it
    is used, a pointed one is not a paraboloid but at its end.

    Parameters
    ----------
    patch : Patch
    inside : (rows, columns) bool
        Within its outline at half depth.
    at : (row, column)
        Its deepest grid cell, about.
    radii : (float, float, float)
        Half its length and width at half depth, mm, and the length's direction.
    """
    noise = patch.reference.noise * _CORRELATED
    chosen: _Vertex | None = None
    centre = float(patch.x[at]), float(patch.y[at])
    for share in _SHARES[::-1]:
        vertex = _vertex(patch, inside, centre, radii, share, noise)
        if vertex is None:
            continue
        if chosen is not None and vertex.depth < chosen.depth - _AGREE * max(chosen.sd, 1e-6):
            break
        if chosen is not None:
            doubt = 0.5 * max(0.0, abs(vertex.depth - chosen.depth) - chosen.sd)
            vertex = replace(vertex, sd=float(np.hypot(vertex.sd, doubt)))
        chosen = vertex
    if chosen is None:
        return None
    near = np.hypot(patch.x - chosen.x, patch.y - chosen.y) < max(2.5 * patch.step_mm, 0.15 * radii[1])
    hidden = bool((~patch.skin[near]).mean() > 0.2)
    curvature = max(chosen.curvature, _FLATTEST)
    radius_sd = chosen.curvature_sd / curvature**2
    return Bottom(chosen.x, chosen.y, chosen.depth, chosen.sd, 1 / curvature, radius_sd, hidden)


def _vertex(
    patch: Patch, inside: Mask, centre: tuple[float, float], radii: tuple[float, float, float], share: float,
    noise: float,
) -> _Vertex | None:  # fmt: skip
    """Top of a paraboloid through the points near the bottom; None of too few, or of one that has no top there."""
    half_length, half_width, turn = radii
    least = _LEAST_STEPS * patch.step_mm
    a, b = max(share * half_length, least), max(share * half_width, least)
    c, s = np.cos(turn), np.sin(turn)
    dx, dy = patch.x - centre[0], patch.y - centre[1]
    along, across = (c * dx + s * dy) / a, (c * dy - s * dx) / b
    near = inside & patch.skin & (along**2 + across**2 < 1)
    if near.sum() < _FEWEST:
        return None
    p, q, depth = along[near], across[near], patch.depth[near]
    sd = patch.sigma[near] * noise
    design = np.stack([np.ones_like(p), p, q, p * p, p * q, q * q], axis=1) / sd[:, None]
    normal = design.T @ design
    if np.linalg.cond(normal) > 1e8:
        return None
    covariance = np.linalg.inv(normal)
    f = covariance @ (design.T @ (depth / sd))
    bend = np.array([[2 * f[3], f[4]], [f[4], 2 * f[5]]])
    steepest = np.linalg.eigvalsh(bend)
    if steepest[1] < 0:
        top = -np.linalg.solve(bend, f[1:3])
        top /= max(1.0, float(np.linalg.norm(top)))
    else:
        # No top within: the deepest of what is there.
        top = np.array([p[depth.argmax()], q[depth.argmax()]]) if steepest[0] > 0 else np.zeros(2)
    row = np.array([1, *top, top[0] ** 2, top[0] * top[1], top[1] ** 2])
    by_mm = np.linalg.eigvalsh(bend / np.outer([a, b], [a, b]))
    # Points and grid cells are means over an area, which a bent bottom lies below.
    area = (patch.step_mm**2 - (patch.step_mm / patch.step_px) ** 2) / 12
    area += (_SUPPORT_PX * patch.step_mm / patch.step_px) ** 2
    lost = -0.5 * float(by_mm.sum()) * area
    return _Vertex(
        centre[0] + c * a * top[0] - s * b * top[1],
        centre[1] + s * a * top[0] + c * b * top[1],
        float(row @ f) + max(lost, 0.0),
        float(np.sqrt(row @ covariance @ row)),
        max(-float(by_mm[0]), 0.0),
        2 * float(np.sqrt(max(covariance[3, 3] / a**4, covariance[5, 5] / b**4))),
    )

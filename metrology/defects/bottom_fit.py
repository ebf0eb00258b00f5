"""Forms that the bottom of a defect may have, fitted to the points near it.

Over the axes p, q at half depth a bottom is

    d(p, q) = c₀ + polynomial of fourth degree − (cusp),

without a cusp where it is smooth, with a multiple of √(p² + q²) where it is pointed, and with |q| (1, p²) where it is
folded along p. What is known of dents beforehand (how large such terms are against the depth) is a Gaussian prior, so
that a dent of a few pixels has a depth too, and one of thousands is what its points say.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Literal

import numpy as np

from metrology.arrays import Array

Form = Literal["smooth", "point", "fold"]

# Exponents of p and q, mean and standard deviation of the coefficients over the depth. A cos² bowl has −0.62 p² and
# +0.13 p⁴; a parabola that is at half depth at its outline −0.5 p² and nothing else.
_TERMS = (
    (0, 0, 1.0, 10.0),
    (1, 0, 0.0, 0.2),
    (0, 1, 0.0, 0.2),
    (2, 0, -0.55, 0.3),
    (1, 1, 0.0, 0.3),
    (0, 2, -0.55, 0.3),
    (3, 0, 0.0, 0.05),
    (2, 1, 0.0, 0.05),
    (1, 2, 0.0, 0.05),
    (0, 3, 0.0, 0.05),
    (4, 0, 0.06, 0.1),
    (2, 2, 0.12, 0.2),
    (0, 4, 0.06, 0.1),
)
_SMOOTH = len(_TERMS)
_POWERS = np.array([term[:2] for term in _TERMS]).T
_LOWER = np.maximum(_POWERS[:, None, :] - _POWERS[:, :, None], 0)
_BINOMIALS = np.array([[comb(i, k) * comb(j, m) for i, j, *_ in _TERMS] for k, m, *_ in _TERMS], float)
"""Of a term moved from a place: (row, column) powers of the place, and factors; 0 of terms that it has not."""
# With a cusp: a cone has −0.5 ρ; (1 − ρ/3.4)², which is at half depth at ρ = 1 too, −0.59 ρ and +0.09 ρ².
_CUSPS: dict[Form, tuple[tuple[float, float], ...]] = {
    "smooth": (),
    "point": ((-0.55, 0.25),),
    "fold": ((-0.55, 0.25), (0.2, 0.3)),
}
# Mean and standard deviation there of the slopes, which the cusp's free place makes needless, and of the squares.
_BESIDE_CUSP = {1: (0.0, 0.1), 2: (0.04, 0.2)}
_ROUNDS = 4
_GRID_STEPS = 4  # to either side, on which the place of a cusp is looked for first
_REFINED = 6  # times is the grid made finer
_SPREAD = 3.0  # places that are about as probable as the best: the grid is fine enough
_FARTHEST = 0.35  # of the half axes may the bottom lie from where it was looked for
_MOST_ROUNDED = 0.15  # of its half width that the rounding may reach
_ROUNDED_MM, _ROUNDED_SD_MM = 1.5, 1.0  # radius to which a sheet's point or fold is rounded, too small to be seen


@dataclass(frozen=True)
class Points:
    """Points near a bottom."""

    p: Array
    q: Array
    """p, q: (n,): along its length and across, over half its axes at half depth."""
    depth: Array
    sd: Array
    """depth, sd: (n,): mm."""
    centre: tuple[float, float]
    """(x, y): of p, q in the patch's frame, mm."""
    radii: tuple[float, float, float]
    """Half its length and width at half depth, mm, and the length's direction."""
    blur_mm: float
    """Standard deviation of the area that a point is a mean of."""


@dataclass(frozen=True)
class Vertex:
    """A bottom by one form: place and depth, mm; greatest curvature, 1/mm; logarithm of its evidence."""

    x: float
    y: float
    depth: float
    depth_sd: float
    curvature: float
    curvature_sd: float
    evidence: float


def fitted(points: Points, form: Form) -> Vertex:
    """The bottom by a form."""
    sums = _sums(points)
    scale = float(np.percentile(points.depth, 95))
    if form == "smooth":
        place = np.zeros((1, 2))
        for number in range(_ROUNDS):
            solved = _solved(points, sums, form, place, scale)
            scale = max(float(solved.values[0, 0]), 0.2 * scale)
            if number < _ROUNDS - 1:
                place = np.clip(place + _way_to_top(solved.values[0], scale), -_FARTHEST, _FARTHEST)
        return _vertex(points, form, place, np.ones(1), solved, float(solved.evidence[0]))
    return _cusp(points, sums, form, scale)


@dataclass(frozen=True)
class _Sums:
    """Designᵀ design, designᵀ depths and depths' squares of the smooth terms about the centre, over the variances."""

    design: Array
    normal: Array
    right: Array
    squares: float


@dataclass(frozen=True)
class _Solved:
    """For each of m places of the bottom: (m, k) coefficients, (m, k, k) covariance, (m,) logarithm of the evidence."""

    values: Array
    covariance: Array
    evidence: Array


def _sums(points: Points) -> _Sums:
    by_p = _blurred_powers(points.p, points.blur_mm / points.radii[0])
    by_q = _blurred_powers(points.q, points.blur_mm / points.radii[1])
    design = np.stack([by_p[i] * by_q[j] for i, j, *_ in _TERMS], axis=1) / points.sd[:, None]
    target = points.depth / points.sd
    return _Sums(design, design.T @ design, design.T @ target, float(target @ target))


def _cusp(points: Points, sums: _Sums, form: Form, scale: float) -> Vertex:
    """The mean over all places where a cusp may be, each by how probable it makes the points.

    Where a cusp fits best is a choice that noise has made: its depth there alone would be too sure, and a search
    downhill stays where it began.
    """
    axes = 2 if form == "point" else 1
    step, middle, offsets = _FARTHEST / _GRID_STEPS, np.zeros(2), _grid(axes, _GRID_STEPS)
    for number in range(_REFINED):
        places = np.clip(middle + step * offsets, -_FARTHEST, _FARTHEST)
        solved = _solved(points, sums, form, places, scale)
        best = int(solved.evidence.argmax())
        weights = np.exp(solved.evidence - solved.evidence[best])
        fine = weights.sum() > _SPREAD
        if fine and number:
            break
        scale = max(float(solved.values[best, 0]), 0.2 * scale)
        if not fine:
            middle, step, offsets = places[best], step / 2, _grid(axes, 2)
    evidence = float(solved.evidence[best] + np.log(weights.sum() * (0.5 * step / _FARTHEST) ** axes))
    return _vertex(points, form, places, weights / weights.sum(), solved, evidence)


def _grid(axes: int, steps: int) -> Array:
    """(m, 2) places round a middle; where along itself a fold is makes no difference."""
    line = np.arange(-steps, steps + 1.0)
    return np.stack(np.meshgrid(line if axes == 2 else [0.0], line), axis=-1).reshape(-1, 2)


def _solved(points: Points, sums: _Sums, form: Form, places: Array, scale: float) -> _Solved:
    """The terms about each of m places (m, 2)."""
    mean, sd = _prior(form, scale)
    moved = _moved(places)
    cusps = _cusps(points, form, places) / points.sd
    across = np.swapaxes(moved, 1, 2) @ np.moveaxis(cusps @ sums.design, 0, 2)
    normal = np.block(
        [
            [np.swapaxes(moved, 1, 2) @ sums.normal @ moved, across],
            [np.swapaxes(across, 1, 2), np.einsum("imn,jmn->mij", cusps, cusps)],
        ]
    )
    right = np.hstack([sums.right @ moved, (cusps @ (points.depth / points.sd)).T])
    squares = sums.squares - 2 * right @ mean + np.einsum("i,mij,j->m", mean, normal, mean)
    right = right - normal @ mean
    normal = normal + np.diag(sd**-2.0)
    covariance = np.linalg.inv(normal)
    change = (covariance @ right[..., None])[..., 0]
    evidence = -0.5 * (squares - (right * change).sum(axis=1) + np.linalg.slogdet(normal)[1]) - np.log(sd).sum()
    return _Solved(mean + change, covariance, evidence)


def _moved(places: Array) -> Array:
    """(m, k, k) coefficients of the smooth terms about the centre, of each of those about a place."""
    by_p, by_q = ((-places[:, axis, None]) ** np.arange(5) for axis in (0, 1))
    return np.asarray(_BINOMIALS * by_p[:, _LOWER[0]] * by_q[:, _LOWER[1]])


def _prior(form: Form, scale: float) -> tuple[Array, Array]:
    terms = [list(term[2:]) for term in _TERMS]
    if form != "smooth":
        for k, (i, j, *_) in enumerate(_TERMS):
            if i + j in _BESIDE_CUSP:
                terms[k] = list(_BESIDE_CUSP[i + j])
            elif i + j == 4:
                terms[k][0] = 0.0
    mean, sd = np.array([*terms, *_CUSPS[form]]).T
    return mean * scale, sd * scale


def _cusps(points: Points, form: Form, places: Array) -> Array:
    """(0 … 2, m, n) the terms of a cusp at each of m places, as means over the area of a point."""
    p, q = points.p - places[:, :1], points.q - places[:, 1:]
    s, t = points.blur_mm / points.radii[0], points.blur_mm / points.radii[1]
    if form == "point":
        return np.sqrt(p * p + q * q + 0.25 * np.pi * (s * s + t * t))[None]
    if form == "smooth":
        return np.empty((0, *p.shape))
    edge = np.sqrt(q * q + 2 / np.pi * t * t)
    return np.stack([edge, edge * (p * p + s * s)])


def _blurred_powers(x: Array, sd: float) -> tuple[Array, ...]:
    """Powers 0 … 4 of x, each the mean over a Gaussian's width."""
    v = sd * sd
    return np.ones_like(x), x, x * x + v, x**3 + 3 * x * v, x**4 + 6 * x * x * v + 3 * v * v


def _way_to_top(solution: Array, scale: float) -> Array:
    """From a place to the top of the parabola there."""
    bend = np.array([[2 * solution[3], solution[4]], [solution[4], 2 * solution[5]]])
    bend -= 0.05 * scale * np.eye(2)  # flat ones go nowhere
    return -np.linalg.solve(bend, solution[1:3]) if np.linalg.eigvalsh(bend)[1] < 0 else np.zeros(2)


def _vertex(points: Points, form: Form, places: Array, weights: Array, solved: _Solved, evidence: float) -> Vertex:
    """The mean of the bottoms at some places by their weights."""
    a, b, turn = points.radii
    depth, variance = solved.values[:, 0], solved.covariance[:, 0, 0]
    second = solved.values[:, [3, 4, 4, 5]].reshape(-1, 2, 2) * [[2, 1], [1, 2]] / np.outer([a, b], [a, b])
    curvature = np.maximum(-np.linalg.eigvalsh(second)[:, 0], 0.0)
    spread = 4 * np.maximum(solved.covariance[:, 3, 3] / a**4, solved.covariance[:, 5, 5] / b**4)
    if form != "smooth":
        # √(u² + r²) in place of |u| loses slope² × radius: a hyperbola.
        slope = np.maximum(-solved.values[:, _SMOOTH], 0.0) / b
        most = _MOST_ROUNDED * b / np.maximum(slope, 1e-9)
        depth = depth - slope**2 * np.minimum(_ROUNDED_MM, most)
        variance = variance + (slope**2 * np.minimum(_ROUNDED_SD_MM, most)) ** 2
        # Bent within the area of a point: how much sharper, nothing tells.
        unseen = slope / points.blur_mm
        curvature, spread = curvature + unseen, spread + (0.5 * unseen) ** 2
    mean, bent = float(weights @ depth), float(weights @ curvature)
    sd = float(np.sqrt(weights @ (variance + (depth - mean) ** 2)))
    bent_sd = float(np.sqrt(weights @ (spread + (curvature - bent) ** 2)))
    (x, y), c, s = weights @ places * [a, b], np.cos(turn), np.sin(turn)
    x, y = points.centre[0] + c * x - s * y, points.centre[1] + s * x + c * y
    return Vertex(float(x), float(y), mean, sd, bent, bent_sd, evidence)

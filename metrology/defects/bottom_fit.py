"""Forms that the bottom of a defect may have, fitted to the points near it.

Over the axes p, q at half depth a bottom is

    d(p, q) = c₀ + polynomial of fourth degree − (cusp),

without a cusp where it is smooth, with a multiple of √(p² + q²) where it is pointed, and with |q| (1, p²) where it is
folded along p. What is known of dents beforehand (how large such terms are against the depth) is a Gaussian prior, so
that a dent of a few pixels has a depth too, and one of thousands is what its points say.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
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
# With a cusp: (1 − ρ/3.4)², which is at half depth at ρ = 1, has −0.59 ρ and +0.09 ρ².
_CUSPS: dict[Form, tuple[tuple[float, float], ...]] = {
    "smooth": (),
    "point": ((-0.5, 0.25),),
    "fold": ((-0.5, 0.25), (0.2, 0.3)),
}
_BESIDE_CUSP = 0.0, 0.4  # mean and standard deviation of the squares there
_ROUNDS = 4
_FARTHEST = 0.35  # of the half axes may the bottom lie from where it was looked for
_MOST_ROUNDED = 0.15  # of its half width that the rounding may reach
_ROUNDED_MM, _ROUNDED_SD_MM = 1.5, 1.0  # radius to which a sheet's point or fold is rounded, too small to be seen


@dataclass(frozen=True)
class Points:
    """Points near a bottom.

    Attributes
    ----------
    p, q : (n,) ndarray
        Along its length and across, over half its axes at half depth.
    depth, sd : (n,) ndarray
        mm.
    centre : (x, y)
        Of p, q in the patch's frame, mm.
    radii : (float, float, float)
        Half its length and width at half depth, mm, and the length's direction.
    blur_mm : float
        Standard deviation of the area that a point is a mean of.
    """

    p: Array
    q: Array
    depth: Array
    sd: Array
    centre: tuple[float, float]
    radii: tuple[float, float, float]
    blur_mm: float


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
    scale = float(np.percentile(points.depth, 95))
    place = np.zeros(2)
    for number in range(_ROUNDS):
        solution, covariance, evidence = _solved(points, form, place, scale)
        scale = max(float(solution[0]), 0.2 * scale)
        if number < _ROUNDS - 1:
            place = np.clip(place + _way_to_bottom(points, form, place, solution, scale), -_FARTHEST, _FARTHEST)
    return _vertex(points, form, place, solution, covariance, evidence)


def _solved(points: Points, form: Form, place: Array, scale: float) -> tuple[Array, Array, float]:
    """Coefficients, covariance and evidence for a place of the bottom."""
    mean, sd = _prior(form, scale)
    design = _design(points, form, place) / points.sd[:, None]
    normal = design.T @ design + np.diag(sd**-2.0)
    covariance = np.linalg.inv(normal)
    off = points.depth / points.sd - design @ mean
    change = covariance @ (design.T @ off)
    left = off - design @ change
    evidence = -0.5 * float(left @ left + np.sum((change / sd) ** 2))
    evidence -= 0.5 * float(np.linalg.slogdet(normal)[1]) + float(np.log(sd).sum())
    return mean + change, np.asarray(covariance, float), evidence


def _prior(form: Form, scale: float) -> tuple[Array, Array]:
    terms = [list(term[2:]) for term in _TERMS]
    if form != "smooth":
        for k, (i, j, *_) in enumerate(_TERMS):
            if i + j == 2:
                terms[k] = list(_BESIDE_CUSP)
            elif i + j == 4:
                terms[k][0] = 0.0
    mean, sd = np.array([*terms, *_CUSPS[form]]).T
    return mean * scale, sd * scale


def _design(points: Points, form: Form, place: Array) -> Array:
    """(n, k) the terms about a place, as means over the area of a point."""
    p, q = points.p - place[0], points.q - place[1]
    s, t = points.blur_mm / points.radii[0], points.blur_mm / points.radii[1]
    by_p, by_q = _blurred_powers(p, s), _blurred_powers(q, t)
    columns = [by_p[i] * by_q[j] for i, j, *_ in _TERMS]
    if form == "point":
        columns.append(np.sqrt(p * p + q * q + 0.25 * np.pi * (s * s + t * t)))
    if form == "fold":
        edge = np.sqrt(q * q + 2 / np.pi * t * t)
        columns += [edge, edge * by_p[2]]
    return np.stack(columns, axis=1)


def _blurred_powers(x: Array, sd: float) -> tuple[Array, ...]:
    """Powers 0 … 4 of x, each the mean over a Gaussian's width."""
    v = sd * sd
    return np.ones_like(x), x, x * x + v, x**3 + 3 * x * v, x**4 + 6 * x * x * v + 3 * v * v


def _way_to_bottom(points: Points, form: Form, place: Array, solution: Array, scale: float) -> Array:
    """From a place towards the deepest point: of a smooth form its top, else where the cusp fits best."""
    if form == "smooth":
        bend = np.array([[2 * solution[3], solution[4]], [solution[4], 2 * solution[5]]])
        bend -= 0.05 * scale * np.eye(2)  # flat ones go nowhere
        return -np.linalg.solve(bend, solution[1:3]) if np.linalg.eigvalsh(bend)[1] < 0 else np.zeros(2)
    p, q = points.p - place[0], points.q - place[1]
    design = _design(points, form, place)
    left = (points.depth - design @ solution) / points.sd
    edge = design[:, _SMOOTH]
    moves = np.stack([p / edge, q / edge], axis=1) if form == "point" else (q / edge)[:, None]
    moves = -solution[_SMOOTH] * moves / points.sd[:, None]
    # What the smooth terms can follow tells nothing of where the cusp is.
    smooth = design / points.sd[:, None]
    moves -= smooth @ np.linalg.lstsq(smooth, moves, rcond=None)[0]
    step = np.linalg.solve(moves.T @ moves + 4 * np.eye(moves.shape[1]), moves.T @ left)
    return np.asarray(step if form == "point" else np.array([0.0, step[0]]), float)


def _vertex(points: Points, form: Form, place: Array, solution: Array, covariance: Array, evidence: float) -> Vertex:
    a, b, turn = points.radii
    c, s = np.cos(turn), np.sin(turn)
    x, y = a * place[0], b * place[1]
    bend = np.array([[2 * solution[3], solution[4]], [solution[4], 2 * solution[5]]]) / np.outer([a, b], [a, b])
    curvature = max(-float(np.linalg.eigvalsh(bend)[0]), 0.0)
    curvature_sd = 2 * float(np.sqrt(max(covariance[3, 3] / a**4, covariance[5, 5] / b**4)))
    depth, variance = float(solution[0]), float(covariance[0, 0])
    if form != "smooth":
        # √(u² + r²) in place of |u| loses slope² × radius: a hyperbola.
        slope = max(-float(solution[_SMOOTH]), 0.0) / b
        most = _MOST_ROUNDED * b / max(slope, 1e-9)
        depth -= slope**2 * min(_ROUNDED_MM, most)
        variance += (slope**2 * min(_ROUNDED_SD_MM, most)) ** 2
        # Bent within the area of a point: how much sharper, nothing tells.
        unseen = slope / points.blur_mm
        curvature, curvature_sd = curvature + unseen, float(np.hypot(curvature_sd, 0.5 * unseen))
    return Vertex(
        points.centre[0] + c * x - s * y, points.centre[1] + s * x + c * y, depth, float(np.sqrt(variance)),
        curvature, curvature_sd, evidence,
    )  # fmt: skip

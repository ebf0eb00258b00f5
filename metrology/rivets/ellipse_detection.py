"""Rivet detection in the image (paper §3.1): arcs, votes near suspects, and the joint fit that decides."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.rivets.arc_fit import fit_candidates
from metrology.rivets.arcs import Arcs, RidgeField, trace_arcs, vote_centres
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.evidence import distinction, ring_evidence, ring_profile
from metrology.rivets.ring import RingFit, fit_ring
from metrology.rivets.settings import RivetSettings
from metrology.rivets.shapes import CircleShapes, log_shape, shapes_of

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]

_LEAST_CONTRAST = 0.15  # of a ring against either side, as a share of its amplitude


@dataclass(frozen=True)
class Level:
    """One resolution at which arcs are traced.

    Attributes
    ----------
    reduction : int
        Pixels of the image per pixel of the level.
    least, most : float
        Radii looked for, pixels of the image.
    """

    reduction: int
    least: float
    most: float


def levels_for(least: float, most: float) -> list[Level]:
    """Resolutions for radii from `least` to `most` pixels: heads of few pixels at full resolution, others at half.

    A thin ring loses contrast at a lower resolution, so even large heads are traced at half resolution; only those
    beyond 70 px, where the gap itself is wide, at a quarter.
    """
    bounds = [(1, 0.0, 6.0), (2, 5.5, 70.0), (4, 60.0, np.inf)]
    return [Level(k, max(a, least), min(b, most)) for k, a, b in bounds if max(a, least) < min(b, most)]


def _candidates(
    arcs: Arcs, size: tuple[int, int], level: Level, shapes: CircleShapes, settings: RivetSettings
) -> Array:
    """(n, 7) ellipses in pixels of the level that ridge points support, then coverage and agreement."""
    k = level.reduction
    radii = np.arange(max(level.least / k, 2.5), level.most / k + 0.5, 0.5)
    planes = max(1, int(np.ceil(np.log(radii[-1] / radii[0]) / np.log(1.35))))
    edges = np.geomspace(radii[0], radii[-1] + 1e-6, planes + 1)
    starts = vote_centres(arcs, size, radii, edges, shapes.matrices, shapes.cell / k, settings.min_support, 150)
    if len(starts) == 0:
        return np.empty((0, 7))
    order = np.argsort(arcs.v, kind="stable")
    v = arcs.v[order]
    rows = np.searchsorted(v, np.arange(size[0] + 2)).astype(np.int64)
    expected = shapes.at(starts[:, 0] * k, starts[:, 1] * k)
    ellipses, coverage, agreement = np.zeros((len(starts), 5)), np.zeros(len(starts)), np.zeros(len(starts))
    fit_candidates(
        starts, arcs.u[order], v, arcs.nu[order], arcs.nv[order], rows, expected, ellipses, coverage, agreement
    )
    return np.column_stack([ellipses, coverage, agreement])


def _with_evidence(image: Float32, candidates: Array, polarity: int, known_shape: bool) -> Array:
    """Candidates for which the image shows some ring near the ellipse."""
    evidence = np.zeros((len(candidates), 2))
    ring_evidence(image, candidates[:, :5], np.full(len(candidates), float(polarity)), 24, evidence)
    score, hits = (11.0, 0.66) if known_shape else (8.5, 0.6)
    keep = (evidence[:, 0] > score) & (evidence[:, 1] >= hits)
    return candidates[keep]


def _distinct(candidates: Array) -> Array:
    """Candidates in order of support without those that repeat a better one."""
    order = np.argsort(-candidates[:, 5] * candidates[:, 6], kind="stable")
    candidates = candidates[order]
    radius = np.sqrt(candidates[:, 2] * candidates[:, 3])
    alive = np.ones(len(candidates), bool)
    for k in range(len(candidates)):
        if alive[k]:
            c = candidates[k]
            near = np.hypot(candidates[k + 1 :, 0] - c[0], candidates[k + 1 :, 1] - c[1]) < 0.1 * c[3] + 1.0
            alive[k + 1 :] &= ~(near & (np.abs(radius[k + 1 :] - radius[k]) < 0.04 * radius[k] + 1.0))
    return candidates[alive]


@dataclass(frozen=True)
class Ring:
    """A ring that was found, and how good it is.

    Attributes
    ----------
    fit : RingFit
    distinction : float
        See `evidence.distinction`.
    """

    fit: RingFit
    distinction: float

    @property
    def ellipse(self) -> Ellipse:
        return self.fit.ellipse

    @property
    def quality(self) -> float:
        """Distinction times the square of the coverage: a partial ring must stand out more."""
        return self.distinction * self.fit.coverage**2

    @property
    def confident(self) -> bool:
        """Complete and clear: needs no confirmation."""
        return self.fit.coverage > 0.85 and self.quality > 10


def detect_ellipses(
    texture: Float32,
    settings: RivetSettings | None = None,
    shapes: CircleShapes | None = None,
    radii: tuple[float, float] | None = None,
) -> list[Ring]:
    """Rings in an image.

    Parameters
    ----------
    texture : (h, w) array
        Grey levels; NaN where there are none.
    settings : RivetSettings
    shapes : CircleShapes
        What a circle looks like in each part of the image. Without it the confident rings tell it to the others.
    radii : (least, most)
        Radii looked for, px; the settings' limits without it.

    Returns
    -------
    list of Ring
        Best first.
    """
    settings = settings or RivetSettings()
    image = np.ascontiguousarray(texture, np.float32)
    bounds = radii or (settings.min_diameter_px / 2, settings.max_diameter_px / 2)
    if shapes is not None:
        return suppress_repeats(_rings(image, bounds, shapes, [], [], settings))
    rings = _rings(image, bounds, None, [], [], settings)
    shapes = shapes_of([r.ellipse for r in suppress_repeats(rings) if r.confident], image.shape)
    if shapes is None:
        return suppress_repeats(rings)
    sure = [r for r in rings if r.confident and _agrees(r.ellipse, shapes)]
    others = [r.ellipse for r in rings if not any(r is s for s in sure)]
    return suppress_repeats(_rings(image, bounds, shapes, sure, others, settings))


def _rings(
    image: Float32,
    radii: tuple[float, float],
    shapes: CircleShapes | None,
    known: list[Ring],
    likely: list[Ellipse],
    settings: RivetSettings,
) -> list[Ring]:
    """Known rings and those that likely places and suspects lead to, repeats included."""
    rings = list(known)
    starts = list(likely)
    for level in levels_for(*radii):
        starts += _suspects(image, level, shapes or CircleShapes.round(), settings)
    for start in starts:
        if not any(_same(start, r.ellipse) for r in rings):
            ring = _verified(image, start, shapes, radii, settings)
            if ring is not None:
                rings.append(ring)
    return rings


def _same(ellipse: Ellipse, other: Ellipse) -> bool:
    """Whether a suspect would only lead to a ring that has been found."""
    return (
        math.hypot(ellipse.u - other.u, ellipse.v - other.v) < 0.2 * other.b
        and abs(ellipse.radius - other.radius) < 0.15 * other.radius
    )


def _within(ellipse: Ellipse, other: Ellipse) -> bool:
    return bool(np.hypot(ellipse.u - other.u, ellipse.v - other.v) < other.b)


def _suspects(image: Float32, level: Level, shapes: CircleShapes, settings: RivetSettings) -> list[Ellipse]:
    """Ellipses at one resolution that ridge points support, in pixels of the image, best first."""
    k = level.reduction
    small = image
    if k > 1:
        small = cv2.resize(image, None, fx=1 / k, fy=1 / k, interpolation=cv2.INTER_AREA).astype(np.float32)
    field = RidgeField.of(small, 1.4 if k == 1 else 1.0)
    found = []
    for polarity in (1, -1):
        arcs = trace_arcs(field, polarity, (settings.ridge_low, settings.ridge_high), 7, 0.35)
        candidates = _candidates(arcs, (small.shape[0], small.shape[1]), level, shapes, settings)
        candidates = candidates[candidates[:, 5] >= 0.38]
        candidates[:, :2] = (candidates[:, :2] + 0.5) * k - 0.5
        candidates[:, 2:4] *= k
        found.append(_with_evidence(image, candidates, polarity, shapes.known))
    return [Ellipse.of(c[:5]) for c in _distinct(np.concatenate(found))]


def _verified(
    image: Float32, start: Ellipse, shapes: CircleShapes | None, radii: tuple[float, float], settings: RivetSettings
) -> Ring | None:
    """The ring at a suspect, if it is one."""
    reach = float(np.clip(0.6 * start.b, 4.5, 7.5))
    limits = np.array([reach, 0.85 * radii[0], 1.15 * radii[1], 0.55, 0.5, 3.0])
    shape = None
    if shapes is not None:
        start = shapes.ellipse(start.u, start.v, start.radius)
        shape = start.shape
    fit = fit_ring(image, start, 1.0, limits, shape)
    if fit is None or not _is_rim(fit, settings) or not _is_line(image, fit):
        return None
    if shape is None and fit.coverage < settings.min_coverage_alone:
        return None
    ring = Ring(fit, float(distinction(image, fit.ellipse.parameters, fit.sigma_px)))
    return ring if ring.quality >= settings.min_quality else None


def _is_rim(ring: RingFit, settings: RivetSettings) -> bool:
    """Whether a fit is a rim and not a blob, an edge or a crossing of lines.

    A rim is a thin line that shows all round and stands out against skin and head alike. At the edge of a sticker or a
    hole the step in brightness is the larger part, and what the model's ring finds is its misfit.
    """
    beside_head = abs(ring.amplitude) - 0.5 * max(0.0, np.sign(ring.amplitude) * ring.step)
    return bool(
        ring.score >= settings.min_score
        and ring.coverage >= settings.min_coverage
        and ring.sigma_px < min(2.1, 0.4 * ring.ellipse.b)
        and beside_head > 0.3 * abs(ring.amplitude)
        and abs(ring.amplitude) > settings.min_ring_share * abs(ring.step)
    )


def _agrees(ellipse: Ellipse, shapes: CircleShapes) -> bool:
    expected = shapes.ellipse(ellipse.u, ellipse.v, 1.0)
    return bool(np.linalg.norm(log_shape(ellipse) - log_shape(expected)) < 0.05)


def _is_line(image: Float32, ring: RingFit) -> bool:
    """Whether the image itself is darker (or brighter) on the ellipse than on both sides of it."""
    beside = max(2.5, 2.5 * ring.sigma_px)
    levels = np.empty(3)
    ring_profile(image, ring.ellipse.parameters, np.array([-beside, 0.0, beside]), levels)
    contrasts = np.sign(ring.amplitude) * (levels[1] - levels[::2])
    return bool(np.min(contrasts) > _LEAST_CONTRAST * abs(ring.amplitude))


def suppress_repeats(rings: list[Ring]) -> list[Ring]:
    """One ring per rivet: of rings within each other the best stays, the larger of equals (a recess has a rim)."""
    kept: list[Ring] = []
    for ring in sorted(rings, key=lambda r: -r.quality * r.ellipse.radius):
        if not any(_within(ring.ellipse, q.ellipse) or _within(q.ellipse, ring.ellipse) for q in kept):
            kept.append(ring)
    return kept

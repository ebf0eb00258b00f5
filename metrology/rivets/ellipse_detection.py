"""Rivet detection in the image (paper §3.1): arcs, votes near suspects, and the joint fit that decides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.rivets.ellipse import Ellipse
from metrology.rivets.evidence import distinction, ring_profile, settle
from metrology.rivets.ring import RingFit, fit_ring
from metrology.rivets.settings import RivetSettings
from metrology.rivets.shapes import CircleShapes, shapes_of
from metrology.rivets.suspects import ANY_SHAPE, KNOWN_SHAPE, STRONG, Evidence, levels_for, suspects, trace

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]

_SHADOW = 1.6  # radii about a clear ring's centre in which no other rim is looked for
_APART = 0.85  # of the sum of two rings' radii, at least, between their centres
_TELLING = 12  # confident rings: their mean elongation is told to a third of what one ring's is
_USUAL_SIGMA_PX = 1.0  # half-width of a ring
_WORTH_A_TRY_PX = 0.7  # from the first start: the fit leads back from less
_LEAST_CONTRAST = 0.15  # of a ring against either side, as a share of its amplitude


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
    traces = [trace(image, level, settings) for level in levels_for(*bounds)]

    def rings(
        known: CircleShapes | None, evidence: Evidence, likely: Sequence[Ring] = (), enough: int = 0
    ) -> list[Ring]:
        starts = [r.ellipse for r in likely]
        for t in traces:
            starts += suspects(image, t, known or CircleShapes.round(), settings, evidence)
        return _verified_rings(image, starts, known, bounds, settings, enough)

    if shapes is not None:
        return suppress_repeats(rings(shapes, KNOWN_SHAPE))
    strong = rings(None, STRONG, enough=_TELLING)
    learnt = shapes_of([r.ellipse for r in suppress_repeats(strong) if r.confident], image.shape)
    if learnt is None:
        return suppress_repeats(rings(None, ANY_SHAPE))
    return suppress_repeats(rings(learnt, ANY_SHAPE, likely=strong))


def _verified_rings(
    image: Float32,
    starts: Sequence[Ellipse],
    shapes: CircleShapes | None,
    radii: tuple[float, float],
    settings: RivetSettings,
    enough: int,
) -> list[Ring]:
    """The rings that suspects lead to, some more than once; no more than until `enough` are confident, unless 0."""
    rings: list[Ring] = []
    for start in starts:
        if enough and sum(r.confident for r in rings) >= enough:
            break
        if not any(_same(start, r.ellipse) or (r.confident and _shadowed(start, r.ellipse)) for r in rings):
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


def _shadowed(ellipse: Ellipse, other: Ellipse) -> bool:
    """Whether a suspect cannot be another head beside a clear ring: heads do not overlap.

    The flanks of a clear ring, its highlights and its recess make such, and curves that share a part of it. Larger ones
    about the same centre may be heads round a recess.
    """
    distance = math.hypot(ellipse.u - other.u, ellipse.v - other.v)
    if distance < 0.3 * other.b:
        return ellipse.radius < _SHADOW * other.radius
    return distance < _APART * (ellipse.radius + other.radius)


def _within(ellipse: Ellipse, other: Ellipse) -> bool:
    return bool(np.hypot(ellipse.u - other.u, ellipse.v - other.v) < other.b)


def _verified(
    image: Float32, start: Ellipse, shapes: CircleShapes | None, radii: tuple[float, float], settings: RivetSettings
) -> Ring | None:
    """The ring at a suspect, if it is one."""
    reach = float(np.clip(0.6 * start.b, 4.5, 7.5))
    limits = np.array([reach, 0.85 * radii[0], 1.15 * radii[1], 0.55, 0.5, 2.0])
    shape = None
    if shapes is not None:
        start = shapes.ellipse(start.u, start.v, start.radius)
        shape = start.shape
    near = np.empty(5)
    settle(image, start.parameters, _USUAL_SIGMA_PX, near)
    if max(_line_contrast(image, e, _USUAL_SIGMA_PX) for e in (start.parameters, near)) <= 0:
        return None
    fit = fit_ring(image, start, _USUAL_SIGMA_PX, limits, shape)
    if fit is None or not _is_rim(fit, settings):
        # A glint or a gap in the ring has pulled the suspect aside: once more from where a whole ring shows best.
        if np.abs(near - start.parameters).max() < _WORTH_A_TRY_PX:
            return None
        fit = fit_ring(image, Ellipse.of(near), _USUAL_SIGMA_PX, limits, shape)
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
        and beside_head > 0.1 * abs(ring.amplitude)
        and abs(ring.amplitude) > settings.min_ring_share * abs(ring.step)
    )


def _is_line(image: Float32, ring: RingFit) -> bool:
    """Whether the image itself is darker (or brighter) on the ellipse than on both sides of it."""
    contrast = _line_contrast(image, ring.ellipse.parameters, ring.sigma_px)
    return contrast > _LEAST_CONTRAST * abs(ring.amplitude)


def _line_contrast(image: Float32, ellipse: Array, sigma_px: float) -> float:
    """How much darker than both sides of it, or brighter, an ellipse is (grey levels); negative at an edge."""
    beside = max(2.5, 2.5 * sigma_px)
    levels = np.empty(3)
    ring_profile(image, ellipse, np.array([-beside, 0.0, beside]), levels)
    inside, outside = levels[1] - levels[0], levels[1] - levels[2]
    return float(min(abs(inside), abs(outside)) * np.sign(inside * outside))


def suppress_repeats(rings: list[Ring]) -> list[Ring]:
    """One ring per rivet: of rings within each other the best stays, the larger of equals (a recess has a rim)."""
    kept: list[Ring] = []
    for ring in sorted(rings, key=lambda r: -r.quality * r.ellipse.radius):
        if not any(_within(ring.ellipse, q.ellipse) or _within(q.ellipse, ring.ellipse) for q in kept):
            kept.append(ring)
    return kept

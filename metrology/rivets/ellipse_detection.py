"""Rivet detection in the image (paper §3.1): arcs, votes near suspects, and the joint fit that decides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array, Float32
from metrology.rivets.alike import rings_alike
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.evidence import distinction, ring_steps, settle
from metrology.rivets.ring import RingFit, fit_ring
from metrology.rivets.settings import RivetSettings
from metrology.rivets.shapes import SHAPE_TOLERANCE, CircleShapes, log_shape, shapes_of
from metrology.rivets.suspects import ANY_SHAPE, KNOWN_SHAPE, STRONG, Evidence, Traces, levels_for, suspects, trace

_SHADOW = 1.6  # radii about a clear ring's centre in which no other rim is looked for
_WHOLE = 0.85  # of a ring's sectors in which it shows: nothing of it is missing
_APART = 0.85  # of the sum of two rings' radii, at least, between their centres
_FAINT = 40.0  # quality of usual rings, below which arcs of smaller and partial ones are lost in the grain
_CLEAR = 2.0  # ridges of this many times the least strength are of clear rings
_TELLING = 12  # confident rings: their mean elongation is told to a third of what one ring's is
_USUAL_SIGMA_PX = 1.0  # half-width of a ring
_WORTH_A_TRY_PX = 0.7  # from the first start: the fit leads back from less
# Two scratches that cross a small circle cover it at four places of three σ each, aslant: 4 · 3σ √2 / 2πr of it. A rim
# covers a tenth more.
_CROSSED, _BEYOND = 2.7, 0.1
_LEAST_CONTRAST = 0.15  # of a ring against either side, as a share of its amplitude


@dataclass(frozen=True)
class Ring:
    """A ring that was found, and how good it is."""

    fit: RingFit
    distinction: float
    """See `evidence.distinction`."""

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
        return self.fit.coverage > _WHOLE and self.quality > 10


def detect_ellipses(
    texture: Float32,
    settings: RivetSettings | None = None,
    shapes: CircleShapes | None = None,
    radii: tuple[float, float] | None = None,
    relief: Sequence[Ellipse] = (),
) -> list[Ring]:
    """Rings in an image.

    Parameters
    ----------
    texture : (h, w) array
        Grey levels; NaN where there are none.
    shapes : CircleShapes
        What a circle looks like in each part of the image. Without it the confident rings tell it to the others.
    radii : (least, most)
        Radii looked for, px; the settings' limits without it.
    relief : sequence of Ellipse
        Where the surface steps as at a head's rim: there a ring is tried that no arcs lead to.

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
        known: CircleShapes | None, evidence: Evidence, arcs: Sequence[Traces], likely: Sequence[Ring] = ()
    ) -> list[Ring]:
        starts = [r.ellipse for r in likely]
        for t in arcs:
            starts += suspects(image, t, known or CircleShapes.round(), settings, evidence)
        return _verified_rings(image, starts, known, bounds, settings, enough=_TELLING if evidence is STRONG else None)

    if shapes is not None:
        found = rings(shapes, KNOWN_SHAPE, traces)
        hidden = [e for e in relief if not any(_within(e, r.ellipse) for r in found)]
        found += _verified_rings(image, hidden, shapes, bounds, settings, enough=None)
        return suppress_repeats(found + _alike(image, suppress_repeats(found), shapes, bounds, settings))
    # The clearest rings tell what circles look like; where they are too few, all that are beyond doubt.
    clear = [t.stronger(_CLEAR * settings.ridge_low) for t in traces]
    for arcs in (clear, traces):
        strong = rings(None, STRONG, arcs)
        learnt = shapes_of([r.ellipse for r in suppress_repeats(strong) if r.confident], image.shape)
        if learnt is not None:
            return suppress_repeats(rings(learnt, ANY_SHAPE, traces, likely=strong))
    return suppress_repeats(rings(None, ANY_SHAPE, traces))


def _alike(
    image: Float32, rings: Sequence[Ring], shapes: CircleShapes, radii: tuple[float, float], settings: RivetSettings
) -> list[Ring]:
    """More rings like those that are beyond doubt, beside them, where these are so faint that arcs may be lost."""
    clear = [r for r in rings if r.confident]
    if not clear or np.median([r.quality for r in clear]) > _FAINT:
        return []
    dark = sum(r.fit.amplitude < 0 for r in clear) >= 0.5 * len(clear)
    starts = rings_alike(image, [r.ellipse for r in clear], dark, shapes)
    free = [
        s
        for s in starts
        if not any(math.hypot(s.u - r.ellipse.u, s.v - r.ellipse.v) < _APART * (s.b + r.ellipse.b) for r in rings)
    ]
    return _verified_rings(image, free, shapes, radii, settings, enough=None)


def _verified_rings(
    image: Float32,
    starts: Sequence[Ellipse],
    shapes: CircleShapes | None,
    radii: tuple[float, float],
    settings: RivetSettings,
    enough: int | None,
) -> list[Ring]:
    """The rings that suspects lead to, some more than once, until `enough` are confident."""
    rings: list[Ring] = []
    found: list[tuple[Ellipse, float, bool]] = []
    for start in starts:
        if enough is not None and sum(confident for _, _, confident in found) >= enough:
            break
        size = start.radius
        if not any(
            _same(start, size, e, radius) or (confident and _shadowed(start, size, e, radius))
            for e, radius, confident in found
        ):
            ring = _verified(image, start, shapes, radii, settings)
            if ring is not None:
                rings.append(ring)
                found.append((ring.ellipse, ring.ellipse.radius, ring.confident))
    return rings


def _same(ellipse: Ellipse, radius: float, other: Ellipse, other_radius: float) -> bool:
    """Whether a suspect would only lead to a ring that has been found."""
    return (
        math.hypot(ellipse.u - other.u, ellipse.v - other.v) < 0.2 * other.b
        and abs(radius - other_radius) < 0.15 * other_radius
    )


def _shadowed(ellipse: Ellipse, radius: float, other: Ellipse, other_radius: float) -> bool:
    """Whether a suspect cannot be another head beside a clear ring: heads do not overlap.

    The flanks of a clear ring, its highlights and its recess make such, and curves that share a part of it. Larger ones
    about the same centre may be heads round a recess.
    """
    distance = math.hypot(ellipse.u - other.u, ellipse.v - other.v)
    if distance < 0.3 * other.b:
        return radius < _SHADOW * other_radius
    return distance < _APART * (radius + other_radius)


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
    fit = _fitted(image, start, shape, limits, settings)
    if fit is None:
        # A glint or a gap in the ring has pulled the suspect aside: once more from where a whole ring shows best.
        near = np.empty(5)
        settle(image, start.parameters, _USUAL_SIGMA_PX, near)
        if np.abs(near - start.parameters).max() < _WORTH_A_TRY_PX:
            return None
        fit = _fitted(image, Ellipse.of(near), shape, limits, settings)
    if fit is None:
        return None
    if fit.coverage < _WHOLE:
        # From a start far off, the part of a ring that was seen first may hold the fit beside the rest.
        again = _fitted(image, fit.ellipse, shape, limits, settings)
        if again and again.coverage > fit.coverage and again.noise < fit.noise:
            fit = again
    if shape is None and fit.coverage < settings.min_coverage_alone:
        return None
    if shape is not None and np.linalg.norm(log_shape(fit.ellipse) - log_shape(start)) > SHAPE_TOLERANCE:
        return None
    ring = Ring(fit, float(distinction(image, fit.ellipse.parameters, fit.sigma_px)))
    return ring if ring.quality >= settings.min_quality else None


def _fitted(
    image: Float32, start: Ellipse, shape: Array | None, limits: Array, settings: RivetSettings
) -> RingFit | None:
    """The rim that the joint fit finds at a suspect; it is not tried where no line shows, as along a sticker's edge."""
    if _line_contrast(image, start.parameters, _USUAL_SIGMA_PX) <= 0:
        return None
    fit = fit_ring(image, start, _USUAL_SIGMA_PX, limits, shape)
    return fit if fit is not None and _is_rim(fit, settings) and _is_line(image, fit) else None


def _is_rim(ring: RingFit, settings: RivetSettings) -> bool:
    """Whether a fit is a rim and not a blob, an edge or a crossing of lines.

    A rim is a thin line that shows all round and stands out against skin and head alike. At the edge of a sticker or a
    hole the step in brightness is the larger part, and what the model's ring finds is its misfit.
    """
    beside_head = abs(ring.amplitude) - 0.5 * max(0.0, np.sign(ring.amplitude) * ring.step)
    return bool(
        ring.score >= settings.min_score
        and ring.coverage >= max(settings.min_coverage, _CROSSED * ring.sigma_px / ring.ellipse.radius + _BEYOND)
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
    steps = np.empty(2)
    ring_steps(image, ellipse, np.array([-beside, beside]), steps)
    inside, outside = steps
    return float(min(abs(inside), abs(outside)) * np.sign(inside * outside))


def suppress_repeats(rings: list[Ring]) -> list[Ring]:
    """One ring per rivet: of rings within each other the best stays, the larger of equals (a recess has a rim)."""
    kept: list[Ring] = []
    for ring in sorted(rings, key=lambda r: -r.quality * r.ellipse.radius):
        if not any(_within(ring.ellipse, q.ellipse) or _within(q.ellipse, ring.ellipse) for q in kept):
            kept.append(ring)
    return kept

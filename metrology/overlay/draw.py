"""The overlay of one scene: rivets and seam stations through the calibrated projector (paper §5.1, Fig. 9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.errors import UsageError
from metrology.fastener import size_verdict
from metrology.overlay.layout import Layout
from metrology.overlay.legend import draw_legend, entries
from metrology.overlay.marks import (
    BAR_END_MM,
    COLOURS,
    GRAVEST_FIRST,
    Label,
    Stroke,
    circle_points,
    rivet_marks,
    seam_marks,
)
from metrology.overlay.paint import paint, paint_svg, text_size
from metrology.overlay.skin_map import map_skin
from metrology.results import Decision, Feature, Features, Hole, Rivet, SeamStation, Severity, of_type
from metrology.skin_normal import skin_normal
from metrology.verdicts import DECISIONS

Array = NDArray[np.float64]

_MISSING = "MISSING"
_UNKNOWN_HOLE_MM = 8.0  # drawn for a hole whose size was not measured
_LEGEND_NAMES = 3  # ids of what is not shown, before "+ n"


@dataclass(frozen=True)
class OverlaySettings:
    """How the overlay looks.

    Attributes
    ----------
    background : int
        Grey level of the unmarked field, 0 … 255: dim enough for the marks, bright enough to see the skin.
    text_height_mm : float
        Height of a capital letter on the skin; 4 mm reads well at 1 m.
    line_width_px : int
        Base line width in projector pixels.
    label_every_mm : float
        Distance between value labels along a seam whose verdict does not change.
    """

    background: int = 24
    text_height_mm: float = 4.0
    line_width_px: int = 2
    label_every_mm: float = 50.0

    def __post_init__(self) -> None:
        if not 0 <= self.background <= 255:
            raise UsageError(f"overlay background: found {self.background}, expected 0 … 255")
        if self.text_height_mm <= 0 or self.line_width_px < 1 or self.label_every_mm <= 0:
            raise UsageError("overlay: found a size that is not positive, expected positive sizes")


@dataclass(frozen=True)
class Overlay:
    """A finished overlay.

    Attributes
    ----------
    size : (width, height)
        The projector's, pixels.
    background : int
        Grey level.
    strokes, labels
        What is drawn, projector pixels.
    outside : tuple of str
        Ids of the rivets, and of the seams with stations, that the projector's field does not reach.
    """

    size: tuple[int, int]
    background: int
    strokes: tuple[Stroke, ...]
    labels: tuple[Label, ...]
    outside: tuple[str, ...] = field(default=())

    def image(self) -> NDArray[np.uint8]:
        """(h, w, 3) uint8 RGB at the projector's resolution."""
        return paint(self.size, self.background, self.strokes, self.labels)

    def svg(self) -> str:
        """The same as an SVG document."""
        return paint_svg(self.size, self.background, self.strokes, self.labels)


@dataclass(frozen=True)
class _Wish:
    """A label that wants a place beside its feature: its centre (projector pixels) and half size (upright frame)."""

    feature: str
    text: str
    anchor: Array
    reach: Array
    severity: Severity | None


def draw_overlay(
    features: Features,
    reconstruction: Reconstruction,
    title: Sequence[str],
    settings: OverlaySettings | None = None,
) -> Overlay:
    """Draw the verdicts of one scene for the projector.

    Parameters
    ----------
    features : mapping
        Judged results by kind; what has no position is left out.
    reconstruction : Reconstruction
        Gives the rig, and the skin's place and direction.
    title : sequence of str
        Lines above the legend: station, date.
    """
    settings = settings or OverlaySettings()
    rivets, stations = of_type(features, Rivet), of_type(features, SeamStation)
    holes = of_type(features, Hole)
    projector = reconstruction.rig.projector
    skin = map_skin(reconstruction)
    layout = Layout(projector.width, projector.height, skin)
    text_px = settings.text_height_mm * skin.px_per_mm
    strokes: list[Stroke] = []
    wishes: list[_Wish] = []
    outside: list[str] = []

    # A missing fastener's place is drawn once: as the hole that is there.
    taken = {hole.fastener_id for hole in holes}
    circles = [(r.rivet_id, _rivet_text(r), _rim(r, reconstruction), r.severity) for r in rivets]
    circles = [circle for circle in circles if circle[0] not in taken]
    circles += [(h.hole_id, _hole_text(h), _hole_rim(h, reconstruction), h.severity) for h in holes]
    for name, text, outline, severity in circles:
        if outline is None:
            continue
        inside = projector.inside(outline)
        if not inside.all():
            outside.append(name)
            if not inside.any():
                continue
        marks = rivet_marks(outline, severity, settings.line_width_px)
        strokes += [replace(mark, feature=name) for mark in marks]
        extent = np.concatenate([mark.points for mark in marks])
        for mark in marks:
            layout.occupy(mark.points, mark.width)
        wishes.append(_Wish(name, text, outline.mean(0), layout.extent(extent), severity))

    for seam_id in dict.fromkeys(station.seam_id for station in stations):
        seam = [s for s in stations if s.seam_id == seam_id and s.x_mm is not None]
        if not seam:
            continue
        course = projector.project(np.array([(s.x_mm, s.y_mm, s.z_mm) for s in seam], float))
        if not projector.inside(course).all():
            outside.append(seam_id)
        for run in _runs(seam):
            severity = seam[run.start].severity
            reach = BAR_END_MM[severity] * skin.px_per_mm
            marks = seam_marks(course[run], severity, skin.px_per_mm, settings.line_width_px)
            strokes += [replace(mark, feature=seam_id) for mark in marks]
            for place in course[run][projector.inside(course[run])]:
                layout.occupy(place[None], reach)
            for k in _labelled(seam, run, settings.label_every_mm):
                if projector.inside(course[k]):
                    wishes.append(_Wish(seam_id, _seam_text(seam[k]), course[k], np.full(2, reach), severity))

    judged: list[Feature] = [*rivets, *stations, *holes]
    present = {item.severity for item in judged}
    key = [s for s in reversed(GRAVEST_FIRST) if s is not None or None in present]
    legend = entries(title, key, _notes(rivets, stations, outside))
    labels, shapes = draw_legend(legend, layout, text_px, skin.angle, settings.line_width_px)
    # Grave ones first: they get the best places. What is in order may go without its value where there is no room.
    for wish in sorted(wishes, key=lambda w: GRAVEST_FIRST.index(w.severity)):
        size = text_size(wish.text, text_px)
        place = layout.place(wish.anchor, wish.reach, size, must=wish.severity != "green")
        if place is None:
            continue
        labels.append(Label(wish.text, place, text_px, skin.angle, COLOURS[wish.severity], wish.feature))
        strokes += _leader(wish, place, size, layout)
    return Overlay(
        (projector.width, projector.height),
        settings.background,
        (*strokes, *shapes),
        tuple(labels),
        tuple(outside),
    )


def _rim(rivet: Rivet, reconstruction: Reconstruction) -> Array | None:
    """Outline of a rivet's head in projector pixels; None where it has no position."""
    if rivet.x_mm is None or rivet.y_mm is None or rivet.z_mm is None:
        return None
    centre = np.array([rivet.x_mm, rivet.y_mm, rivet.z_mm])
    diameter = rivet.diameter_mm or rivet.major_px * rivet.z_mm / reconstruction.rig.left.K[0, 0]
    normal = skin_normal(reconstruction.points, rivet.u_px, rivet.v_px, rivet.major_px)
    towards_rig = np.array([0.0, 0.0, -1.0])
    rig = reconstruction.rig
    return circle_points(centre, towards_rig if normal is None else normal, diameter / 2, rig.projector.project)


def _hole_rim(hole: Hole, reconstruction: Reconstruction) -> Array | None:
    """Outline of a hole in projector pixels; None where it has no position."""
    if hole.x_mm is None or hole.y_mm is None or hole.z_mm is None:
        return None
    diameter = hole.countersink_diameter_mm or hole.diameter_mm or _UNKNOWN_HOLE_MM
    reach = diameter * reconstruction.rig.left.K[0, 0] / hole.z_mm
    normal = skin_normal(reconstruction.points, hole.u_px, hole.v_px, reach)
    centre, towards_rig = np.array([hole.x_mm, hole.y_mm, hole.z_mm]), np.array([0.0, 0.0, -1.0])
    projector = reconstruction.rig.projector
    return circle_points(centre, towards_rig if normal is None else normal, diameter / 2, projector.project)


def _hole_text(hole: Hole) -> str:
    if hole.kind == "temporary fastener":
        return "TEMPORARY"
    size = "" if hole.diameter_mm is None else f" {hole.diameter_mm:.1f}"
    return f"{_MISSING} {hole.fastener_id}" if hole.kind == "missing fastener" else f"HOLE{size}"


def _rivet_text(rivet: Rivet) -> str:
    if rivet.height_mean_mm is None:
        return _MISSING if (rivet.reason or "").startswith(_MISSING.lower()) else "?"
    size = f" SIZE {rivet.diameter_mm:.1f}" if size_verdict(rivet) == "wrong" else ""
    return f"{_signed(rivet.height_mean_mm)}{_star(rivet.decision)}{size}"


def _seam_text(station: SeamStation) -> str:
    if station.step_mm is None and station.width_mm is None:
        return _MISSING if (station.reason or "").startswith(_MISSING.lower()) else "?"
    step = "?" if station.step_mm is None else _signed(station.step_mm)
    width = "?" if station.width_mm is None else f"{station.width_mm:.2f}"
    return f"{step} | {width}{_star(station.decision)}"


def _signed(value: float) -> str:
    """Hundredths of a millimetre with their sign; nothing is not minus nothing."""
    return f"{round(value, 2) + 0.0:+.2f}"


def _star(decision: Decision) -> str:
    return DECISIONS[decision].note


def _notes(rivets: Sequence[Rivet], stations: Sequence[SeamStation], outside: Sequence[str]) -> list[str]:
    """What the values are, and what the picture does not show."""
    meanings = (["RIVET height"] if rivets else []) + (["SEAM step | gap"] if stations else [])
    notes = [f"mm: {', '.join(meanings)}"] if meanings else []
    judged: list[Rivet | SeamStation] = [*rivets, *stations]
    for note in dict.fromkeys(DECISIONS[item.decision].note for item in judged):
        if note:
            notes.append(f"{note} within U95 of a limit")
    if outside:
        more = len(outside) - _LEGEND_NAMES
        names = ", ".join(outside[:_LEGEND_NAMES]) + (f" + {more}" if more > 0 else "")
        notes.append(f"beyond the picture: {names}")
    return notes


def _leader(wish: _Wish, place: Array, size: tuple[float, float], layout: Layout) -> list[Stroke]:
    """A thin line from a feature to its value where they are apart."""
    half = np.array(size) / 2
    offset = layout.to_upright(place - wish.anchor)
    gap = np.maximum(np.abs(offset) - wish.reach - half, 0)
    if np.hypot(*gap) < half[1]:
        return []
    start = np.clip(offset, -wish.reach, wish.reach)
    end = offset - np.clip(offset, -half, half)
    ends = np.stack([wish.anchor + layout.to_projector(start), wish.anchor + layout.to_projector(end)])
    return [Stroke(ends, COLOURS[wish.severity], 1, feature=wish.feature)]


def _runs(stations: Sequence[SeamStation]) -> list[slice]:
    """Slices of consecutive stations with the same severity."""
    cuts = [k for k in range(1, len(stations)) if stations[k].severity != stations[k - 1].severity]
    edges = [0, *cuts, len(stations)]
    return [slice(a, b) for a, b in pairwise(edges)]


def _labelled(stations: Sequence[SeamStation], run: slice, every_mm: float) -> list[int]:
    """Indices of the stations of a run that get a label: its worst, and others at a distance."""
    members = range(run.start, run.stop)
    worst = max(members, key=lambda k: (abs(stations[k].step_mm or 0.0), stations[k].width_mm or 0.0))
    chosen = [worst]
    for k in members:
        if all(abs(stations[k].s_mm - stations[c].s_mm) >= every_mm for c in chosen):
            chosen.append(k)
    return chosen

"""The marks and labels of one kind of feature: rings round what has one place, bars along what has a course."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from metrology.arrays import Array
from metrology.kinds import Kind, load
from metrology.overlay.layout import Layout
from metrology.overlay.marks import BAR_END_MM, Stroke, arrow_marks, circle_points, rivet_marks, seam_marks
from metrology.overlay.skin_map import MeasuredSkin, screen
from metrology.overlay.words import Words
from metrology.results import MISSING, Feature, Severity
from metrology.skin_normal import skin_normal
from metrology.verdicts import DECISIONS

_OUTLINE_POINTS = 64
_LONG = 1.15  # times as long as wide in the left image
_RING_PX = 20.0  # a ring round what has no size of its own, in the left image


@dataclass(frozen=True)
class Wish:
    """A label that wants a place beside its feature: its centre (projector pixels) and half size (upright frame)."""

    feature: str
    text: str
    anchor: Array
    reach: Array
    severity: Severity | None


@dataclass(frozen=True)
class Canvas:
    """What is drawn on, and what was drawn so far."""

    reconstruction: MeasuredSkin
    layout: Layout
    px_per_mm: float
    """Projector pixels per millimetre of skin."""
    line_width: int
    label_every_mm: float
    names: Mapping[str, str] | None = None
    """What is written before the values, by the names of single features and of courses; without it, nothing is."""
    words: Words = field(default_factory=Words)
    strokes: list[Stroke] = field(default_factory=list)
    wishes: list[Wish] = field(default_factory=list)
    outside: list[str] = field(default_factory=list)
    """Names of what the projector's field does not reach, at least in part."""

    def named(self, name: str, text: str) -> str:
        """A label's text, behind the name of its feature where names are written."""
        return text if self.names is None else f"{self.names.get(name, name)} {text}"


def mark_rings(kind: Kind, rows: Sequence[Feature], canvas: Canvas) -> None:
    """A ring round each feature, of its own size where it has one."""
    projector, layout = screen(canvas.reconstruction.rig), canvas.layout
    for row in rows:
        outline, name = _ring(kind, row, canvas.reconstruction), kind.id_of(row)
        if outline is None:
            continue
        inside = projector.inside(outline)
        if not inside.all():
            canvas.outside.append(name)
            if not inside.any():
                continue
        marks = rivet_marks(outline, row.severity, canvas.line_width)
        if _is_long(kind, row):
            marks += arrow_marks(outline, row.severity, canvas.line_width)
        canvas.strokes.extend(replace(mark, feature=name) for mark in marks)
        extent = np.concatenate([mark.points for mark in marks])
        for mark in marks:
            layout.occupy(mark.points, mark.width)
        canvas.wishes.append(
            Wish(
                name,
                canvas.named(name, _text(kind, row, canvas.words)),
                outline.mean(0),
                layout.extent(extent),
                row.severity,
            )
        )


def mark_course(kind: Kind, rows: Sequence[Feature], canvas: Canvas) -> None:
    """Bars along each course, of the shape that the verdict has there."""
    projector, layout = screen(canvas.reconstruction.rig), canvas.layout
    name_column, position = kind.id_columns
    names = [getattr(row, name_column) for row in rows]
    for name in dict.fromkeys(names):
        course = [row for row, own in zip(rows, names, strict=True) if own == name and row.x_mm is not None]
        if not course:
            continue
        places = projector.project(np.array([(row.x_mm, row.y_mm, row.z_mm) for row in course], float))
        if not projector.inside(places).all():
            canvas.outside.append(name)
        for run in _runs([row.severity for row in course]):
            severity = course[run.start].severity
            reach = BAR_END_MM[severity] * canvas.px_per_mm
            marks = seam_marks(places[run], severity, canvas.px_per_mm, canvas.line_width)
            canvas.strokes.extend(replace(mark, feature=name) for mark in marks)
            for place in places[run][projector.inside(places[run])]:
                layout.occupy(place[None], reach)
        along = np.array([getattr(row, position) for row in course])
        for k, text in _values(kind, course, along, canvas):
            severity = course[k].severity
            if projector.inside(places[k]):
                reach = BAR_END_MM[severity] * canvas.px_per_mm
                canvas.wishes.append(Wish(name, canvas.named(name, text), places[k], np.full(2, reach), severity))


def _is_long(kind: Kind, row: Any) -> bool:
    """Whether a feature has a direction: a round one has none."""
    return bool(kind.along) and row.major_px is not None and row.major_px > _LONG * row.minor_px


def _ring(kind: Kind, row: Feature, reconstruction: MeasuredSkin) -> Array | None:
    """Outline of a feature in projector pixels; None where it has no position.

    Of what is longer than wide it begins at an end of its length.
    """
    if row.x_mm is None or row.y_mm is None or row.z_mm is None:
        return None
    size: float = getattr(row, "major_px", None) or _RING_PX
    normal = skin_normal(reconstruction.points, row.u_px, row.v_px, size)
    normal = np.array([0.0, 0.0, -1.0]) if normal is None else normal
    centre, project = np.array([row.x_mm, row.y_mm, row.z_mm]), screen(reconstruction.rig).project
    if kind.along and getattr(row, kind.along) is not None:
        return project(_ellipse(kind, row, reconstruction, centre, normal))
    own = max((getattr(row, column) or 0.0 for column in kind.size), default=0.0)
    diameter: float = own or size * row.z_mm / reconstruction.rig.left.K[0, 0]
    return circle_points(centre, normal, diameter / 2, project)


def _ellipse(kind: Kind, row: Any, reconstruction: MeasuredSkin, centre: Array, normal: Array) -> Array:
    """(n, 3) the outline that a feature has in the left image, on the tangent plane of the skin, mm."""
    left, turn = reconstruction.rig.left, np.radians(getattr(row, kind.along))
    t = np.linspace(0, 2 * np.pi, _OUTLINE_POINTS, endpoint=False)[:, None]
    along = np.array([np.cos(turn), np.sin(turn)])
    across = np.array([-along[1], along[0]])
    pixels = [row.u_px, row.v_px] + 0.5 * (row.major_px * np.cos(t) * along + row.minor_px * np.sin(t) * across)
    rays = left.rays(pixels)
    return np.asarray(rays * (normal @ centre / (rays @ normal))[:, None])


def _text(kind: Kind, row: Feature, words: Words) -> str:
    """The values that the projector writes beside a feature, to hundredths."""
    shown = [quantity for quantity in kind.quantities_of(row) if quantity.projected]
    values: list[Any] = [getattr(row, quantity.column) for quantity in shown]
    note = words.note(load(kind.note)(row)) if kind.note else ""
    if all(value is None for value in values):
        return note or (words.text(MISSING.upper()) if row.is_missing else "?")
    said = [words.number(_said(value, quantity.signed)) for value, quantity in zip(values, shown, strict=True)]
    return " | ".join(said) + DECISIONS[row.decision].note + (f" {note}" if note else "")


def _said(value: float | None, signed: bool) -> str:
    """A value to hundredths; nothing is not minus nothing."""
    if value is None:
        return "?"
    return f"{round(value, 2) + 0.0:+.2f}" if signed else f"{value:.2f}"


def _values(kind: Kind, course: Sequence[Any], along: Array, canvas: Canvas) -> Iterator[tuple[int, str]]:
    """Where values are written along a course: once for a stretch, at its worst position and with its length."""
    sizes = _sizes(kind, course)
    for run in _runs([row.stretch or row.severity for row in course]):
        if course[run.start].stretch is None:
            yield from (
                (k, _text(kind, course[k], canvas.words)) for k in _labelled(sizes, along, run, canvas.label_every_mm)
            )
            continue
        worst = max(range(run.start, run.stop), key=lambda k: (_beyond(course[k]), sizes[k]))
        text, n = _text(kind, course[worst], canvas.words), run.stop - run.start
        length = (along[run.stop - 1] - along[run.start]) * n / max(n - 1, 1)
        yield worst, f"{text} ({length:.0f} mm)" if length else text


def _beyond(row: Any) -> float:
    return -np.inf if row.beyond_mm is None else float(row.beyond_mm)


def _runs(values: Sequence[Any]) -> list[slice]:
    """Slices of consecutive values that are the same."""
    cuts = [k for k in range(1, len(values)) if values[k] != values[k - 1]]
    edges = [0, *cuts, len(values)]
    return [slice(a, b) for a, b in pairwise(edges)]


def _sizes(kind: Kind, rows: Sequence[Feature]) -> list[tuple[float, ...]]:
    """How large the values of each row are, the first quantity first."""
    return [tuple(abs(getattr(row, quantity.column) or 0.0) for quantity in kind.quantities) for row in rows]


def _labelled(sizes: Sequence[tuple[float, ...]], along: Array, run: slice, every_mm: float) -> list[int]:
    """Indices of the rows of a run that get a label: its worst, and others at a distance."""
    members = range(run.start, run.stop)
    chosen = [max(members, key=lambda k: sizes[k])]
    for k in members:
        if all(abs(along[k] - along[c]) >= every_mm for c in chosen):
            chosen.append(k)
    return chosen

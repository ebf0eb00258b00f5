"""Drawings of a report as SVG within the page: the marked picture, charts of values, profiles of courses, the map."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby, pairwise
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from metrology.assembly.picture import Stitched
from metrology.kinds import KINDS, Kind, Quantity
from metrology.results import Severity
from metrology.tolerance import Limit
from metrology.verdicts import IN_ORDER, SEVERITIES, Symbol
from storage.report.markup import number
from storage.report.verdicts import COLOURS
from storage.templates import data_uri, part
from storage.wording import AT, _, decimals, named

Row = Mapping[str, Any]

_PICTURE_WIDTH = 1200  # px of the picture in the page; the camera's own resolution is in the bundle
_JPEG_QUALITY = 82
_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 1100, 230, 62, 34
_BROKEN = (2.0, 4.0)  # dash and space of the rim of a head that was not judged
_ARM = 0.3  # half the width of a cross's arms
_CORNERS: dict[Symbol, list[tuple[float, float]]] = {
    "diamond": [(0, -1), (1, 0), (0, 1), (-1, 0)],
    "cross": [
        (_ARM, 0), (1, 1 - _ARM), (1 - _ARM, 1), (0, _ARM), (_ARM - 1, 1), (-1, 1 - _ARM),
        (-_ARM, 0), (-1, _ARM - 1), (_ARM - 1, -1), (0, -_ARM), (1 - _ARM, -1), (1, _ARM - 1),
    ],
}  # fmt: skip
"""Of symbols with corners, for a size of 1."""
_SIZE: dict[Symbol, float] = {"disc": 4.5, "diamond": 6.5, "cross": 5.5, "ring": 4.5}


def _drawn(what: str, *values: object) -> Markup:
    return part("storage.report", "drawings.html", what, *values)


def marked_picture(preview: NDArray[np.uint8], of_kind: Mapping[str, Sequence[Row]]) -> Markup:
    """What the left camera sees, with each feature's symbol, and the name and rim of what is no course."""
    height, width = preview.shape
    small = cv2.resize(preview, (_PICTURE_WIDTH, round(height * _PICTURE_WIDTH / width)), interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    unit = width / _PICTURE_WIDTH
    marks = [
        _placed(row["u_px"], row["v_px"], 0.6 * unit, row["severity"], _title(kind, row))
        if kind.is_course
        else _named_mark(kind, row, unit)
        for kind in reversed(KINDS)
        for row in of_kind.get(kind.name, ())
    ]
    return _drawn("picture", width, height, data_uri(jpeg.tobytes(), "jpeg"), marks)


def _named_mark(kind: Kind, row: Row, unit: float) -> Markup:
    u, v, title = row["u_px"], row["v_px"], _title(kind, row)
    reach = (row.get("major_px") or 0.0) / 2
    return (
        (_rim(kind, row, unit, title) if reach else Markup())
        + _placed(u, v, unit, row["severity"], title)
        + _drawn("name", u + reach + 7 * unit, v, unit, kind.id_of(row))
    )


def _rim(kind: Kind, row: Row, unit: float, title: str) -> Markup:
    """The ellipse of a head, or of a defect, in the picture."""
    look = SEVERITIES[row["severity"]]
    width = (5.0 if look.symbol == "cross" else 3.0) * unit
    broken = [dash * unit for dash in _BROKEN] if look.symbol == "ring" else []
    return _drawn("rim", row, row[kind.along or "angle_deg"], unit, look.paper, width, broken, title)


def _placed(x: float, y: float, scale: float, severity: Severity | None, title: str) -> Markup:
    """A symbol at a place of a drawing that has units of its own."""
    return _drawn("placed", x, y, scale, _symbol(0, 0, severity, title))


def _title(kind: Kind, row: Row) -> str:
    if kind.is_course:
        name, position = (row[column] for column in kind.id_columns)
        return f"{_(AT, name=name, place=f'{position:.0f}')}: {_(row['decision'])}"
    first = kind.quantities[0]
    value = row[first.column]
    said = _("not measured") if value is None else f"{number(value, 4, first.signed)} {first.unit}"
    return f"{kind.id_of(row)}: {said}, {_(row['decision'])}"


class _Axes:
    """A drawing's scales: data to picture coordinates."""

    def __init__(self, x: tuple[float, float], y: tuple[float, float]) -> None:
        margin = 0.06 * (y[1] - y[0]) or 1.0
        self.x0, self.x1 = x if x[1] > x[0] else (x[0] - 1, x[0] + 1)
        self.y0, self.y1 = y[0] - margin, y[1] + margin

    def x(self, value: float) -> float:
        return _LEFT + (value - self.x0) / (self.x1 - self.x0) * (_WIDTH - _LEFT - 12)

    def y(self, value: float) -> float:
        return 12 + (self.y1 - value) / (self.y1 - self.y0) * (_HEIGHT - _BOTTOM - 12)

    def frame(self, label: str) -> list[Markup]:
        ends = _LEFT, _WIDTH - 12
        lines = [_drawn("tick", *ends, self.y(tick), decimals(f"{tick:.10g}")) for tick in ticks(self.y0, self.y1)]
        return [*lines, _drawn("axis_title", (_HEIGHT - _BOTTOM) / 2 + 6, label)]


def ticks(low: float, high: float) -> list[float]:
    """Round numbers within a range."""
    step = 10.0 ** np.floor(np.log10((high - low) / 3))
    step *= next(k for k in (1, 2, 5, 10) if (high - low) / (step * k) <= 7)
    return [round(float(t), 10) + 0.0 for t in np.arange(np.ceil(low / step) * step, high, step)]


def _chart(marks: Sequence[Markup]) -> Markup:
    return _drawn("chart", _WIDTH, _HEIGHT, marks)


def _limit_lines(axes: _Axes, places: Sequence[tuple[float, float]], limits: Sequence[Limit | None]) -> list[Markup]:
    """The limits of features that stand one beside the other, each over its own stretch of x; equal ones run on."""
    lines = []
    for kind, (colour, dash) in enumerate((*[(COLOURS["blue"], "8 4")] * 2, *[(COLOURS["red"], "2 3")] * 2)):
        values = [limit.bounds[kind] if limit else None for limit in limits]
        for value, run in groupby(range(len(values)), key=values.__getitem__):
            if value is None or not axes.y0 < value < axes.y1:
                continue
            members = list(run)
            x1, x2, y = axes.x(places[members[0]][0]), axes.x(places[members[-1]][1]), axes.y(value)
            lines.append(_drawn("limit", x1, x2, y, colour, dash, decimals(f"{value:g}")))
    return lines


def _span(values: Sequence[float], limits: Sequence[Limit | None]) -> tuple[float, float]:
    """Range of values, with the limits that are near it."""
    low, high = min(values), max(values)
    reach = max(high - low, 1e-3)
    near = {v for limit in limits if limit for v in (limit.lower, limit.upper) if v is not None}
    inside = [v for v in near if low - 2 * reach <= v <= high + 2 * reach]
    return min([low, *inside]), max([high, *inside])


def values_chart(kind: Kind, rows: Sequence[Row], limits: Sequence[Limit | None]) -> Markup:
    """First quantity of each feature with its U95, and its own limits; "" where nothing was measured."""
    first = kind.quantities[0]
    values = [row[first.column] for row in rows if row[first.column] is not None]
    if not values:
        return Markup()
    axes = _Axes((0, len(rows) + 1), _span([*values, 0.0], limits))
    places = [(k - 0.5, k + 0.5) for k in range(1, len(rows) + 1)]
    marks = [*axes.frame(f"{_(first.said)}, {first.unit}"), *_limit_lines(axes, places, limits)]
    every = max(1, len(rows) // 40)
    for k, row in enumerate(rows, 1):
        x = axes.x(k)
        if k % every == 0:
            marks.append(_drawn("label", x + 4, _HEIGHT - _BOTTOM + 10, kind.id_of(row)))
        if row[first.column] is None:
            marks.append(_drawn("text", x, axes.y(0), "middle", "?"))
            continue
        y, u95 = row[first.column], row[first.u95_column] or 0.0
        marks.append(_drawn("u95", x, axes.y(y - u95), axes.y(y + u95)))
        marks.append(_symbol(x, axes.y(y), row["severity"], _title(kind, row)))
    return _chart(marks)


def _symbol(x: float, y: float, severity: Severity | None, title: str) -> Markup:
    """The severity's symbol, with a white edge on whatever lies under it."""
    look = SEVERITIES[severity]
    r = _SIZE[look.symbol]
    if look.symbol in _CORNERS:
        return _drawn("polygon", _points((x + r * a, y + r * b) for a, b in _CORNERS[look.symbol]), look.paper, title)
    fill, edge, width = (look.paper, "#fff", 1) if look.symbol == "disc" else ("#fff", look.paper, 2)
    return _drawn("circle", x, y, r, fill, edge, width, title)


def _points(places: Iterable[tuple[float, float]]) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in places)


def course_chart(kind: Kind, quantity: Quantity, course: Sequence[Row], limits: Sequence[Limit | None]) -> Markup:
    """A quantity along a course with its U95 band and each place's limits; "" where nothing was measured."""
    value, u95, position = quantity.column, quantity.u95_column, kind.id_columns[1]
    shown = [row for row in course if row[value] is not None]
    if not shown:
        return Markup()
    along = [float(row[position]) for row in course]
    axes = _Axes((along[0], along[-1]), _span([row[value] for row in shown], limits))
    marks = [*axes.frame(f"{_(quantity.said)}, {quantity.unit}"), *_limit_lines(axes, _stretches(along), limits)]
    for measured, run in groupby(course, key=lambda row: row[value] is not None):
        if not measured:
            continue
        piece = list(run)
        upper = [(axes.x(row[position]), axes.y(row[value] + (row[u95] or 0))) for row in piece]
        lower = [(axes.x(row[position]), axes.y(row[value] - (row[u95] or 0))) for row in piece]
        marks.append(_drawn("band", _points([*upper, *reversed(lower)])))
        marks.append(_drawn("profile", _points((axes.x(row[position]), axes.y(row[value])) for row in piece)))
    marks += [
        _drawn("text", axes.x(tick), _HEIGHT - 14, "middle", decimals(f"{tick:g}")) for tick in ticks(axes.x0, axes.x1)
    ]
    marks.append(_drawn("text", _WIDTH - 12, _HEIGHT - 1, "end", _("mm along the {subject}", subject=_(kind.subject))))
    return _chart(marks)


def _stretches(s: Sequence[float]) -> list[tuple[float, float]]:
    """Half-way to the neighbours on both sides, mm along the course."""
    middles = [s[0], *(0.5 * (a + b) for a, b in pairwise(s)), s[-1]]
    return list(pairwise(middles))


def panel_map(
    of_kind: Mapping[str, Sequence[Row]], not_seen: Sequence[Row] = (), picture: Stitched | None = None
) -> Markup:
    """The panel from outside: features in panel coordinates; "" where none has any.

    Parameters
    ----------
    not_seen : sequence of mapping
        Rows of `panel_coverage`; where they should be there is a question mark.
    picture : Stitched, optional
        What lies under them.
    """
    rows = [
        (kind, row) for kind in reversed(KINDS) for row in of_kind.get(kind.name, ()) if row["x_panel_mm"] is not None
    ]
    if not rows:
        return Markup()
    places = [(row["x_panel_mm"], row["y_panel_mm"]) for _, row in rows]
    places += [(row["x_mm"], row["y_mm"]) for row in not_seen]
    ground = Markup()
    if picture is not None:
        width, height = picture.size_mm
        places += [(picture.left_mm, picture.top_mm), (picture.left_mm + width, picture.top_mm - height)]
        ground = _drawn("ground", _jpeg_of(picture), picture.left_mm, -picture.top_mm, width, height)
    (x0, y0), (x1, y1) = np.min(places, axis=0) - 15, np.max(places, axis=0) + 15
    unit = max(x1 - x0, y1 - y0) / 1000
    marks = [
        _placed(
            row["x_panel_mm"],
            -row["y_panel_mm"],
            (0.6 if kind.is_course else 1.0) * unit,
            row["severity"],
            _title(kind, row),
        )
        for kind, row in rows
    ]
    marks += [
        _drawn("name", row["x_panel_mm"] + 8 * unit, -row["y_panel_mm"], unit, kind.id_of(row))
        for kind, row in rows
        if not kind.is_course and row["decision"] not in IN_ORDER
    ]
    marks += [_drawn("name", row["x_mm"], -row["y_mm"], unit, f"? {named(row['feature_id'])}") for row in not_seen]
    return _drawn("map", x0, -y1, x1 - x0, y1 - y0, [ground, *marks])


def _jpeg_of(picture: Stitched) -> str:
    """A stitched picture, pale, on white, as a URI."""
    pale = np.where(picture.seen, 128 + picture.grey // 2, 255).astype(np.uint8)
    share = min(1.0, _PICTURE_WIDTH / pale.shape[1])
    small = cv2.resize(pale, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return data_uri(jpeg.tobytes(), "jpeg")

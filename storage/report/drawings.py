"""Drawings of a report as SVG within the page: the marked picture, heights of rivets, profiles of seams, the map."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby, pairwise
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from metrology.results import Severity
from metrology.tolerance import Limit
from metrology.verdicts import SEVERITIES, Symbol
from storage.report.markup import data_uri
from storage.report.verdicts import COLOURS
from storage.templates import part

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


def marked_picture(preview: NDArray[np.uint8], rivets: Sequence[Row], stations: Sequence[Row]) -> Markup:
    """What the left camera sees, with each rivet's rim, name and symbol, and the symbols of seam stations."""
    height, width = preview.shape
    small = cv2.resize(preview, (_PICTURE_WIDTH, round(height * _PICTURE_WIDTH / width)), interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    unit = width / _PICTURE_WIDTH
    marks = [_station_mark(station, station["u_px"], station["v_px"], unit) for station in stations]
    marks += [_rivet_mark(rivet, unit) for rivet in rivets]
    return _drawn("picture", width, height, data_uri(jpeg.tobytes(), "jpeg"), marks)


def _rivet_mark(rivet: Row, unit: float) -> Markup:
    look = SEVERITIES[rivet["severity"]]
    width = (5.0 if look.symbol == "cross" else 3.0) * unit
    broken = [dash * unit for dash in _BROKEN] if look.symbol == "ring" else []
    u, v = rivet["u_px"], rivet["v_px"]
    return (
        _drawn("rim", rivet, unit, look.paper, width, broken, _title(rivet))
        + _placed(u, v, unit, rivet["severity"], _title(rivet))
        + _drawn("name", u + rivet["major_px"] / 2 + 7 * unit, v, unit, rivet["rivet_id"])
    )


def _station_mark(station: Row, x: float, y: float, unit: float) -> Markup:
    title = f"{station['seam_id']} at {station['s_mm']:.0f} mm: {station['decision']}"
    return _placed(x, y, 0.6 * unit, station["severity"], title)


def _placed(x: float, y: float, scale: float, severity: Severity | None, title: str) -> Markup:
    """A symbol at a place of a drawing that has units of its own."""
    return _drawn("placed", x, y, scale, _symbol(0, 0, severity, title))


def _title(rivet: Row) -> str:
    height = rivet["height_mean_mm"]
    value = "not measured" if height is None else f"{height:+.4f} mm"
    return f"{rivet['rivet_id']}: {value}, {rivet['decision']}"


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
        lines = [_drawn("tick", *ends, self.y(tick), f"{tick:.10g}") for tick in _ticks(self.y0, self.y1)]
        return [*lines, _drawn("axis_title", (_HEIGHT - _BOTTOM) / 2 + 40, label)]


def _ticks(low: float, high: float) -> list[float]:
    step = 10.0 ** np.floor(np.log10((high - low) / 3))
    step *= next(k for k in (1, 2, 5, 10) if (high - low) / (step * k) <= 7)
    return [round(float(t), 10) for t in np.arange(np.ceil(low / step) * step, high, step)]


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
            lines.append(_drawn("limit", x1, x2, y, colour, dash, f"{value:g}"))
    return lines


def _span(values: Sequence[float], limits: Sequence[Limit | None]) -> tuple[float, float]:
    """Range of values, with the limits that are near it."""
    low, high = min(values), max(values)
    reach = max(high - low, 1e-3)
    near = {v for limit in limits if limit for v in (limit.lower, limit.upper) if v is not None}
    inside = [v for v in near if low - 2 * reach <= v <= high + 2 * reach]
    return min([low, *inside]), max([high, *inside])


def heights_chart(rivets: Sequence[Row], limits: Sequence[Limit | None]) -> Markup:
    """Height of each rivet with its U95, and its own limits; "" where nothing was measured."""
    values = [r["height_mean_mm"] for r in rivets if r["height_mean_mm"] is not None]
    if not values:
        return Markup()
    axes = _Axes((0, len(rivets) + 1), _span([*values, 0.0], limits))
    places = [(k - 0.5, k + 0.5) for k in range(1, len(rivets) + 1)]
    marks = [*axes.frame("height, mm"), *_limit_lines(axes, places, limits)]
    every = max(1, len(rivets) // 40)
    for k, rivet in enumerate(rivets, 1):
        x = axes.x(k)
        if k % every == 0:
            marks.append(_drawn("label", x + 4, _HEIGHT - _BOTTOM + 10, rivet["rivet_id"]))
        if rivet["height_mean_mm"] is None:
            marks.append(_drawn("text", x, axes.y(0), "middle", "?"))
            continue
        y, u95 = rivet["height_mean_mm"], rivet["height_u95_mm"] or 0.0
        marks.append(_drawn("u95", x, axes.y(y - u95), axes.y(y + u95)))
        marks.append(_symbol(x, axes.y(y), rivet["severity"], _title(rivet)))
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


def seam_chart(stations: Sequence[Row], quantity: str, limits: Sequence[Limit | None]) -> Markup:
    """Step or width along a seam with its U95 band and each place's limits; "" where nothing was measured."""
    name = f"{quantity}_mm"
    values = [s[name] for s in stations if s[name] is not None]
    if not values:
        return Markup()
    axes = _Axes((stations[0]["s_mm"], stations[-1]["s_mm"]), _span(values, limits))
    marks = [*axes.frame(f"{quantity}, mm"), *_limit_lines(axes, _stretches(stations), limits)]
    for measured, run in groupby(stations, key=lambda s: s[name] is not None):
        if not measured:
            continue
        piece = list(run)
        upper = [(axes.x(s["s_mm"]), axes.y(s[name] + (s[f"{quantity}_u95_mm"] or 0))) for s in piece]
        lower = [(axes.x(s["s_mm"]), axes.y(s[name] - (s[f"{quantity}_u95_mm"] or 0))) for s in piece]
        marks.append(_drawn("band", _points([*upper, *reversed(lower)])))
        marks.append(_drawn("profile", _points((axes.x(s["s_mm"]), axes.y(s[name])) for s in piece)))
    ticks = _ticks(axes.x0, axes.x1)
    marks += [_drawn("text", axes.x(tick), _HEIGHT - 14, "middle", f"{tick:g}") for tick in ticks]
    marks.append(_drawn("text", _WIDTH - 12, _HEIGHT - 1, "end", "mm along the seam"))
    return _chart(marks)


def _stretches(stations: Sequence[Row]) -> list[tuple[float, float]]:
    """Half-way to the neighbours on both sides, mm along the seam."""
    s = [float(station["s_mm"]) for station in stations]
    middles = [s[0], *(0.5 * (a + b) for a, b in pairwise(s)), s[-1]]
    return list(pairwise(middles))


def panel_map(rivets: Sequence[Row], stations: Sequence[Row]) -> Markup:
    """The panel from outside: rivets and seam stations in panel coordinates; "" where none has any."""
    places = [(f["x_panel_mm"], f["y_panel_mm"]) for f in (*rivets, *stations) if f["x_panel_mm"] is not None]
    if not places:
        return Markup()
    (x0, y0), (x1, y1) = np.min(places, axis=0) - 15, np.max(places, axis=0) + 15
    unit = max(x1 - x0, y1 - y0) / 1000
    marks = [
        _station_mark(station, station["x_panel_mm"], -station["y_panel_mm"], unit)
        for station in stations
        if station["x_panel_mm"] is not None
    ]
    marks += [
        _placed(rivet["x_panel_mm"], -rivet["y_panel_mm"], unit, rivet["severity"], _title(rivet))
        for rivet in rivets
        if rivet["x_panel_mm"] is not None
    ]
    return _drawn("map", x0, -y1, x1 - x0, y1 - y0, marks)

"""Drawings of a report as SVG within the page: the marked picture, heights of rivets, profiles of seams, the map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from itertools import groupby, pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.results import Severity
from metrology.tolerance import Limit
from metrology.verdicts import SEVERITIES, Symbol
from storage.report.markup import data_uri
from storage.report.verdicts import COLOURS

Row = Mapping[str, Any]

_PICTURE_WIDTH = 1200  # px of the picture in the page; the camera's own resolution is in the bundle
_JPEG_QUALITY = 82
_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 1100, 230, 62, 34
_BROKEN = "2 4"  # the rim of a head that was not judged
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


def marked_picture(
    preview: NDArray[np.uint8], rivets: Sequence[Row], stations: Sequence[Row], holes: Sequence[Row] = ()
) -> str:
    """What the left camera sees, with each rivet's rim, name and symbol, and the symbols of seam stations and holes."""
    height, width = preview.shape
    small = cv2.resize(preview, (_PICTURE_WIDTH, round(height * _PICTURE_WIDTH / width)), interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    unit = width / _PICTURE_WIDTH
    marks = [_station_mark(station, unit) for station in stations]
    marks += [_rivet_mark(rivet, unit) for rivet in rivets]
    marks += [_hole_mark(hole, unit) for hole in holes]
    return (
        f'<svg viewBox="-0.5 -0.5 {width} {height}" xmlns="http://www.w3.org/2000/svg" role="img">'
        f'<image href="{data_uri(jpeg.tobytes(), "jpeg")}" x="-0.5" y="-0.5" width="{width}" height="{height}"/>'
        f"{''.join(marks)}</svg>"
    )


def _rivet_mark(rivet: Row, unit: float) -> str:
    look = SEVERITIES[rivet["severity"]]
    width = (5.0 if look.symbol == "cross" else 3.0) * unit
    u, v, angle = rivet["u_px"], rivet["v_px"], rivet["angle_deg"]
    broken = _BROKEN if look.symbol == "ring" else ""
    dashes = f' stroke-dasharray="{" ".join(str(float(d) * unit) for d in broken.split())}"' if broken else ""
    size = 15 * unit
    ellipse = (
        f'<ellipse cx="{u:.1f}" cy="{v:.1f}" rx="{rivet["major_px"] / 2 + 4 * unit:.1f}" '
        f'ry="{rivet["minor_px"] / 2 + 4 * unit:.1f}" transform="rotate({angle:.1f} {u:.1f} {v:.1f})" fill="none" '
    )
    return (
        f'{ellipse}stroke="#fff" stroke-width="{width + 2.4 * unit:.1f}"/>'
        f'{ellipse}stroke="{look.paper}" stroke-width="{width:.1f}"{dashes}><title>{_title(rivet)}</title></ellipse>'
        f"{_placed(u, v, unit, rivet['severity'], _title(rivet))}"
        f'<text x="{u + rivet["major_px"] / 2 + 7 * unit:.1f}" y="{v + size / 3:.1f}" font-size="{size:.0f}" '
        f'font-family="sans-serif" fill="#fff" stroke="#000" stroke-width="{3 * unit:.1f}" paint-order="stroke">'
        f"{escape(rivet['rivet_id'])}</text>"
    )


def _hole_mark(hole: Row, unit: float) -> str:
    title = escape(f"{hole['hole_id']} {hole['kind']}: {hole['decision']}")
    u, v, size = hole["u_px"], hole["v_px"], 15 * unit
    return (
        f"{_placed(u, v, unit, hole['severity'], title)}"
        f'<text x="{u + size:.1f}" y="{v + size / 3:.1f}" font-size="{size:.0f}" font-family="sans-serif" '
        f'fill="#fff" stroke="#000" stroke-width="{3 * unit:.1f}" paint-order="stroke">{escape(hole["hole_id"])}</text>'
    )


def _station_mark(station: Row, unit: float) -> str:
    title = escape(f"{station['seam_id']} at {station['s_mm']:.0f} mm: {station['decision']}")
    return _placed(station["u_px"], station["v_px"], 0.6 * unit, station["severity"], title)


def _placed(x: float, y: float, scale: float, severity: Severity | None, title: str) -> str:
    """A symbol at a place of a drawing that has units of its own."""
    return f'<g transform="translate({x:.2f} {y:.2f}) scale({scale:.4f})">{_symbol(0, 0, severity, title)}</g>'


def _title(rivet: Row) -> str:
    height = rivet["height_mean_mm"]
    value = "not measured" if height is None else f"{height:+.4f} mm"
    return escape(f"{rivet['rivet_id']}: {value}, {rivet['decision']}")


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

    def frame(self, label: str) -> str:
        lines = []
        for tick in _ticks(self.y0, self.y1):
            y = self.y(tick)
            lines.append(
                f'<line x1="{_LEFT}" x2="{_WIDTH - 12}" y1="{y:.1f}" y2="{y:.1f}" stroke="#e3e7eb"/>'
                f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{tick:.10g}</text>'
            )
        lines.append(
            f'<text transform="translate(13 {(_HEIGHT - _BOTTOM) / 2 + 40:.0f}) rotate(-90)">{escape(label)}</text>'
        )
        return "".join(lines)


def _ticks(low: float, high: float) -> list[float]:
    step = 10.0 ** np.floor(np.log10((high - low) / 3))
    step *= next(k for k in (1, 2, 5, 10) if (high - low) / (step * k) <= 7)
    return [round(float(t), 10) for t in np.arange(np.ceil(low / step) * step, high, step)]


def _svg(content: str) -> str:
    return (
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" xmlns="http://www.w3.org/2000/svg" role="img" '
        f'font-family="sans-serif" font-size="12" fill="#5b6875">{content}</svg>'
    )


def _limit_lines(axes: _Axes, places: Sequence[tuple[float, float]], limits: Sequence[Limit | None]) -> str:
    """The limits of features that stand one beside the other, each over its own stretch of x; equal ones run on."""
    lines = []
    for kind, (colour, dash) in enumerate((*[(COLOURS["blue"], "8 4")] * 2, *[(COLOURS["red"], "2 3")] * 2)):
        values = [limit.bounds[kind] if limit else None for limit in limits]
        for value, run in groupby(range(len(values)), key=values.__getitem__):
            if value is None or not axes.y0 < value < axes.y1:
                continue
            members = list(run)
            x1, x2, y = axes.x(places[members[0]][0]), axes.x(places[members[-1]][1]), axes.y(value)
            lines.append(
                f'<line x1="{x1:.1f}" x2="{x2:.1f}" y1="{y:.1f}" y2="{y:.1f}" '
                f'stroke="{colour}" stroke-dasharray="{dash}"><title>limit {value:g}</title></line>'
            )
    return "".join(lines)


def _span(values: Sequence[float], limits: Sequence[Limit | None]) -> tuple[float, float]:
    """Range of values, with the limits that are near it."""
    low, high = min(values), max(values)
    reach = max(high - low, 1e-3)
    near = {v for limit in limits if limit for v in (limit.lower, limit.upper) if v is not None}
    inside = [v for v in near if low - 2 * reach <= v <= high + 2 * reach]
    return min([low, *inside]), max([high, *inside])


def heights_chart(rivets: Sequence[Row], limits: Sequence[Limit | None]) -> str:
    """Height of each rivet with its U95, and its own limits; "" where nothing was measured."""
    shown = [r for r in rivets if r["height_mean_mm"] is not None]
    if not shown:
        return ""
    values = [r["height_mean_mm"] for r in shown]
    axes = _Axes((0, len(rivets) + 1), _span([*values, 0.0], limits))
    places = [(k - 0.5, k + 0.5) for k in range(1, len(rivets) + 1)]
    marks = [axes.frame("height, mm"), _limit_lines(axes, places, limits)]
    every = max(1, len(rivets) // 40)
    for k, rivet in enumerate(rivets, 1):
        x = axes.x(k)
        if k % every == 0 or every == 1:
            marks.append(
                f'<text transform="translate({x + 4:.1f} {_HEIGHT - _BOTTOM + 10}) rotate(-60)" text-anchor="end" '
                f'font-size="10">{escape(rivet["rivet_id"])}</text>'
            )
        if rivet["height_mean_mm"] is None:
            marks.append(f'<text x="{x:.1f}" y="{axes.y(0):.1f}" text-anchor="middle">?</text>')
            continue
        y, u95 = rivet["height_mean_mm"], rivet["height_u95_mm"] or 0.0
        marks.append(
            f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{axes.y(y - u95):.1f}" y2="{axes.y(y + u95):.1f}" stroke="#1c2733"/>'
            + _symbol(x, axes.y(y), rivet["severity"], _title(rivet))
        )
    return _svg("".join(marks))


def _symbol(x: float, y: float, severity: Severity | None, title: str) -> str:
    """The severity's symbol, with a white edge on whatever lies under it."""
    look = SEVERITIES[severity]
    r, said = _SIZE[look.symbol], f"<title>{title}</title>"
    if look.symbol in _CORNERS:
        corners = " ".join(f"{x + r * a:.1f},{y + r * b:.1f}" for a, b in _CORNERS[look.symbol])
        return f'<polygon points="{corners}" fill="{look.paper}" stroke="#fff">{said}</polygon>'
    fill, edge, width = (look.paper, "#fff", 1) if look.symbol == "disc" else ("#fff", look.paper, 2)
    style = f'fill="{fill}" stroke="{edge}" stroke-width="{width}"'
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{r}" {style}>{said}</circle>'


def seam_chart(stations: Sequence[Row], quantity: str, limits: Sequence[Limit | None]) -> str:
    """Step or width along a seam with its U95 band and each place's limits; "" where nothing was measured."""
    name = f"{quantity}_mm"
    shown = [s for s in stations if s[name] is not None]
    if not shown:
        return ""
    axes = _Axes((stations[0]["s_mm"], stations[-1]["s_mm"]), _span([s[name] for s in shown], limits))
    marks = [axes.frame(f"{quantity}, mm"), _limit_lines(axes, _stretches(stations), limits)]
    for measured, run in groupby(stations, key=lambda s: s[name] is not None):
        if not measured:
            continue
        piece = list(run)
        upper = [(axes.x(s["s_mm"]), axes.y(s[name] + (s[f"{quantity}_u95_mm"] or 0))) for s in piece]
        lower = [(axes.x(s["s_mm"]), axes.y(s[name] - (s[f"{quantity}_u95_mm"] or 0))) for s in piece]
        band = " ".join(f"{x:.1f},{y:.1f}" for x, y in [*upper, *reversed(lower)])
        line = " ".join(f"{axes.x(s['s_mm']):.1f},{axes.y(s[name]):.1f}" for s in piece)
        marks.append(f'<polygon points="{band}" fill="#1c2733" fill-opacity="0.12"/>')
        marks.append(f'<polyline points="{line}" fill="none" stroke="#1c2733" stroke-width="1.5"/>')
    for tick in _ticks(axes.x0, axes.x1):
        marks.append(f'<text x="{axes.x(tick):.1f}" y="{_HEIGHT - 14}" text-anchor="middle">{tick:g}</text>')
    marks.append(f'<text x="{_WIDTH - 12}" y="{_HEIGHT - 1}" text-anchor="end">mm along the seam</text>')
    return _svg("".join(marks))


def _stretches(stations: Sequence[Row]) -> list[tuple[float, float]]:
    """Half-way to the neighbours on both sides, mm along the seam."""
    s = [float(station["s_mm"]) for station in stations]
    middles = [s[0], *(0.5 * (a + b) for a, b in pairwise(s)), s[-1]]
    return list(pairwise(middles))


def panel_map(rivets: Sequence[Row], stations: Sequence[Row]) -> str:
    """The panel from outside: rivets and seam stations in panel coordinates; "" where none has any."""
    places = [(f["x_panel_mm"], f["y_panel_mm"]) for f in (*rivets, *stations) if f["x_panel_mm"] is not None]
    if not places:
        return ""
    (x0, y0), (x1, y1) = np.min(places, axis=0) - 15, np.max(places, axis=0) + 15
    unit = max(x1 - x0, y1 - y0) / 1000
    marks = []
    for station in stations:
        if station["x_panel_mm"] is not None:
            title = escape(f"{station['seam_id']} at {station['s_mm']:.0f} mm: {station['decision']}")
            marks.append(_placed(station["x_panel_mm"], -station["y_panel_mm"], 0.6 * unit, station["severity"], title))
    for rivet in rivets:
        if rivet["x_panel_mm"] is not None:
            place = rivet["x_panel_mm"], -rivet["y_panel_mm"]
            marks.append(_placed(*place, unit, rivet["severity"], _title(rivet)))
    return (
        f'<svg viewBox="{x0:.1f} {-y1:.1f} {x1 - x0:.1f} {y1 - y0:.1f}" xmlns="http://www.w3.org/2000/svg" role="img" '
        f'style="border:1px solid #d7dde3;max-height:520px;width:100%">{"".join(marks)}</svg>'
    )

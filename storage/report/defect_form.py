"""Close-ups of defects in a report: a map of heights, and sections along and across with a straight-edge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup

from metrology.arrays import Array
from metrology.fits import DefectForm, DefectSection
from storage.fits import StoredFits
from storage.report.drawings import ticks
from storage.report.markup import figure, number, with_u95
from storage.report.verdicts import needs_attention
from storage.templates import data_uri, part
from storage.wording import N_, _, decimals

Row = Mapping[str, Any]

MOST = 12
"""Close-ups in a report: of a hail field the gravest."""
_MAP_PX = 240.0
_TOP, _BOTTOM = 26.0, 246.0
_LEFTS, _WIDTH = (345.0, 740.0), 345.0
_LINES = (
    (N_("along the defect, mm"), 0.0, "#00795a", ""),
    (N_("across the defect, mm"), 0.5 * np.pi, "#a8578c", "6 4"),
)
_LEAST_SCALE_MM = 0.02
_BELOW, _ON, _ABOVE, _UNSEEN = (0, 114, 178), (242, 242, 242), (213, 94, 0), (205, 208, 212)
_AIR = 0.12


def defect_forms(rows: Sequence[Row], fits: StoredFits) -> list[Markup]:
    """The gravest defects that need attention, the deepest first; [] where the run kept no form of them."""
    found = [(row, form) for row in rows if needs_attention(row) and (form := fits.form(row["defect_id"]))]
    found.sort(key=lambda pair: (pair[0]["decision"] != "fail", -abs(pair[0]["depth_mm"])))
    return [_close_up(row, form) for row, form in found[:MOST]]


def _close_up(row: Row, form: DefectForm) -> Markup:
    depth, sections = float(row["depth_mm"]), form.shown()
    rows, columns = form.heights.shape
    scale = _MAP_PX / (form.step_mm * max(rows, columns))
    picture, limit = _picture(form.heights)
    corner = (np.array(form.corner) - 0.5 * form.step_mm) * scale
    reach = form.reach_mm * scale
    lines = []
    for __, turn, colour, dash in _LINES:
        way = reach * np.array([np.cos(form.turn + turn), np.sin(form.turn + turn)])
        lines.append((*(-way - corner), *(way - corner), colour, dash))
    outline = _points(form.outline * scale - corner)
    place = 0.0, 0.0, columns * form.step_mm * scale, rows * form.step_mm * scale
    heights = np.concatenate([np.concatenate([s.surface, s.skin, [0.0]]) for s in sections])
    span = float(heights.min()), float(heights.max())
    charts = [_section(k, section, span, row) for k, section in enumerate(sections)]
    drawing = part("storage.report", "defect.html", "close_up", picture, place, outline, lines, charts)
    said = _(
        "{name}, {kind}. Map: full blue is {limit} mm below the skin as it would be, orange above, grey unseen; "
        "dotted: outline at half depth. Sections: black the surface, blue the skin as it would be",
        name=row["defect_id"], kind=_(row["kind"]), limit=number(limit, 2),
    )  # fmt: skip
    if depth > 0:
        gap = number(row["straight_edge_depth_mm"], 3)
        said += ", " + _("brown a straight-edge laid on it (greatest gap under one in any direction {gap} mm)", gap=gap)
    return figure(drawing, said + ".")


def _picture(heights: Array) -> tuple[str, float]:
    """The map as a picture, and the height of its full colours, mm."""
    limit = max(_LEAST_SCALE_MM, float(np.nanpercentile(np.abs(heights), 99)))
    share = np.clip(heights / limit, -1.0, 1.0)[..., None]
    on, below, above = (np.array(colour, float) for colour in (_ON, _BELOW, _ABOVE))
    colours = np.where(share < 0, on + share * (on - below), on + share * (above - on))
    colours = np.where(np.isfinite(share), colours, _UNSEEN)
    __, png = cv2.imencode(".png", colours[..., ::-1].astype(np.uint8))
    return data_uri(png.tobytes(), "png"), limit


def _section(number_: int, section: DefectSection, span: tuple[float, float], row: Row) -> Markup:
    left, (title, __, colour, dash) = _LEFTS[number_], _LINES[number_]
    air = max(_AIR * (span[1] - span[0]), 0.005)
    low, high = span[0] - air, span[1] + air
    reach = float(np.abs(section.t).max()) or 1.0

    def x(t: Array | float) -> Any:
        return left + (t + reach) / (2 * reach) * _WIDTH

    def y(h: Array | float) -> Any:
        return _TOP + (high - h) / (high - low) * (_BOTTOM - _TOP)

    depth, skin = float(row["depth_mm"]), float(np.interp(0.0, section.t, section.skin))
    arrow = x(0.0), y(skin), y(skin - depth), f"{with_u95(depth, row['depth_u95_mm'], 3, True)} mm"
    surface, bare = (_points(np.stack([x(section.t), y(h)], axis=1)) for h in (section.surface, section.skin))
    across = [(y(tick), decimals(f"{tick:.10g}")) for tick in ticks(low, high)]
    down = [(x(tick), decimals(f"{tick:.10g}")) for tick in ticks(-reach, reach)]
    edge = y(0.0) if depth > 0 else None
    shown = left, _WIDTH, _(title), colour, dash, across, down, bare, surface, edge, arrow
    return part("storage.report", "defect.html", "section", *shown)


def _points(places: Array) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in places)

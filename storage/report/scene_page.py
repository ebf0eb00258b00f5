"""The report of one scene."""

from __future__ import annotations

from html import escape

from metrology.kinds import HOLE, RIVET, SEAM_STATION
from storage.report.drawings import heights_chart, marked_picture
from storage.report.markup import data_uri, figure, moment, page
from storage.report.record import SceneRecord
from storage.report.sections import (
    decisions_table,
    feature_limits,
    hole_table,
    limits_table,
    rivet_table,
    seams,
    traceability,
    verdict,
)
from storage.report.verdicts import KEY

_MARKS = f"Rims and symbols: {KEY}."


def scene_page(record: SceneRecord) -> str:
    """One HTML page with pictures, tables, verdicts and what they rest on; it needs nothing else."""
    scene = record.scene
    title = f"{scene['aircraft_serial']} {scene['panel']} {scene['station']}"
    parts = [
        f"<h1>Inspection of {escape(title)}</h1>",
        f'<p class="sub">captured {moment(scene["captured_at"])}</p>',
        verdict(record.features),
        *(f'<div class="warning">{escape(text)}</div>' for text in scene["warnings"] or ()),
        '<div class="pair">',
        figure(
            marked_picture(
                record.preview,
                record.of_kind[RIVET.name],
                record.of_kind[SEAM_STATION.name],
                record.of_kind[HOLE.name],
            ),
            f"Left camera. {_MARKS}",
        ),
        figure(
            f'<img src="{data_uri(record.overlay_png, "png")}" alt="overlay">',
            "The overlay, as the projector shows it.",
        ),
        "</div>",
    ]
    if record.of_kind[RIVET.name]:
        parts.append("<h2>Rivets</h2>")
        if chart := heights_chart(
            record.of_kind[RIVET.name], feature_limits(record.of_kind[RIVET.name], RIVET.quantities[0], record.limits)
        ):
            parts.append(figure(chart, "Heights with their U95; dashed: the limits that each was judged by."))
        parts.append(rivet_table(record.of_kind[RIVET.name]))
    if record.of_kind[HOLE.name]:
        parts += ["<h2>Holes</h2>", hole_table(record.of_kind[HOLE.name])]
    if record.of_kind[SEAM_STATION.name]:
        parts += ["<h2>Seams</h2>", *seams(record.of_kind[SEAM_STATION.name], record.limits)]
    if decided := decisions_table(record):
        parts += ["<h2>Decisions of people</h2>", decided]
    parts += ["<h2>Limits</h2>", limits_table(record.limits), "<h2>Traceability</h2>", traceability(record)]
    return page(f"Inspection {title}", parts)

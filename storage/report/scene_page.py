"""The report of one scene."""

from __future__ import annotations

from html import escape

from metrology.kinds import KINDS
from storage.report.drawings import marked_picture
from storage.report.markup import data_uri, figure, moment, page
from storage.report.record import SceneRecord
from storage.report.sections import (
    decisions_table,
    features,
    limits_table,
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
            marked_picture(record.preview, record.of_kind),
            f"Left camera. {_MARKS}",
        ),
        figure(
            f'<img src="{data_uri(record.overlay_png, "png")}" alt="overlay">',
            "The overlay, as the projector shows it.",
        ),
        "</div>",
    ]
    for kind in KINDS:
        if rows := record.of_kind[kind.name]:
            parts += [f"<h2>{kind.subject.capitalize()}s</h2>", *features(kind, rows, record.limits)]
    if decided := decisions_table(record):
        parts += ["<h2>Decisions of people</h2>", decided]
    parts += ["<h2>Limits</h2>", limits_table(record.limits), "<h2>Traceability</h2>", traceability(record)]
    return page(f"Inspection {title}", parts)

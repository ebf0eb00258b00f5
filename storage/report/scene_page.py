"""The report of one scene."""

from __future__ import annotations

from storage.report.drawings import heights_chart, marked_picture
from storage.report.markup import figure, moment, page, png_figure
from storage.report.record import SceneRecord
from storage.report.sections import (
    decisions_table,
    feature_limits,
    limits_table,
    rivet_table,
    seams,
    traceability,
    verdict,
)
from storage.report.verdicts import KEY

_MARKS = f"Rims and symbols: {KEY}."
_HEIGHTS = "Heights with their U95; dashed: the limits that each was judged by."


def scene_page(record: SceneRecord) -> str:
    """One HTML page with pictures, tables, verdicts and what they rest on; it needs nothing else."""
    scene = record.scene
    name = f"{scene['aircraft_serial']} {scene['panel']} {scene['station']}"
    picture = marked_picture(record.preview, record.rivets, record.stations)
    chart = heights_chart(record.rivets, feature_limits(record.rivets, "height_mm", record.limits))
    return page(
        "scene.html",
        f"Inspection {name}",
        name=name,
        captured=moment(scene["captured_at"]),
        verdict=verdict(record.features),
        warnings=scene["warnings"] or (),
        picture=figure(picture, f"Left camera. {_MARKS}"),
        overlay=png_figure(record.overlay_png, "overlay", "The overlay, as the projector shows it."),
        heights=figure(chart, _HEIGHTS) if chart else "",
        rivets=rivet_table(record.rivets) if record.rivets else "",
        seams=seams(record.stations, record.limits),
        decisions=decisions_table(record),
        limits=limits_table(record.limits),
        traceability=traceability(record),
    )

"""The report of one scene."""

from __future__ import annotations

from metrology.kinds import RIVET, SEAM_STATION
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
    rivets, stations = record.of_kind[RIVET.name], record.of_kind[SEAM_STATION.name]
    name = f"{scene['aircraft_serial']} {scene['panel']} {scene['station']}"
    picture = marked_picture(record.preview, rivets, stations)
    chart = heights_chart(rivets, feature_limits(rivets, RIVET.quantities[0], record.limits))
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
        rivets=rivet_table(rivets) if rivets else "",
        seams=seams(stations, record.limits),
        decisions=decisions_table(record),
        limits=limits_table(record.limits),
        traceability=traceability(record),
    )

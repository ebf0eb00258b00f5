"""The report of one panel of one aircraft: the newest scan of each of its stations."""

from __future__ import annotations

from html import escape

from metrology.kinds import HOLE, RIVET, SEAM_STATION
from metrology.tolerance import PanelSpec
from storage.archive.work import said
from storage.report.drawings import marked_picture, panel_map
from storage.report.markup import badge, data_uri, figure, moment, page, table
from storage.report.record import PanelRecord, SceneRecord
from storage.report.sections import (
    decisions_table,
    entries_table,
    hole_table,
    limits_table,
    rivet_table,
    seams,
    station_table,
    traceability,
    verdict,
)
from storage.report.verdicts import KEY, gravest, needs_attention


def panel_page(record: PanelRecord) -> str:
    """One HTML page; it needs nothing else."""
    title = f"{record.aircraft_serial} {record.panel}"
    parts = [
        f"<h1>Inspection of {escape(title)}</h1>",
        f'<p class="sub">the newest scan of each of {len(record.scenes)} stations</p>',
        verdict(record.features),
        "<h2>Stations</h2>",
        _stations(record),
        *_maps(record),
        "<h2>Needs attention</h2>",
        _attention(record),
    ]
    if record.earlier_work:
        parts += ["<h2>Open work of earlier scans</h2>", entries_table(record.earlier_work, where=True)]
    for scene in record.scenes:
        parts += _station(scene)
    parts.append("<h2>Limits</h2>")
    parts += [limits_table(spec) for spec in _specifications(record)]
    parts.append("<h2>Traceability</h2>")
    for scene in record.scenes:
        parts += [f"<h3>Station {escape(scene.scene['station'])}</h3>", traceability(scene)]
    return page(f"Inspection {title}", parts)


def _anchor(scene: SceneRecord) -> str:
    return f"station-{escape(scene.scene['station'])}"


def _stations(record: PanelRecord) -> str:
    rows = [
        [
            f'<a href="#{_anchor(s)}">{escape(s.scene["station"])}</a>',
            moment(s.scene["captured_at"]),
            badge(gravest(s.features)),
            str(len(s.of_kind[RIVET.name])),
            str(len({station["seam_id"] for station in s.of_kind[SEAM_STATION.name]})),
            str(sum(needs_attention(feature) for feature in s.features)),
            escape(said(s.standings)),
            escape("; ".join(s.scene["warnings"] or ())),
        ]
        for s in record.scenes
    ]
    heads = ["station", "captured", "verdict", "rivets", "seams", "need attention", "findings", "warnings"]
    return table(heads, rows, [3, 4, 5])


def _maps(record: PanelRecord) -> list[str]:
    """One map of the panel where all stations share its frame, else none: each station has a frame of its own."""
    placed = [scene for scene in record.scenes if scene.has_common_frame]
    drawing = panel_map(
        [rivet for scene in placed for rivet in scene.of_kind[RIVET.name]],
        [station for scene in placed for station in scene.of_kind[SEAM_STATION.name]],
    )
    if not drawing:
        return []
    return ["<h2>Map</h2>", figure(drawing, f"In panel coordinates. {KEY}.")]


def _attention(record: PanelRecord) -> str:
    rivets = [rivet for scene in record.scenes for rivet in scene.of_kind[RIVET.name] if needs_attention(rivet)]
    stations = [
        station for scene in record.scenes for station in scene.of_kind[SEAM_STATION.name] if needs_attention(station)
    ]
    if not rivets and not stations:
        return "<p>Nothing.</p>"
    return (rivet_table(rivets, where=True) if rivets else "") + (
        station_table(stations, where=True) if stations else ""
    )


def _station(scene: SceneRecord) -> list[str]:
    parts = [
        f'<h2 id="{_anchor(scene)}">Station {escape(scene.scene["station"])}</h2>',
        verdict(scene.features),
        '<div class="pair">',
        figure(
            marked_picture(
                scene.preview,
                scene.of_kind[RIVET.name],
                scene.of_kind[SEAM_STATION.name],
                scene.of_kind[HOLE.name],
            ),
            "Left camera.",
        ),
        figure(f'<img src="{data_uri(scene.overlay_png, "png")}" alt="overlay">', "The overlay."),
        "</div>",
    ]
    if scene.of_kind[RIVET.name]:
        parts.append(rivet_table(scene.of_kind[RIVET.name]))
    if scene.of_kind[HOLE.name]:
        parts += ["<h3>Holes</h3>", hole_table(scene.of_kind[HOLE.name])]
    parts += seams(scene.of_kind[SEAM_STATION.name], scene.limits)
    if decided := decisions_table(scene):
        parts += ["<h3>Decisions of people</h3>", decided]
    return parts


def _specifications(record: PanelRecord) -> list[PanelSpec | None]:
    """The limits that were used, each once."""
    used: list[PanelSpec | None] = []
    for scene in record.scenes:
        if scene.limits not in used:
            used.append(scene.limits)
    return used

"""The report of one panel of one aircraft: the newest scan of each of its stations."""

from __future__ import annotations

from html import escape

from metrology.kinds import KINDS
from metrology.tolerance import PanelSpec
from storage.archive.work import said
from storage.report.drawings import marked_picture, panel_map
from storage.report.markup import badge, data_uri, figure, moment, page, table
from storage.report.record import PanelRecord, SceneRecord
from storage.report.sections import (
    decisions_table,
    entries_table,
    features,
    features_table,
    limits_table,
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
            *(str(len({row[kind.id_columns[0]] for row in s.of_kind[kind.name]})) for kind in KINDS),
            str(sum(needs_attention(feature) for feature in s.features)),
            escape(said(s.standings)),
            escape("; ".join(s.scene["warnings"] or ())),
        ]
        for s in record.scenes
    ]
    heads = ["station", "captured", "verdict", *(f"{kind.subject}s" for kind in KINDS), "need attention"]
    return table([*heads, "findings", "warnings"], rows, list(range(3, len(heads))))


def _maps(record: PanelRecord) -> list[str]:
    """One map of the panel where all stations share its frame, else none: each station has a frame of its own."""
    placed = [scene for scene in record.scenes if scene.has_common_frame]
    drawing = panel_map({kind.name: [row for scene in placed for row in scene.of_kind[kind.name]] for kind in KINDS})
    if not drawing:
        return []
    return ["<h2>Map</h2>", figure(drawing, f"In panel coordinates. {KEY}.")]


def _attention(record: PanelRecord) -> str:
    parts = []
    for kind in KINDS:
        rows = [row for scene in record.scenes for row in scene.of_kind[kind.name] if needs_attention(row)]
        parts += [features_table(kind, rows, where=True)] if rows else []
    return "".join(parts) or "<p>Nothing.</p>"


def _station(scene: SceneRecord) -> list[str]:
    parts = [
        f'<h2 id="{_anchor(scene)}">Station {escape(scene.scene["station"])}</h2>',
        verdict(scene.features),
        '<div class="pair">',
        figure(marked_picture(scene.preview, scene.of_kind), "Left camera."),
        figure(f'<img src="{data_uri(scene.overlay_png, "png")}" alt="overlay">', "The overlay."),
        "</div>",
    ]
    for kind in KINDS:
        if rows := scene.of_kind[kind.name]:
            parts += features(kind, rows, scene.limits, charted=False)
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

"""The report of one panel of one aircraft: the newest scan of each of its stations."""

from __future__ import annotations

from typing import Any

from markupsafe import Markup

from metrology.kinds import KINDS
from metrology.tolerance import PanelSpec
from storage.report.drawings import marked_picture, panel_map
from storage.report.letterhead import Letterhead
from storage.report.markup import badge, figure, link, moment, page, png_figure, table
from storage.report.record import PanelRecord, SceneRecord
from storage.report.sections import (
    decisions_table,
    entries_table,
    features,
    features_table,
    findings_of,
    limits_table,
    many,
    standings_said,
    traceability,
    verdict,
)
from storage.report.verdicts import gravest, key
from storage.wording import _, reason


def panel_page(record: PanelRecord, letterhead: Letterhead | None = None) -> str:
    """One HTML page; it needs nothing else."""
    name = f"{record.aircraft_serial} {record.panel}"
    return page(
        "panel.html",
        _("Inspection of {name}", name=name),
        letterhead=letterhead,
        name=name,
        verdict=verdict(record.features),
        overview=_overview(record),
        map=_map(record),
        attention=_attention(record),
        earlier_work=entries_table(record.earlier_work, where=True) if record.earlier_work else "",
        stations=[_station(scene) for scene in record.scenes],
        limits=[limits_table(spec) for spec in _specifications(record)],
    )


def _anchor(scene: SceneRecord) -> str:
    return f"station-{scene.scene['station']}"


def _overview(record: PanelRecord) -> Markup:
    kinds = [kind for kind in KINDS if kind.counts_in([row for s in record.scenes for row in s.of_kind[kind.name]])]
    rows = [
        [
            link(_anchor(s), s.scene["station"]),
            moment(s.scene["captured_at"]),
            badge(gravest(s.features)),
            *(str(len({row[kind.id_columns[0]] for row in s.of_kind[kind.name]})) for kind in kinds),
            str(sum(len(findings_of(kind, s.of_kind[kind.name])) for kind in KINDS)),
            standings_said(s.standings),
            " · ".join(reason(text) for text in s.scene["warnings"] or ()),
        ]
        for s in record.scenes
    ]
    heads = [_("station"), _("captured"), _("verdict"), *(many(kind) for kind in kinds), _("need attention")]
    return table([*heads, _("findings"), _("warnings")], rows, list(range(3, len(heads))))


def _map(record: PanelRecord) -> str:
    """One map of the panel where all stations share its frame, else none: each station has a frame of its own."""
    placed = [scene for scene in record.scenes if scene.has_common_frame]
    drawing = panel_map({kind.name: [row for scene in placed for row in scene.of_kind[kind.name]] for kind in KINDS})
    return figure(drawing, _("In panel coordinates. {key}.", key=key())) if drawing else ""


def _attention(record: PanelRecord) -> list[Markup]:
    tables = []
    for kind in KINDS:
        rows = [row for scene in record.scenes for row in findings_of(kind, scene.of_kind[kind.name])]
        tables += [features_table(kind, rows, where=True)] if rows else []
    return tables


def _station(scene: SceneRecord) -> dict[str, Any]:
    """What the template says of one station."""
    return {
        "anchor": _anchor(scene),
        "name": scene.scene["station"],
        "verdict": verdict(scene.features),
        "picture": figure(marked_picture(scene.preview, scene.of_kind), _("Left camera.")),
        "overlay": png_figure(scene.overlay_shown, _("overlay"), _("The overlay.")),
        "features": [
            part
            for kind in KINDS
            if (rows := scene.of_kind[kind.name])
            for part in features(kind, rows, scene.limits, charted=False)
        ],
        "decisions": decisions_table(scene),
        "traceability": traceability(scene),
    }


def _specifications(record: PanelRecord) -> list[PanelSpec | None]:
    """The limits that were used, each once."""
    used: list[PanelSpec | None] = []
    for scene in record.scenes:
        if scene.limits not in used:
            used.append(scene.limits)
    return used

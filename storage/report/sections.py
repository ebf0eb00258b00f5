"""Sections that scene and panel reports share: verdicts, tables of features, limits, traceability."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from itertools import groupby
from typing import Any

from metrology.kinds import LIMITS, Cell, Kind, Quantity
from metrology.requirements import downstream_of, limit_of
from metrology.tolerance import RULE, Limit, PanelSpec
from storage.archive.work import OPEN_WORK, said
from storage.report.drawings import course_chart, values_chart
from storage.report.markup import badge, facts, figure, moment, number, table, with_u95
from storage.report.record import SceneRecord
from storage.report.verdicts import counted, gravest, needs_attention
from storage.review import Entry

Row = Mapping[str, Any]


def verdict(features: Sequence[Row]) -> str:
    """The gravest decision, and how often each occurs."""
    return f"<p>{badge(gravest(features), big=True)} &ensp; {' '.join(badge(d, n) for d, n in counted(features))}</p>"


def why(feature: Row) -> str:
    """The reason for anything short of a pass; the decision rule is said once, beside the limits."""
    return escape((feature["reason"] or "").replace(f"; {RULE}", ""))


def features_table(kind: Kind, rows: Sequence[Row], where: bool = False) -> str:
    """Features of one kind; with the station they were seen from where `where`."""
    heads = [kind.subject, *(cell.head for cell in kind.shown), "zone", "verdict", "why"]
    lines = [
        [
            escape(row[kind.id_columns[0]]),
            *(_cell(cell, row) for cell in kind.shown),
            escape(row["zone"] or "–"),
            badge(row["decision"]),
            why(row),
        ]
        for row in rows
    ]
    numeric = [1 + k for k in range(len(kind.shown))]
    if where:
        heads, numeric = ["station", *heads], [k + 1 for k in numeric]
        lines = [[escape(row["station"]), *line] for row, line in zip(rows, lines, strict=True)]
    return table(heads, lines, numeric)


def _cell(cell: Cell, row: Row) -> str:
    first, *more = (row[column] for column in cell.columns)
    if cell.span:
        low, high = (number(value, cell.digits, cell.signed) for value in (first, *more))
        return "–" if first is None else f"{low} … {high}"
    return with_u95(first, more[0], cell.digits, cell.signed) if more else number(first, cell.digits, cell.signed)


def features(kind: Kind, rows: Sequence[Row], limits: PanelSpec | None, charted: bool = True) -> list[str]:
    """Features of one kind with a chart of their first quantity where `charted`; courses each on its own."""
    if kind.is_course:
        return _courses(kind, rows, limits)
    first = kind.quantities[0]
    chart = values_chart(kind, rows, feature_limits(rows, first, limits)) if charted else ""
    said = f"{first.said.capitalize()}s with their U95; dashed: the limits that each was judged by."
    return [*([figure(chart, said)] if chart else []), features_table(kind, rows)]


def _courses(kind: Kind, rows: Sequence[Row], limits: PanelSpec | None) -> list[str]:
    """Each course with its profile, a summary, and the positions that need attention."""
    parts = []
    for name, group in groupby(rows, key=lambda row: row[kind.id_columns[0]]):
        course = list(group)
        parts.append(f"<h3>{kind.subject.capitalize()} {escape(name)}</h3>{verdict(course)}{_summary(kind, course)}")
        for quantity in kind.quantities:
            if chart := course_chart(kind, quantity, course, feature_limits(course, quantity, limits)):
                said = f"{quantity.name} along {kind.subject} {name}; grey: U95; dashed: the limits judged by"
                parts.append(figure(chart, said + (" (zone and wind)" if quantity.into_wind else "")))
        attention = [row for row in course if needs_attention(row)]
        if attention:
            parts.append(f"<details open><summary>{len(attention)} positions need attention</summary>")
            parts.append(f"{features_table(kind, attention)}</details>")
        parts.append('<details class="hide-in-print"><summary>all positions</summary>')
        parts.append(f"{features_table(kind, course)}</details>")
    return parts


def feature_limits(features: Sequence[Row], quantity: Quantity, spec: PanelSpec | None) -> list[Limit | None]:
    """The limit of a quantity that each feature was judged by."""
    if spec is None:
        return [None] * len(features)
    return [limit_of(spec.zone(f["zone"]), quantity, downstream_of(quantity, f)) for f in features]


def _summary(kind: Kind, course: Sequence[Row]) -> str:
    rows = []
    for quantity in kind.quantities:
        values = [row[quantity.column] for row in course if row[quantity.column] is not None]
        if values:
            numbers = (min(values), sum(values) / len(values), max(values))
            said = [number(value, 3, quantity.signed) for value in numbers]
            rows.append([f"{quantity.said} {quantity.unit}", *said, f"{len(values)} of {len(course)}"])
    return table(["", "least", "mean", "most", "measured at"], rows, [1, 2, 3, 4]) if rows else ""


def limits_table(spec: PanelSpec | None) -> str:
    """Every limit with where it comes from."""
    if spec is None:
        return "<p>The limits of this run cannot be read by this version; the bundle's manifest holds them.</p>"
    rows = []
    for name, zone in spec.zones.items():
        for key, limit in zone.items():
            text = ["–" if bound is None else f"{bound:+.3f}" for bound in limit.bounds]
            rows.append([escape(name), LIMITS[key].title, *text, escape(limit.source), escape(limit.revision)])
    heads = ["zone", "quantity", "lower", "upper", "serious below", "serious above", "source", "revision"]
    return f"<p>Decision rule: {RULE}. Specification {escape(spec.panel)}, revision {escape(spec.revision)}.</p>" + (
        table(heads, rows, [2, 3, 4, 5]) if rows else "<p>No limits: nothing was judged.</p>"
    )


def decisions_table(record: SceneRecord) -> str:
    """How the findings stand, and what people decided; "" where there is neither."""
    if not record.decisions and not record.standings:
        return ""
    open_names = [standing.feature.id for standing in record.standings if standing.state == OPEN_WORK]
    work = f" Open work: {', '.join(open_names)}." if open_names else ""
    stand = f"<p>Findings: {escape(said(record.standings))}.{escape(work)}</p>"
    return stand + (entries_table(record.decisions) if record.decisions else "")


def entries_table(entries: Sequence[Entry], where: bool = False) -> str:
    """Entries of the review log; with the scan that they are about where `where`."""
    rows = [
        [
            moment(entry.at),
            escape(entry.who),
            escape(f"{entry.feature_kind or 'scene'} {entry.feature_id or ''} {entry.scene_id if where else ''}"),
            escape(entry.what),
            escape(entry.comment),
        ]
        for entry in entries
    ]
    return table(["when", "who", "what", "decision", "comment"], rows)


def traceability(record: SceneRecord) -> str:
    """What a result rests on: rig, limits, versions, settings, registration."""
    scene, manifest = record.scene, record.manifest
    versions = ", ".join(f"{name} {version}" for name, version in manifest.get("versions", {}).items())
    sigma = scene["sigma_z_median_mm"]
    shown = facts(
        [
            ("scene", f"<code>{escape(scene['scene_id'])}</code>"),
            ("run", f"<code>{escape(scene['run_id'])}</code>, {moment(scene['processed_at'])}"),
            (
                "captured",
                moment(scene["captured_at"]) + (f" by {escape(scene['operator'])}" if scene["operator"] else ""),
            ),
            ("rig", f"{escape(scene['rig_id'])} (content <code>{escape(scene['rig_hash'])}</code>)"),
            ("specification", escape(scene["panel_spec"] or "–")),
            ("settings and specification", f"<code>{escape(scene['config_hash'])}</code>"),
            ("registration", _registration(record)),
            (
                "points",
                f"{scene['n_points']:,} ({scene['valid_fraction']:.1%} of the picture), "
                f"median σ of depth {'–' if sigma is None else f'{1000 * sigma:.1f} µm'}",
            ),
            ("rig fits", escape(scene["rig_verdict"] or "–")),
            ("epipolar distance", _epipolar(scene)),
            ("versions", escape(versions)),
            ("review log ends with", f"<code>{escape(record.review_head)}</code>"),
        ]
    )
    settings = escape(json.dumps(manifest.get("settings", {}), indent=1, ensure_ascii=False))
    return f'{shown}<details class="hide-in-print"><summary>all settings</summary><pre>{settings}</pre></details>'


def _epipolar(scene: Row) -> str:
    rms = scene["epipolar_rms_px"]
    return "–" if rms is None else f"{rms:.3f} px RMS"


def _registration(record: SceneRecord) -> str:
    found = record.manifest.get("registration", {})
    status = found.get("status")
    if status is None:
        return "–"
    parts = [escape(status)]
    if status == "recognised":
        parts.append(f"{len(found['matched'])} rivets matched")
        if found["rms_mm"] is not None:
            parts.append(f"{found['rms_mm']:.3f} mm RMS from their nominal places")
        if found["shift_mm"] is not None:
            parts.append(f"rig {found['shift_mm']:.1f} mm and {found['turn_deg']:.1f}° from the nominal placement")
    for name in ("missing", "unlisted"):
        if found.get(name):
            parts.append(f"{name}: {escape(', '.join(found[name]))}")
    return "; ".join(parts)

"""Sections that scene and panel reports share: verdicts, tables of features, limits, traceability."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from itertools import groupby
from typing import Any

from metrology.kinds import LIMITS, SEAM_STATION, Quantity
from metrology.requirements import downstream_of, limit_of
from metrology.tolerance import RULE, Limit, PanelSpec
from storage.archive.work import OPEN_WORK, said
from storage.report.drawings import seam_chart
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


def rivet_table(rivets: Sequence[Row], where: bool = False) -> str:
    """All rivets; with the station they were seen from where `where`."""
    heads = ["rivet", "diameter mm", "height mm", "min … max mm", "tilt °", "zone", "verdict", "why"]
    rows = [
        [
            escape(r["rivet_id"]),
            number(r["diameter_mm"], 2),
            with_u95(r["height_mean_mm"], r["height_u95_mm"], 4, sign=True),
            "–"
            if r["height_min_mm"] is None
            else f"{number(r['height_min_mm'], 3, True)} … {number(r['height_max_mm'], 3, True)}",
            with_u95(r["tilt_deg"], r["tilt_u95_deg"], 2),
            escape(r["zone"] or "–"),
            badge(r["decision"]),
            why(r),
        ]
        for r in rivets
    ]
    numeric = [1, 2, 3, 4]
    if where:
        heads, numeric = ["station", *heads], [k + 1 for k in numeric]
        rows = [[escape(r["station"]), *row] for r, row in zip(rivets, rows, strict=True)]
    return table(heads, rows, numeric)


def hole_table(holes: Sequence[Row]) -> str:
    """Open holes, missing and temporary fasteners."""
    heads = ["hole", "kind", "diameter mm", "countersink mm", "verdict", "why"]
    rows = [
        [
            escape(h["hole_id"]),
            escape(h["kind"]),
            with_u95(h["diameter_mm"], h["diameter_u95_mm"], 2),
            with_u95(h["countersink_diameter_mm"], h["countersink_diameter_u95_mm"], 2),
            badge(h["decision"]),
            why(h),
        ]
        for h in holes
    ]
    return table(heads, rows, [2, 3])


def station_table(stations: Sequence[Row], where: bool = False) -> str:
    """Positions along seams."""
    heads = ["seam", "at mm", "step mm", "into the wind mm", "gap mm", "zone", "verdict", "why"]
    rows = [
        [
            escape(s["seam_id"]),
            number(s["s_mm"], 0),
            with_u95(s["step_mm"], s["step_u95_mm"], 3, sign=True),
            number(s["step_into_wind_mm"], 3, sign=True),
            with_u95(s["width_mm"], s["width_u95_mm"], 3),
            escape(s["zone"] or "–"),
            badge(s["decision"]),
            why(s),
        ]
        for s in stations
    ]
    numeric = [1, 2, 3, 4]
    if where:
        heads, numeric = ["station", *heads], [k + 1 for k in numeric]
        rows = [[escape(s["station"]), *row] for s, row in zip(stations, rows, strict=True)]
    return table(heads, rows, numeric)


def seams(stations: Sequence[Row], limits: PanelSpec | None) -> list[str]:
    """Each seam with its profile, a summary, and the positions that need attention."""
    parts = []
    for seam_id, group in groupby(stations, key=lambda s: s["seam_id"]):
        course = list(group)
        parts.append(f"<h3>Seam {escape(seam_id)}</h3>{verdict(course)}{_summary(course)}")
        for quantity in SEAM_STATION.quantities:
            if chart := seam_chart(course, quantity.name, feature_limits(course, quantity, limits)):
                said = f"{quantity.name} along seam {seam_id}; grey: U95; dashed: the limits judged by"
                parts.append(figure(chart, said + (" (zone and wind)" if quantity.into_wind else "")))
        attention = [s for s in course if needs_attention(s)]
        if attention:
            parts.append(f"<details open><summary>{len(attention)} positions need attention</summary>")
            parts.append(f"{station_table(attention)}</details>")
        parts.append('<details class="hide-in-print"><summary>all positions</summary>')
        parts.append(f"{station_table(course)}</details>")
    return parts


def feature_limits(features: Sequence[Row], quantity: Quantity, spec: PanelSpec | None) -> list[Limit | None]:
    """The limit of a quantity that each feature was judged by."""
    if spec is None:
        return [None] * len(features)
    return [limit_of(spec.zone(f["zone"]), quantity, downstream_of(quantity, f)) for f in features]


def _summary(stations: Sequence[Row]) -> str:
    rows = []
    for quantity, name in (("step", "step mm"), ("width", "gap mm")):
        values = [s[f"{quantity}_mm"] for s in stations if s[f"{quantity}_mm"] is not None]
        if values:
            sign = quantity == "step"
            numbers = (min(values), sum(values) / len(values), max(values))
            rows.append([name, *(number(value, 3, sign) for value in numbers), f"{len(values)} of {len(stations)}"])
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

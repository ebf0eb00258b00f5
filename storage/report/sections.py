"""Sections that scene and panel reports share: verdicts, tables of features, limits, traceability."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from markupsafe import Markup

from metrology.kinds import LIMITS, SEAM_STATION, Quantity
from metrology.requirements import downstream_of, limit_of
from metrology.tolerance import RULE, Limit, PanelSpec
from storage.archive.work import OPEN_WORK, said
from storage.report.drawings import seam_chart
from storage.report.markup import badge, code, facts, figure, moment, number, section, table, with_u95
from storage.report.record import SceneRecord
from storage.report.verdicts import counted, gravest, needs_attention
from storage.review import Entry

Row = Mapping[str, Any]


def verdict(features: Sequence[Row]) -> Markup:
    """The gravest decision, and how often each occurs."""
    return section("verdict", badge(gravest(features), big=True), [badge(d, n) for d, n in counted(features)])


def why(feature: Row) -> str:
    """The reason for anything short of a pass; the decision rule is said once, beside the limits."""
    return (feature["reason"] or "").replace(f"; {RULE}", "")


def rivet_table(rivets: Sequence[Row], where: bool = False) -> Markup:
    """All rivets; with the station they were seen from where `where`."""
    heads = ["rivet", "diameter mm", "height mm", "min … max mm", "tilt °", "zone", "verdict", "why"]
    rows = [
        [
            r["rivet_id"],
            number(r["diameter_mm"], 2),
            with_u95(r["height_mean_mm"], r["height_u95_mm"], 4, sign=True),
            "–"
            if r["height_min_mm"] is None
            else f"{number(r['height_min_mm'], 3, True)} … {number(r['height_max_mm'], 3, True)}",
            with_u95(r["tilt_deg"], r["tilt_u95_deg"], 2),
            r["zone"] or "–",
            badge(r["decision"]),
            why(r),
        ]
        for r in rivets
    ]
    numeric = [1, 2, 3, 4]
    if where:
        heads, numeric = ["station", *heads], [k + 1 for k in numeric]
        rows = [[r["station"], *row] for r, row in zip(rivets, rows, strict=True)]
    return table(heads, rows, numeric)


def station_table(stations: Sequence[Row], where: bool = False) -> Markup:
    """Positions along seams."""
    heads = ["seam", "at mm", "step mm", "into the wind mm", "gap mm", "zone", "verdict", "why"]
    rows = [
        [
            s["seam_id"],
            number(s["s_mm"], 0),
            with_u95(s["step_mm"], s["step_u95_mm"], 3, sign=True),
            number(s["step_into_wind_mm"], 3, sign=True),
            with_u95(s["width_mm"], s["width_u95_mm"], 3),
            s["zone"] or "–",
            badge(s["decision"]),
            why(s),
        ]
        for s in stations
    ]
    numeric = [1, 2, 3, 4]
    if where:
        heads, numeric = ["station", *heads], [k + 1 for k in numeric]
        rows = [[s["station"], *row] for s, row in zip(stations, rows, strict=True)]
    return table(heads, rows, numeric)


def seams(stations: Sequence[Row], limits: PanelSpec | None) -> list[Markup]:
    """Each seam with its profile, a summary, and the positions that need attention."""
    parts = []
    for seam_id, group in groupby(stations, key=lambda s: s["seam_id"]):
        course = list(group)
        charts = []
        for quantity in SEAM_STATION.quantities:
            if chart := seam_chart(course, quantity.name, feature_limits(course, quantity, limits)):
                said = f"{quantity.name} along seam {seam_id}; grey: U95; dashed: the limits judged by"
                charts.append(figure(chart, said + (" (zone and wind)" if quantity.into_wind else "")))
        attention = [s for s in course if needs_attention(s)]
        tables = station_table(attention), len(attention), station_table(course)
        parts.append(section("seam", seam_id, verdict(course), _summary(course), charts, *tables))
    return parts


def feature_limits(features: Sequence[Row], quantity: Quantity, spec: PanelSpec | None) -> list[Limit | None]:
    """The limit of a quantity that each feature was judged by."""
    if spec is None:
        return [None] * len(features)
    return [limit_of(spec.zone(f["zone"]), quantity, downstream_of(quantity, f)) for f in features]


def _summary(stations: Sequence[Row]) -> Markup:
    rows = []
    for quantity, name in (("step", "step mm"), ("width", "gap mm")):
        values = [s[f"{quantity}_mm"] for s in stations if s[f"{quantity}_mm"] is not None]
        if values:
            sign = quantity == "step"
            numbers = (min(values), sum(values) / len(values), max(values))
            rows.append([name, *(number(value, 3, sign) for value in numbers), f"{len(values)} of {len(stations)}"])
    return table(["", "least", "mean", "most", "measured at"], rows, [1, 2, 3, 4]) if rows else Markup()


def limits_table(spec: PanelSpec | None) -> Markup:
    """Every limit with where it comes from."""
    rows = []
    for name, zone in spec.zones.items() if spec else ():
        for key, limit in zone.items():
            text = [number(bound, 3, sign=True) for bound in limit.bounds]
            rows.append([name, LIMITS[key].title, *text, limit.source, limit.revision])
    heads = ["zone", "quantity", "lower", "upper", "serious below", "serious above", "source", "revision"]
    return section("limits", RULE, spec, table(heads, rows, [2, 3, 4, 5]) if rows else "")


def decisions_table(record: SceneRecord) -> Markup:
    """How the findings stand, and what people decided; "" where there is neither."""
    if not record.decisions and not record.standings:
        return Markup()
    open_names = [standing.feature.id for standing in record.standings if standing.state == OPEN_WORK]
    entries = entries_table(record.decisions) if record.decisions else ""
    return section("decisions", said(record.standings), open_names, entries)


def entries_table(entries: Sequence[Entry], where: bool = False) -> Markup:
    """Entries of the review log; with the scan that they are about where `where`."""
    rows = [
        [
            moment(entry.at),
            entry.who,
            f"{entry.feature_kind or 'scene'} {entry.feature_id or ''} {entry.scene_id if where else ''}",
            entry.what,
            entry.comment,
        ]
        for entry in entries
    ]
    return table(["when", "who", "what", "decision", "comment"], rows)


def traceability(record: SceneRecord) -> Markup:
    """What a result rests on: rig, limits, versions, settings, registration."""
    scene, manifest = record.scene, record.manifest
    versions = ", ".join(f"{name} {version}" for name, version in manifest.get("versions", {}).items())
    shown = facts(
        [
            ("scene", code(scene["scene_id"])),
            ("run", code(scene["run_id"]) + f", {moment(scene['processed_at'])}"),
            ("captured", moment(scene["captured_at"]) + (f" by {scene['operator']}" if scene["operator"] else "")),
            ("rig", Markup("{} (content {})").format(scene["rig_id"], code(scene["rig_hash"]))),
            ("specification", scene["panel_spec"] or "–"),
            ("settings and specification", code(scene["config_hash"])),
            ("registration", _registration(record)),
            ("points", _points(scene)),
            ("rig fits", scene["rig_verdict"] or "–"),
            ("epipolar distance", _epipolar(scene)),
            ("versions", versions),
            ("review log ends with", code(record.review_head)),
        ]
    )
    return section("traceability", shown, json.dumps(manifest.get("settings", {}), indent=1, ensure_ascii=False))


def _points(scene: Row) -> str:
    sigma = scene["sigma_z_median_mm"]
    depth = "–" if sigma is None else f"{1000 * sigma:.1f} µm"
    return f"{scene['n_points']:,} ({scene['valid_fraction']:.1%} of the picture), median σ of depth {depth}"


def _epipolar(scene: Row) -> str:
    rms = scene["epipolar_rms_px"]
    return "–" if rms is None else f"{rms:.3f} px RMS"


def _registration(record: SceneRecord) -> str:
    found = record.manifest.get("registration", {})
    status = found.get("status")
    if status is None:
        return "–"
    parts = [status]
    if status == "recognised":
        parts.append(f"{len(found['matched'])} rivets matched")
        if found["rms_mm"] is not None:
            parts.append(f"{found['rms_mm']:.3f} mm RMS from their nominal places")
        if found["shift_mm"] is not None:
            parts.append(f"rig {found['shift_mm']:.1f} mm and {found['turn_deg']:.1f}° from the nominal placement")
    for name in ("missing", "unlisted"):
        if found.get(name):
            parts.append(f"{name}: {', '.join(found[name])}")
    return "; ".join(parts)

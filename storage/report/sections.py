"""Sections that scene and panel reports share: verdicts, tables of features, limits, traceability."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import Any

from markupsafe import Markup

from metrology.kinds import LIMITS, Cell, Kind, Quantity
from metrology.limits import GradedLimit
from metrology.requirements import downstream_of, limit_of
from metrology.tolerance import RULE, Limit, PanelSpec
from storage.archive.work import DECIDED, OPEN_WORK, UNRESOLVED, Standing
from storage.report.drawings import course_chart, values_chart
from storage.report.markup import badge, code, facts, figure, missing, moment, number, section, table, with_u95
from storage.report.record import SceneRecord
from storage.report.verdicts import counted, gravest, needs_attention
from storage.review import Entry
from storage.review_details import remarks
from storage.wording import _, capital, named, reason

Row = Mapping[str, Any]


def verdict(features: Sequence[Row]) -> Markup:
    """The gravest decision, and how often each occurs."""
    return section("verdict", badge(gravest(features), big=True), [badge(d, n) for d, n in counted(features)])


def why(feature: Row) -> str:
    """The reason for anything short of a pass; the decision rule is said once, beside the limits."""
    return reason((feature["reason"] or "").replace(f"; {RULE}", ""))


def features_table(kind: Kind, rows: Sequence[Row], where: bool = False) -> Markup:
    """Features of one kind; with the station they were seen from where `where`."""
    heads = [_(kind.subject), *(_(cell.head) for cell in kind.shown), _("zone"), _("verdict"), _("why")]
    lines = [
        [
            row[kind.id_columns[0]],
            *(_cell(cell, row) for cell in kind.shown),
            row["zone"] or "–",
            badge(row["decision"]),
            why(row),
        ]
        for row in rows
    ]
    numeric = [
        1 + k for k, cell in enumerate(kind.shown) if not any(isinstance(row[cell.columns[0]], str) for row in rows)
    ]
    if where:
        heads, numeric = [_("station"), *heads], [k + 1 for k in numeric]
        lines = [[row["station"], *line] for row, line in zip(rows, lines, strict=True)]
    return table(heads, lines, numeric)


def findings_of(kind: Kind, rows: Sequence[Row]) -> list[Row]:
    """Rows that need attention; the positions of each stretch of a course as one, with the values of the worst."""
    found: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if needs_attention(row):
            name = (row.get("stretch") if kind.is_course else None) or kind.id_of(row)
            found.setdefault((row["scene_id"], name), []).append(row)
    return [_as_one(kind, members) if len(members) > 1 else members[0] for members in found.values()]


def _as_one(kind: Kind, members: Sequence[Row]) -> Row:
    at = kind.id_columns[1]
    worst = max(members, key=lambda row: row["beyond_mm"] if row["beyond_mm"] is not None else float("-inf"))
    length = (members[-1][at] - members[0][at]) * len(members) / (len(members) - 1)
    where = f"from {members[0][at]:.0f} to {members[-1][at]:.0f} mm ({length:.0f} mm), worst at {worst[at]:.0f} mm"
    reason = ": ".join(part for part in (where, worst["reason"]) if part)
    return {**worst, "decision": gravest(members), "reason": reason}


def _cell(cell: Cell, row: Row) -> str:
    first, *more = (row[column] for column in cell.columns)
    if isinstance(first, str):
        return _(first)
    if cell.span:
        low, high = (number(value, cell.digits, cell.signed) for value in (first, *more))
        return "–" if first is None else f"{low} … {high}"
    return with_u95(first, more[0], cell.digits, cell.signed) if more else number(first, cell.digits, cell.signed)


def features(kind: Kind, rows: Sequence[Row], limits: PanelSpec | None, charted: bool = True) -> list[Markup]:
    """Features of one kind with a chart of their first quantity where `charted`; courses each on its own."""
    if kind.is_course:
        return _courses(kind, rows, limits)
    first = kind.quantities[0]
    chart = values_chart(kind, rows, feature_limits(rows, first, limits)) if charted else ""
    said = _("{quantity} with U95; dashed: the limits that each was judged by.", quantity=capital(_(first.said)))
    return [*([figure(chart, said)] if chart else []), features_table(kind, rows)]


def _courses(kind: Kind, rows: Sequence[Row], limits: PanelSpec | None) -> list[Markup]:
    """Each course with its profile, a summary, and the stretches that need attention."""
    parts = []
    for name, group in groupby(rows, key=lambda row: row[kind.id_columns[0]]):
        course = list(group)
        charts = []
        for quantity in kind.quantities:
            if chart := course_chart(kind, quantity, course, feature_limits(course, quantity, limits)):
                said = _(
                    "{quantity} along {subject} {name}; grey: U95; dashed: the limits judged by",
                    quantity=capital(_(quantity.said)), subject=_(kind.subject), name=name,
                )  # fmt: skip
                charts.append(figure(chart, said + (_(" (zone and wind)") if quantity.into_wind else "")))
        attention = findings_of(kind, course)
        tables = features_table(kind, attention), len(attention), features_table(kind, course)
        title = f"{capital(_(kind.subject))} {name}"
        parts.append(section("course", title, verdict(course), _summary(kind, course), charts, *tables))
    return parts


def feature_limits(features: Sequence[Row], quantity: Quantity, spec: PanelSpec | None) -> list[Limit | None]:
    """The limit of a quantity that each feature was judged by."""
    if spec is None:
        return [None] * len(features)
    return [limit_of(spec.zone(f["zone"]), quantity, downstream_of(quantity, f)) for f in features]


def _summary(kind: Kind, course: Sequence[Row]) -> Markup:
    rows = []
    for quantity in kind.quantities:
        values = [row[quantity.column] for row in course if row[quantity.column] is not None]
        if values:
            numbers = (min(values), sum(values) / len(values), max(values))
            said = [number(value, 3, quantity.signed) for value in numbers]
            rows.append([f"{_(quantity.said)} {quantity.unit}", *said, f"{len(values)} / {len(course)}"])
    return table(["", _("least"), _("mean"), _("most"), _("measured at")], rows, [1, 2, 3, 4]) if rows else Markup()


def limits_table(spec: PanelSpec | None) -> Markup:
    """Every limit with where it comes from."""
    rows = [
        [
            name,
            _(LIMITS[key].title),
            *_bounds(limit),
            limit.source,
            limit.revision,
        ]
        for name, zone in (spec.zones.items() if spec else ())
        for key, limit in zone.items()
    ]
    heads = [
        _("zone"), _("quantity"), _("lower"), _("upper"), _("serious below"), _("serious above"), _("source"),
        _("revision"),
    ]  # fmt: skip
    return section("limits", _(RULE), spec, table(heads, rows, [2, 3, 4, 5]) if rows else "")


def _bounds(limit: Limit) -> list[str]:
    """Lower, upper, serious lower, serious upper; of one that goes with an extent every step."""
    said = [number(bound, 3, sign=True) for bound in limit.bounds]
    if isinstance(limit, GradedLimit):
        said[1] = limit.said
    return said


def many(kind: Kind) -> str:
    """What several of a kind are called."""
    name = f"{kind.subject}s"
    return _(name)


def standings_said(standings: Iterable[Standing]) -> str:
    """How many findings stand how, in words."""
    counts = Counter(standing.state for standing in standings)
    return ", ".join(f"{counts[s]} {_(s)}" for s in (*UNRESOLVED, DECIDED) if counts[s]) or _("no findings")


def decisions_table(record: SceneRecord) -> Markup:
    """How the findings stand, and what people decided; "" where there is neither."""
    if not record.decisions and not record.standings:
        return Markup()
    open_names = [named(standing.feature.id) for standing in record.standings if standing.state == OPEN_WORK]
    entries = entries_table(record.decisions) if record.decisions else ""
    return section("decisions", standings_said(record.standings), open_names, entries)


def entries_table(entries: Sequence[Entry], where: bool = False) -> Markup:
    """Entries of the review log; with the scan that they are about where `where`."""
    rows = [
        [
            moment(entry.at),
            entry.who,
            f"{_(entry.feature_kind or 'scan')} {named(entry.feature_id or '')} {entry.scene_id if where else ''}",
            _(entry.what),
            remarks(entry, _, reason),
        ]
        for entry in entries
    ]
    return table([_("when"), _("who"), _("what"), _("decision"), _("comment")], rows)


def traceability(record: SceneRecord) -> Markup:
    """What a result rests on, link by link; a missing one is marked."""
    scene, manifest = record.scene, record.manifest
    shown = facts(
        [
            *((_(link.name), missing(link.said) if link.missing else link.said) for link in record.chain),
            (_("registration"), _registration(record)),
            (_("points"), _points(scene)),
            (_("review log ends with"), code(record.review_head)),
        ]
    )  # fmt: skip
    return section("traceability", shown, json.dumps(manifest.get("settings", {}), indent=1, ensure_ascii=False))


def _points(scene: Row) -> str:
    sigma = scene["sigma_z_median_mm"]
    depth = "–" if sigma is None else f"{number(1000 * sigma, 1)} µm"
    share = f"{number(100 * scene['valid_fraction'], 1)} %"
    count = f"{scene['n_points']:,}".replace(",", "\u202f")
    return _("{n} ({share} of the picture), median σ of depth {depth}", n=count, share=share, depth=depth)


def _registration(record: SceneRecord) -> str:
    found = record.manifest.get("registration", {})
    status = found.get("status")
    if status is None:
        return "–"
    parts = [_(status)]
    if status == "recognised":
        parts.append(_("{n} rivets matched", n=len(found["matched"])))
        if found["rms_mm"] is not None:
            parts.append(_("{rms} mm RMS from their nominal places", rms=number(found["rms_mm"], 3)))
        if found["shift_mm"] is not None:
            shift, turn = number(found["shift_mm"], 1), number(found["turn_deg"], 1)
            parts.append(_("rig {shift} mm and {turn}° from the nominal placement", shift=shift, turn=turn))
    for name in ("missing", "unlisted"):
        if found.get(name):
            parts.append(f"{_(name)}: {', '.join(found[name])}")
    return "; ".join(parts)

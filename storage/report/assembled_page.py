"""The report of an assembled panel: on its first page the verdict, what decided, coverage, map and signatures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from markupsafe import Markup

from metrology.assembly.rows import CHANGES
from metrology.kinds import BY_NAME, KINDS
from metrology.verdicts import gravity
from storage.report.assembled import AssembledRecord, Row
from storage.report.drawings import panel_map
from storage.report.letterhead import Letterhead
from storage.report.markup import badge, code, facts, figure, moment, number, page, section, table, with_u95
from storage.report.sections import entries_table, limits_table, many, standings_said, why
from storage.report.verdicts import CLASSES, SIGNS, counted, key
from storage.review import Entry
from storage.review_details import remarks
from storage.wording import _, named, reason

_PRINTED_CHANGES = 30
_PRINTED = 60  # findings on paper, the gravest; the page on the screen has all
_LIKE = {
    "accepted": "pass",
    "accepted with conditions": "conditional pass",
    "rejected": "fail",
    "incomplete": "not measured",
    "met": "pass",
    "met with conditions": "conditional pass",
    "not met": "fail",
    "not decided": "not measured",
}
"""Verdicts of panels and rules look like these decisions about features."""


def assembled_page(record: AssembledRecord, letterhead: Letterhead | None = None) -> str:
    """One HTML page; it needs nothing else. Twelve stations print on six pages at most."""
    panel = record.panel
    name = f"{panel['aircraft_serial']} {panel['panel']}"
    return page(
        "assembled.html",
        _("Panel {name}", name=name),
        letterhead=letterhead,
        name=name,
        panel=panel,
        verdict_reason=reason(panel["verdict_reason"]),
        captured=moment(panel["captured_at"]),
        verdict=_badge(panel["verdict"]),
        warnings=_warnings(record),
        features=_features(record),
        coverage=_coverage(record),
        maps=_maps(record),
        rules=_rules(record.rules),
        findings=_findings(sorted(record.findings, key=_gravest_first), record.locations),
        changes=_changes(record.changes),
        changes_since=moment(record.changes[0]["before_captured_at"]) if record.changes else "",
        n_findings=len(record.findings),
        printed=_PRINTED,
        stations=_stations(record),
        work=entries_table(record.work, where=True) if record.work else "",
        earlier=_verdicts(record.verdicts),
        limits=limits_table(record.limits),
        traceability=_traceability(record),
    )


def _badge(verdict: str) -> Markup:
    like = _LIKE.get(verdict, "no limit")
    return section("panel_verdict", _(verdict), SIGNS[like], CLASSES[like])


def _warnings(record: AssembledRecord) -> list[str]:
    newer = (
        [_("not in it: a newer scan of {stations}; assemble the panel again", stations=", ".join(record.newer))]
        if record.newer
        else []
    )
    return [*newer, *(reason(text) for text in record.panel["warnings"] or ())]


def _features(record: AssembledRecord) -> Markup:
    """How many there are of every kind, by verdict."""
    lines = [
        [
            many(kind),
            str(len({row[kind.id_columns[0]] for row in rows})),
            section("badges", [badge(decision, count) for decision, count in counted(rows)]),
        ]
        for kind in KINDS
        if (rows := record.of_kind[kind.name])
    ]
    return table(["", _("number"), _("by verdict")], lines, [1])


def _coverage(record: AssembledRecord) -> Markup:
    panel = record.panel
    states = Counter(row["state"] for row in record.coverage)
    missing = [named(row["feature_id"]) for row in record.coverage if row["state"] != "measured"]
    shown = _first(missing, 12)
    pattern = [
        (_("expected by the pattern"),
         _("{n}: {measured} measured, {unmeasured} seen but not measured, {unseen} not seen", n=panel["n_expected"],
           measured=states["measured"], unmeasured=states["not measured"], unseen=states["not seen"])),
        (_("not measured or not seen"), shown or _("none")),
        (_("scan next"), panel["next_station"] or _("nothing: all was seen")),
    ] if panel["n_expected"] else [(_("pattern"), _("none: nothing says what else there should be"))]  # fmt: skip
    frame = _("{n} scans, parts with a frame of their own: {parts}", n=panel["n_scenes"], parts=panel["n_parts"])
    u95 = number(panel["place_u95_mm"], 3)
    places = ", " + _("places within {u95} mm (U95)", u95=u95) if panel["place_u95_mm"] else ""
    out = ", " + _("{n} left out", n=panel["n_left_out"]) if panel["n_left_out"] else ""
    twice = _("{n} values, {apart} apart by more than U95", n=panel["n_repeated"], apart=panel["n_beyond"])
    return facts(
        [
            (_("scans"), frame + places + out),
            (_("skin measured"), f"{number(panel['area_cm2'], 0)} cm²"),
            (_("measured by several scans"), twice),
            *pattern,
        ]
    )


def _maps(record: AssembledRecord) -> list[Markup]:
    """Each part of the panel, which has a frame of its own."""
    maps = []
    for part in range(1, record.panel["n_parts"] + 1):
        of_part = {name: [row for row in rows if row["part"] == part] for name, rows in record.of_kind.items()}
        gaps = [row for row in record.coverage if row["state"] == "not seen"] if part == 1 else []
        if drawing := panel_map(of_part, gaps, record.pictures.get(part)):
            which = _("Part {part}", part=part) + ". " if record.panel["n_parts"] > 1 else ""
            maps.append(
                figure(drawing, which + _("The panel from outside, in its own frame. {key}; ? not seen.", key=key()))
            )
    return maps


def _rules(rules: Sequence[Row]) -> Markup:
    rows = [
        [
            row["rule_id"],
            reason(row["rule"]),
            row["applies_to"],
            _badge(row["verdict"]),
            reason(row["reason"]),
            _first([named(name) for name in row["features"]], 10),
        ]
        for row in rules
    ]
    return (
        table([_("rule"), _("what it asks"), _("of"), _("verdict"), _("found"), _("behind it")], rows)
        if rows
        else Markup()
    )


def _first(names: Sequence[str], most: int) -> str:
    more = " " + _("and {n} more", n=len(names) - most) if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _gravest_first(finding: Row) -> tuple[int, bool, str, float]:
    return gravity(finding["decision"]), finding["severity"] != "red", finding["feature_id"], finding["from_mm"] or 0.0


def _findings(findings: Sequence[Row], locations: Mapping[str, str]) -> Markup:
    rows = []
    for row in findings:
        quantity = next(q for q in BY_NAME[row["feature_kind"]].quantities if q.name == row["quantity"])
        value = with_u95(row["value"], row["value_u95"], 3, quantity.signed)
        location = locations.get(row["feature_id"].split("@")[0])
        name = named(row["feature_id"]) + (f", {location}" if location else "")
        rows.append([name, _(quantity.said), value, quantity.unit, number(row["length_mm"], 0),
                     badge(row["decision"]), why(row)])  # fmt: skip
    heads = [_("feature"), _("quantity"), _("value"), _("unit"), _("length mm"), _("verdict"), _("why")]
    return section("long_table", table(heads, rows[:_PRINTED], [2, 4]),
                   table(heads, rows[_PRINTED:], [2, 4]) if rows[_PRINTED:] else "")  # fmt: skip


def _changes(changes: Sequence[Row]) -> Markup:
    """What became of each finding since the assembly before, what is new first."""
    if not changes:
        return Markup()
    rows = []
    for row in sorted(changes, key=lambda row: CHANGES.index(row["change"])):
        quantity = next(q for q in BY_NAME[row["feature_kind"]].quantities if q.name == row["quantity"])
        values = [
            with_u95(row[value], row[u95], 3, quantity.signed)
            for value, u95 in (("value", "value_u95"), ("before_value", "before_u95"), ("difference", "difference_u95"))
        ]
        change = "cured" if row["change"] == "gone" else row["change"]  # as the pages say it
        rows.append(
            [_(change), named(row["feature_id"]), _(quantity.said), *values, quantity.unit, reason(row["reason"])]
        )
    heads = [
        _("change"), _("feature"), _("quantity"), _("now"), _("then"), _("difference"), _("unit"), _("why"),
    ]  # fmt: skip
    return section("long_table", table(heads, rows[:_PRINTED_CHANGES], [3, 4, 5]),
                   table(heads, rows[_PRINTED_CHANGES:], [3, 4, 5]) if rows[_PRINTED_CHANGES:] else "")  # fmt: skip


def _stations(record: AssembledRecord) -> Markup:
    rows = []
    for row in record.stations:
        scene = record.scenes.get(row["station_scene_id"])
        signed = record.sign_offs.get(row["station_scene_id"])
        rows.append(
            [
                row["station"],
                moment(scene["captured_at"]) if scene else "–",
                scene["rig_id"] if scene else "–",
                _("left out") if row["part"] is None else str(row["part"]),
                number(row["place_u95_mm"], 3),
                standings_said(record.standings.get(row["station_scene_id"], ())),
                _signature(signed) if signed else "–",
                reason(row["reason"])
                or " · ".join(reason(text) for text in ((scene["warnings"] or ()) if scene else ())),
            ]
        )
    heads = [
        _("station"), _("scanned"), _("rig"), _("part"), _("place U95 mm"), _("findings"), _("signed off"), _("why"),
    ]  # fmt: skip
    return table(heads, rows, [4])


def _signature(signed: Entry) -> str:
    """Who signed, when, in which role, and what the signature says."""
    meaning = remarks(signed, _, reason)
    return f"{signed.who}, {moment(signed.at)}" + (f", {meaning}" if meaning else "")


def _verdicts(verdicts: Sequence[Row]) -> Markup:
    rows = [
        [moment(row["judged_at"]), row["panel_spec"], _badge(row["verdict"]), reason(row["reason"])] for row in verdicts
    ]
    return table([_("judged"), _("by"), _("verdict"), _("why")], rows) if len(rows) > 1 else Markup()


def _traceability(record: AssembledRecord) -> Markup:
    panel = record.panel
    runs = ", ".join(f"{row['station']}: {row['station_run_id']}" for row in record.stations)
    return facts(
        [
            (_("run of the assembly"), code(panel["run_id"])),
            (_("put together"), moment(panel["processed_at"])),
            (_("software"), f"Flushline {panel['software_version']}"),
            (_("specification"), panel["panel_spec"]),
            (_("runs of the scans"), code(runs)),
            (_("review log ends with"), code(record.review_head)),
        ]
    )

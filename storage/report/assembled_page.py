"""The report of an assembled panel: on its first page the verdict, what decided, coverage, map and signatures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from markupsafe import Markup

from metrology.assembly.rows import CHANGES
from metrology.kinds import BY_NAME, KINDS
from metrology.verdicts import gravity
from storage.archive.work import said
from storage.report.assembled import AssembledRecord, Row
from storage.report.drawings import panel_map
from storage.report.letterhead import Letterhead
from storage.report.markup import badge, code, facts, figure, moment, number, page, section, table, with_u95
from storage.report.sections import entries_table, limits_table, why
from storage.report.verdicts import CLASSES, KEY, SIGNS, counted

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
        f"Panel {name}",
        letterhead=letterhead,
        name=name,
        panel=panel,
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
    return section("panel_verdict", verdict, SIGNS[like], CLASSES[like])


def _warnings(record: AssembledRecord) -> list[str]:
    newer = [f"not in it: a newer scan of {', '.join(record.newer)}; assemble the panel again"] if record.newer else []
    return [*newer, *(record.panel["warnings"] or ())]


def _features(record: AssembledRecord) -> Markup:
    """How many there are of every kind, by verdict."""
    lines = [
        [
            f"{kind.subject}s",
            str(len({row[kind.id_columns[0]] for row in rows})),
            section("badges", [badge(decision, count) for decision, count in counted(rows)]),
        ]
        for kind in KINDS
        if (rows := record.of_kind[kind.name])
    ]
    return table(["", "number", "by verdict"], lines, [1])


def _coverage(record: AssembledRecord) -> Markup:
    panel = record.panel
    states = Counter(row["state"] for row in record.coverage)
    missing = [row["feature_id"] for row in record.coverage if row["state"] != "measured"]
    shown = ", ".join(missing[:12]) + (f" and {len(missing) - 12} more" if len(missing) > 12 else "")
    pattern = [
        ("expected by the pattern", f"{panel['n_expected']}: {states['measured']} measured, "
         f"{states['not measured']} seen but not measured, {states['not seen']} not seen"),
        ("not measured or not seen", shown or "none"),
        ("scan next", panel["next_station"] or "nothing: all was seen"),
    ] if panel["n_expected"] else [("pattern", "none: nothing says what else there should be")]  # fmt: skip
    frame = f"{panel['n_scenes']} scans in {panel['n_parts']} part{'' if panel['n_parts'] == 1 else 's'}"
    places = f", places within {number(panel['place_u95_mm'], 3)} mm (U95)" if panel["place_u95_mm"] else ""
    twice = f"{panel['n_repeated']} values, {panel['n_beyond']} apart by more than U95"
    return facts(
        [
            ("scans", frame + places + (f", {panel['n_left_out']} left out" if panel["n_left_out"] else "")),
            ("skin measured", f"{number(panel['area_cm2'], 0)} cm²"),
            ("measured by several scans", twice),
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
            frame = f"part {part}, " if record.panel["n_parts"] > 1 else ""
            maps.append(figure(drawing, f"The panel from outside, {frame}in its own frame. {KEY}; ? not seen."))
    return maps


def _rules(rules: Sequence[Row]) -> Markup:
    rows = [
        [row["rule_id"], row["rule"], row["applies_to"], _badge(row["verdict"]), row["reason"], _named(row["features"])]
        for row in rules
    ]
    return table(["rule", "what it asks", "of", "verdict", "found", "behind it"], rows) if rows else Markup()


def _named(features: Sequence[str]) -> str:
    return ", ".join(features[:10]) + (f" and {len(features) - 10} more" if len(features) > 10 else "")


def _gravest_first(finding: Row) -> tuple[int, bool, str, float]:
    return gravity(finding["decision"]), finding["severity"] != "red", finding["feature_id"], finding["from_mm"] or 0.0


def _findings(findings: Sequence[Row], locations: Mapping[str, str]) -> Markup:
    rows = []
    for row in findings:
        quantity = next(q for q in BY_NAME[row["feature_kind"]].quantities if q.name == row["quantity"])
        value = with_u95(row["value"], row["value_u95"], 3, quantity.signed)
        location = locations.get(row["feature_id"].split("@")[0])
        name = row["feature_id"] + (f", {location}" if location else "")
        rows.append([name, quantity.said, value, quantity.unit, number(row["length_mm"], 0),
                     badge(row["decision"]), why(row)])  # fmt: skip
    heads = ["feature", "quantity", "value", "unit", "length mm", "verdict", "why"]
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
        rows.append([change, row["feature_id"], quantity.said, *values, quantity.unit, row["reason"] or ""])
    heads = ["change", "feature", "quantity", "now", "then", "difference", "unit", "why"]
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
                "left out" if row["part"] is None else str(row["part"]),
                number(row["place_u95_mm"], 3),
                said(record.standings.get(row["station_scene_id"], ())),
                f"{signed.who}, {moment(signed.at)}" if signed else "–",
                row["reason"] or "; ".join((scene["warnings"] or ()) if scene else ()),
            ]
        )
    heads = ["station", "scanned", "rig", "part", "place U95 mm", "findings", "signed off", "why"]
    return table(heads, rows, [4])


def _verdicts(verdicts: Sequence[Row]) -> Markup:
    rows = [[moment(row["judged_at"]), row["panel_spec"], _badge(row["verdict"]), row["reason"]] for row in verdicts]
    return table(["judged", "by", "verdict", "why"], rows) if len(rows) > 1 else Markup()


def _traceability(record: AssembledRecord) -> Markup:
    panel = record.panel
    runs = ", ".join(f"{row['station']}: {row['station_run_id']}" for row in record.stations)
    return facts(
        [
            ("run of the assembly", code(panel["run_id"])),
            ("put together", moment(panel["processed_at"])),
            ("software", f"Flushline {panel['software_version']}"),
            ("specification", panel["panel_spec"]),
            ("runs of the scans", code(runs)),
            ("review log ends with", code(record.review_head)),
        ]
    )

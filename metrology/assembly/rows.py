"""Rows of an assembled panel's own tables; their fields say what the columns mean."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Literal

State = Literal["measured", "not measured", "not seen"]
Change = Literal["new", "worse", "better", "unchanged", "gone", "not seen"]
CHANGES: tuple[Change, ...] = ("new", "worse", "better", "gone", "unchanged", "not seen")


@dataclass(frozen=True)
class StationRow:
    """One row of `panel_stations`."""

    station: Annotated[str, "placement of the rig in front of the panel"]
    station_scene_id: Annotated[str, "the scan of that station that is in the panel"]
    station_run_id: Annotated[str, "the run of that scan"]
    part: Annotated[
        int | None, "part of the panel, from 1: places of different parts have no common frame; NULL: left out"
    ]
    frame: Annotated[str | None, "specification, where the part lies in its frame, or own"] = None
    rotation: Annotated[tuple[float, ...] | None, "R of x_panel = R x_rig + t, row by row"] = None
    x_mm: Annotated[float | None, "the left camera's centre in the panel's frame, mm"] = None
    y_mm: Annotated[float | None, "the left camera's centre in the panel's frame, mm"] = None
    z_mm: Annotated[float | None, "the left camera's centre in the panel's frame, mm"] = None
    place_u95_mm: Annotated[
        float | None, "expanded uncertainty (95 %) of the placement at its field's worst place, mm"
    ] = None
    reason: Annotated[str | None, "why the scan was left out"] = None
    frame_id: Annotated[
        str | None, "names the part's frame: places and names of assemblies with the same one are the same"
    ] = None


@dataclass(frozen=True)
class DifferenceRow:
    """One row of `panel_differences`: what two scans of a panel say of one quantity of one feature."""

    feature_kind: Annotated[str, "kind of the feature"]
    feature_id: Annotated[str, "its name in the panel's tables"]
    quantity: Annotated[str, "what was measured twice"]
    unit: Annotated[str, "of the values"]
    first_scene_id: Annotated[str, "the scan with the smaller uncertainty"]
    second_scene_id: Annotated[str, "the other scan"]
    first_value: Annotated[float, "value of the first scan"]
    second_value: Annotated[float, "value of the second scan"]
    difference: Annotated[float, "second minus first"]
    difference_u95: Annotated[float, "expanded uncertainty (95 %) of the difference"]
    beyond: Annotated[bool, "whether the scans differ by more than that"]


@dataclass(frozen=True)
class CoverageRow:
    """One row of `panel_coverage`: a nominal fastener, or a stretch of a nominal seam."""

    feature_kind: Annotated[str, "rivet or seam station"]
    feature_id: Annotated[str, "name in the pattern; of a stretch: SEAM@FROM-TO"]
    x_mm: Annotated[float, "nominal place, or the stretch's middle, in the panel's frame, mm"]
    y_mm: Annotated[float, "the same, mm"]
    z_mm: Annotated[float, "the same, mm"]
    from_mm: Annotated[float | None, "where the stretch begins along the seam, mm"] = None
    to_mm: Annotated[float | None, "where it ends, mm"] = None
    state: Annotated[State, "measured, not measured (seen, without a value), not seen (in no scan's field)"] = (
        "not seen"
    )
    reason: Annotated[str | None, "why it was not measured"] = None


@dataclass(frozen=True)
class RuleRow:
    """One row of `panel_rules`: what became of an acceptance rule in a group of features."""

    rule_id: Annotated[str, "name of the rule in the specification"]
    rule: Annotated[str, "the rule in words, with source and revision"]
    applies_to: Annotated[str, "panel, or the zone, row or course"]
    verdict: Annotated[str, "met, met with conditions (within the guard band), not met, not decided"]
    found: Annotated[float | None, "share, number or length beyond; the worst mean"]
    doubtful: Annotated[float | None, "the same with what lies within the guard band and what was not measured"]
    features: Annotated[tuple[str, ...], "features behind it"]
    reason: Annotated[str, "what was found"]


@dataclass(frozen=True)
class FindingRow:
    """One row of `panel_findings`: a feature, or a stretch of a course, that does not simply pass."""

    feature_kind: Annotated[str, "kind of the feature"]
    feature_id: Annotated[str, "its name; of a stretch: COURSE@FROM-TO"]
    quantity: Annotated[str, "what the decision is about; the first of its kind where no limit decided"]
    value: Annotated[float | None, "of the feature, or the worst of the stretch"]
    value_u95: Annotated[float | None, "expanded uncertainty (95 %) of value"]
    from_mm: Annotated[float | None, "where the stretch begins along the course, mm"]
    to_mm: Annotated[float | None, "where it ends, mm"]
    length_mm: Annotated[float | None, "length of the stretch, mm"]
    x_panel_mm: Annotated[float | None, "place, or the worst place, in the panel's frame, mm"]
    y_panel_mm: Annotated[float | None, "the same, mm"]
    z_panel_mm: Annotated[float | None, "the same, mm"]
    severity: Annotated[str | None, "green, blue or red, as in the tables of features"]
    decision: Annotated[str, "the gravest decision"]
    reason: Annotated[str | None, "what was found, and the limit"]


@dataclass(frozen=True)
class ChangeRow:
    """One row of `panel_changes`: a finding of an assembly or of the one with other scans before it."""

    feature_kind: Annotated[str, "kind of the feature"]
    feature_id: Annotated[str, "its name; of a stretch: COURSE@FROM-TO"]
    change: Annotated[
        Change,
        "new (in order or not seen before), worse or better (by more than the difference's U95), unchanged, gone, "
        "not seen (a finding before, and nothing says what it is now)",
    ]
    quantity: Annotated[str, "what is compared"]
    value: Annotated[float | None, "of the feature, or the worst of the stretch; of what is gone the value now"]
    value_u95: Annotated[float | None, "expanded uncertainty (95 %) of value"]
    before_value: Annotated[float | None, "the same in the assembly before"]
    before_u95: Annotated[float | None, "expanded uncertainty (95 %) of before_value"]
    difference: Annotated[float | None, "value minus before_value"]
    difference_u95: Annotated[float | None, "expanded uncertainty (95 %) of the difference"]
    from_mm: Annotated[float | None, "where the stretch begins along the course, mm"]
    to_mm: Annotated[float | None, "where it ends, mm"]
    x_panel_mm: Annotated[float | None, "place, or the worst place, in the panel's frame, mm"]
    y_panel_mm: Annotated[float | None, "the same, mm"]
    z_panel_mm: Annotated[float | None, "the same, mm"]
    decision: Annotated[str | None, "the gravest decision now"]
    before_decision: Annotated[str | None, "the gravest decision before, by the limits of now"]
    reason: Annotated[str | None, "why it cannot be compared"]
    before_run_id: Annotated[str, "the run of the assembly before"] = ""
    before_captured_at: Annotated[datetime | None, "when the newest scan in it was taken (UTC)"] = None


@dataclass(frozen=True)
class VerdictRow:
    """One row of `panel_verdicts`: a judgement of the panel; earlier ones stay."""

    judged_at: Annotated[datetime, "when it was judged (UTC)"]
    panel_spec: Annotated[str, "panel and revision of the specification"]
    verdict: Annotated[str, "accepted, accepted with conditions, rejected, incomplete, or no rules"]
    reason: Annotated[str, "the rule that decided, or what is missing"]

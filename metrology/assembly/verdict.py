"""The verdict on an assembled panel, and its findings: features, and stretches of courses, that do not simply pass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from metrology.acceptance import PanelVerdict, judge_rules, panel_verdict, unruled
from metrology.assembly.rows import FindingRow, RuleRow
from metrology.kinds import BY_NAME, Kind, Quantity
from metrology.limits import PanelSpec
from metrology.panel import PanelLayout
from metrology.results import Feature
from metrology.rules import Rule
from metrology.stretches import Stretch, stretches
from metrology.tolerance import decisive
from metrology.verdicts import IN_ORDER


@dataclass(frozen=True)
class Judgement:
    """What a panel is judged to be."""

    verdict: PanelVerdict
    reason: str
    """The rule that decided, or what is missing."""
    rules: tuple[RuleRow, ...]
    findings: tuple[FindingRow, ...]


def judgement(
    features: Mapping[str, Sequence[Feature]], spec: PanelSpec, rules: Sequence[Rule], layout: PanelLayout,
    area_mm2: float, gaps: Sequence[str],
) -> Judgement:  # fmt: skip
    """Judge a panel by its specification's rules.

    Parameters
    ----------
    features : mapping
        Of the panel, each once and judged, by the names of the kinds.
    area_mm2 : float
        Of the skin that was measured.
    gaps : sequence of str
        What is not covered, or why the panel is not one.
    """
    rows_of = {rivet.rivet_id: rivet.row for rivet in layout.rivets if rivet.row}
    outcomes = judge_rules(features, spec, rules, rows_of, area_mm2)
    verdict, reason = panel_verdict(outcomes, unruled(features, rules), gaps, bool(rules))
    rows = tuple(
        RuleRow(
            each.rule.rule_id, each.rule.said, each.group, each.verdict, each.found, each.doubtful, each.features,
            each.reason,
        )
        for each in outcomes
    )  # fmt: skip
    return Judgement(verdict, reason, rows, tuple(findings(features, spec)))


def findings(features: Mapping[str, Sequence[Feature]], spec: PanelSpec) -> list[FindingRow]:
    """Judged features by the names of their kinds, and stretches of courses, that do not simply pass."""
    return [row for name, rows in features.items() for row in _of_kind(BY_NAME[name], rows, spec)]


def _of_kind(kind: Kind, rows: Sequence[Feature], spec: PanelSpec) -> list[FindingRow]:
    if kind.is_course:
        return [_of_stretch(each) for each in stretches(kind, rows, spec)]  # type: ignore[arg-type]
    return [_of_single(kind, row, decisive(kind, row, spec)) for row in rows if row.decision not in IN_ORDER]


def _of_single(kind: Kind, row: Feature, decided: Quantity | None) -> FindingRow:
    shown = decided or kind.quantities[0]
    return FindingRow(
        kind.name, kind.id_of(row), shown.name, getattr(row, shown.column), getattr(row, shown.u95_column), None, None,
        None, row.x_panel_mm, row.y_panel_mm, row.z_panel_mm, row.severity, row.decision, row.reason,
    )  # fmt: skip


def _of_stretch(found: Stretch) -> FindingRow:
    first = found.excesses[0] if found.excesses else None
    worst = found.worst
    return FindingRow(
        found.kind.name, found.feature_id, (first.quantity if first else found.kind.quantities[0]).name,
        first.value if first else None, first.u95 if first else None, found.from_mm, found.to_mm, found.length_mm,
        worst.x_panel_mm, worst.y_panel_mm, worst.z_panel_mm, found.severity, found.decision, found.said,
    )  # fmt: skip

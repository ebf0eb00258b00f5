"""Acceptance of a panel: rules about many features together, each with its source, and the verdict they lead to.

A rule says how much may lie beyond the limits: a share, a number, neighbours, a length of a seam. It is met for certain
only where the measurements show it. A panel breaks a rule that allows m features beyond a limit if m + 1 features are
beyond it; it is wrongly accepted only if at least one of these is taken for one inside. Each feature therefore needs a
guard band that is missed in one of (m + 1) · 40 cases, so that all together are missed in at most 2.5 % (Bonferroni;
it asks nothing about how errors hang together). With m = 0 that is U95, a single feature's guard band (ISO 14253-1).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from metrology.kinds import BY_NAME, Kind
from metrology.limits import PanelSpec
from metrology.requirements import requirements
from metrology.results import COVERAGE_95, Feature
from metrology.rules import OF_COURSES, Rule

RuleVerdict = Literal["met", "met with conditions", "not met", "not decided"]
PanelVerdict = Literal["accepted", "accepted with conditions", "rejected", "incomplete", "no rules"]

RISK = 0.025
"""Greatest probability of accepting a panel that breaks a rule."""
_NEIGHBOUR = 1.5  # features nearer than this many times the usual distance to the next one are adjacent
_MM2_PER_M2 = 1e6


@dataclass(frozen=True)
class Outcome:
    """What became of a rule in one group of features."""

    rule: Rule
    group: str
    """Zone, row or course; "panel" for all."""
    verdict: RuleVerdict
    found: float | None
    """What the values say: the share, number or length that is beyond; the worst mean."""
    doubtful: float | None
    """The same with everything that is not shown to be inside, and with what was not measured."""
    features: tuple[str, ...]
    """Ids of the features behind it."""
    reason: str


@dataclass(frozen=True)
class _Member:
    """A feature of a group."""

    row: Feature
    inside: float
    """By how many standard deviations its worst quantity lies inside the limits, negative outside; NaN where a quantity
    that has limits was not measured."""

    @property
    def unmeasured(self) -> bool:
        """Whether nobody can say."""
        return bool(np.isnan(self.inside))


def judge_rules(
    features: Mapping[str, Sequence[Feature]], spec: PanelSpec, rules: Iterable[Rule],
    rows_of: Mapping[str, str] | None = None, area_mm2: float | None = None,
) -> list[Outcome]:  # fmt: skip
    """What becomes of every rule, group by group.

    Parameters
    ----------
    features : mapping
        Of the panel, each once, by the names of the kinds.
    rows_of : mapping, optional
        The row of a feature, by its name.
    area_mm2 : float, optional
        Of the skin that was measured.
    """
    outcomes = []
    for rule in rules:
        kind = BY_NAME[rule.kind]
        members = [
            _Member(row, _inside(kind, row, spec, rule))
            for row in features.get(rule.kind, ())
            if rule.zone in (None, row.zone or "default")
        ]
        for name, group in _grouped(kind, rule, members, rows_of or {}).items():
            outcomes.append(_outcome(kind, rule, name, group, spec, area_mm2))
    return outcomes


def _inside(kind: Kind, row: Feature, spec: PanelSpec, rule: Rule) -> float:
    margins = []
    if rule.beyond == "any" and not row.is_missing:
        return float("-inf")
    if row.is_missing or row.decision == "unconfirmed":
        return float("nan")
    for required in requirements(kind, row, spec):
        if rule.quantity and required.name.split(" into ")[0].split(" (")[0] != rule.quantity:
            continue
        limit = required.limit
        if limit is None:
            continue
        if required.value is None or required.u95 is None:
            return float("nan")
        low, high = (limit.lower, limit.upper)
        if rule.beyond == "serious":
            low, high = (limit.serious_lower, limit.serious_upper)
        sides = [required.value - low] if low is not None else []
        sides += [high - required.value] if high is not None else []
        if sides:
            margins.append(min(sides) / max(required.u95 / COVERAGE_95, 1e-9))
    return float(min(margins, default=np.inf))


def _grouped(
    kind: Kind, rule: Rule, members: Sequence[_Member], rows_of: Mapping[str, str]
) -> dict[str, list[_Member]]:
    by_course = rule.measure in OF_COURSES or rule.per == "course"
    groups: dict[str, list[_Member]] = {}
    for member in members:
        name = str(getattr(member.row, kind.id_columns[0]))
        if by_course:
            key = name
        elif rule.per == "zone":
            key = member.row.zone or "default"
        else:
            key = rows_of.get(name, "no row") if rule.per == "row" else "panel"
        groups.setdefault(key, []).append(member)
    return groups


def _outcome(
    kind: Kind, rule: Rule, group: str, members: list[_Member], spec: PanelSpec, area_mm2: float | None
) -> Outcome:
    if kind.is_course:
        members = sorted(members, key=lambda m: getattr(m.row, kind.id_columns[1]))
    if rule.measure == "mean":
        return _of_means(kind, rule, group, members, spec)
    inside = np.array([member.inside for member in members])
    spacing = _spacing(kind, members)
    unit = {"share": 1 / len(members), "density": _MM2_PER_M2 / area_mm2 if area_mm2 else np.inf}.get(
        rule.measure, spacing if rule.measure in OF_COURSES else 1.0
    )
    # How many features may be beyond; a small excess of the division is rounding.
    allowed = int(np.floor(rule.most / unit + 1e-9)) if np.isfinite(unit) else 0
    guard = NormalDist().inv_cdf(1 - RISK / (allowed + 1))
    out, unknown = inside < 0, np.isnan(inside)
    counts = [_count(kind, rule, members, chosen, spacing) for chosen in (out, out | unknown | (inside < guard))]
    surely = _count(kind, rule, members, inside < -guard, spacing)
    by_values, doubtful = counts
    if surely > allowed or by_values > allowed:
        verdict: RuleVerdict = "not met"
    elif unknown.any():
        verdict = "not decided"
    else:
        verdict = "met" if doubtful <= allowed else "met with conditions"
    behind = [m for m, beyond, vague in zip(members, out, unknown | (inside < guard), strict=True) if beyond or vague]
    return Outcome(
        rule,
        group,
        verdict,
        by_values * unit,
        doubtful * unit,
        tuple(kind.id_of(member.row) for member in behind),
        _reason(rule, group, verdict, by_values * unit, doubtful * unit, int(unknown.sum())),
    )


def _spacing(kind: Kind, members: Sequence[_Member]) -> float:
    """Length that one position of a course stands for, mm."""
    if not kind.is_course or len(members) < 2:
        return 1.0
    return float(np.median(np.diff([getattr(member.row, kind.id_columns[1]) for member in members])))


def _count(kind: Kind, rule: Rule, members: Sequence[_Member], chosen: NDArray[np.bool_], spacing: float) -> int:
    """Features of a choice, as the rule counts them."""
    if rule.measure == "adjacent":
        return _largest_cluster(members, chosen)
    if rule.measure == "run":
        return _longest_run([getattr(m.row, kind.id_columns[1]) for m in members], chosen, spacing)
    return int(chosen.sum())


def _longest_run(s: Sequence[float], chosen: NDArray[np.bool_], spacing: float) -> int:
    longest = here = 0
    for k, is_chosen in enumerate(chosen):
        follows = k > 0 and s[k] - s[k - 1] < _NEIGHBOUR * spacing
        here = (here + 1 if follows else 1) if is_chosen else 0
        longest = max(longest, here)
    return longest


def _largest_cluster(members: Sequence[_Member], chosen: NDArray[np.bool_]) -> int:
    """Most features of a choice that hang together as neighbours."""
    places = np.array([(m.row.x_panel_mm, m.row.y_panel_mm, m.row.z_panel_mm) for m in members], float)
    if chosen.sum() < 2 or len(places) < 2:
        return int(chosen.sum())
    distance, _ = cKDTree(places).query(places, k=2)
    reach = _NEIGHBOUR * float(np.median(distance[:, 1]))
    near = cKDTree(places[chosen]).query_ball_point(places[chosen], reach)
    left, largest = set(range(len(near))), 0
    while left:
        cluster, todo = set[int](), [left.pop()]
        while todo:
            k = todo.pop()
            cluster.add(k)
            todo += [n for n in near[k] if n in left]
            left -= set(near[k])
        largest = max(largest, len(cluster))
    return largest


def _of_means(kind: Kind, rule: Rule, group: str, members: Sequence[_Member], spec: PanelSpec) -> Outcome:
    """Means of every stretch; errors of neighbouring positions hang together, so a mean is no surer than they are."""
    s = np.array([getattr(m.row, kind.id_columns[1]) for m in members])
    quantities = [q for q in kind.quantities if rule.quantity in ("", q.name)]
    worst, behind, unknown = np.inf, tuple[str, ...](), 0
    value_there: float | None = None
    for quantity in quantities:
        limits = [spec.zone(m.row.zone).get(quantity.limits[0].name) for m in members]
        values = np.array([getattr(m.row, quantity.column) for m in members], float)
        u95 = np.array([getattr(m.row, quantity.u95_column) for m in members], float)
        for k in range(len(members)):
            window = (s >= s[k]) & (s < s[k] + (rule.over_mm or 0))
            limit = limits[k]
            if limit is None or s[-1] - s[k] < (rule.over_mm or 0) - 2 * _spacing(kind, members):
                continue
            if np.isnan(values[window]).any():
                unknown += 1
                continue
            mean, u = float(values[window].mean()), float(u95[window].mean()) / COVERAGE_95
            inside = limit.margin(mean) / max(u, 1e-9)
            if inside < worst:
                worst, value_there = inside, mean
                behind = tuple(kind.id_of(m.row) for m, chosen in zip(members, window, strict=True) if chosen)
    verdict: RuleVerdict = "met" if worst > COVERAGE_95 else "met with conditions" if worst >= 0 else "not met"
    if unknown and verdict != "not met":
        verdict = "not decided"
    return Outcome(
        rule, group, verdict, value_there, None, behind if verdict != "met" else (),
        f"{rule.said}: worst mean {value_there:+.3f}" if value_there is not None else f"{rule.said}: no such stretch",
    )  # fmt: skip


def _reason(rule: Rule, group: str, verdict: RuleVerdict, found: float, doubtful: float, unknown: int) -> str:
    def amount(value: float) -> str:
        return f"{value:.0%}" if rule.measure == "share" else f"{value:g}"

    where = "" if group == "panel" else f" of {group}"
    text = f"{rule.said}: found {amount(found)}{where}"
    if verdict == "met with conditions":
        text += f", up to {amount(doubtful)} with what lies within the guard band"
    return text + (f"; {unknown} not measured" if unknown else "")


def unruled(features: Mapping[str, Sequence[Feature]], rules: Iterable[Rule]) -> list[tuple[Kind, Feature]]:
    """Features that no rule speaks of: each of them has to meet its limits."""
    ruled = {(rule.kind, rule.zone) for rule in rules if rule.beyond == "limit"}
    return [
        (BY_NAME[name], row)
        for name, rows in features.items()
        for row in rows
        if (name, None) not in ruled and (name, row.zone or "default") not in ruled
    ]


def panel_verdict(
    outcomes: Sequence[Outcome], others: Sequence[tuple[Kind, Feature]], gaps: Sequence[str], has_rules: bool
) -> tuple[PanelVerdict, str]:
    """The verdict on a panel, and what decided it.

    Parameters
    ----------
    outcomes
        Of the rules.
    others
        Features that no rule speaks of.
    gaps
        What was not measured or not seen, or why the panel is not one; such a panel is never accepted.
    """
    if not has_rules:
        return "no rules", "the specification has no acceptance rules"
    outside = [kind.id_of(row) for kind, row in others if row.decision in ("fail", "conditional fail")]
    broken = [outcome for outcome in outcomes if outcome.verdict == "not met"]
    if broken or outside:
        text = "; ".join(f"{outcome.rule.rule_id}: {outcome.reason}" for outcome in broken)
        return "rejected", text or f"beyond limits that no rule allows to exceed: {_listed(outside)}"
    unknown = [kind.id_of(row) for kind, row in others if row.decision in ("not measured", "unconfirmed")]
    undecided = [outcome for outcome in outcomes if outcome.verdict == "not decided"]
    if gaps or undecided or unknown:
        parts = [*gaps, *(f"{outcome.rule.rule_id}: {outcome.reason}" for outcome in undecided)]
        return "incomplete", "; ".join([*parts, *([f"not measured: {_listed(unknown)}"] if unknown else [])])
    close = [outcome for outcome in outcomes if outcome.verdict == "met with conditions"]
    doubtful = [kind.id_of(row) for kind, row in others if row.decision == "conditional pass"]
    if close or doubtful:
        text = "; ".join(f"{outcome.rule.rule_id}: {outcome.reason}" for outcome in close)
        return "accepted with conditions", text or f"within U95 of a limit: {_listed(doubtful)}"
    return "accepted", "every rule is met by more than its guard band"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")

"""Verdicts: how a measured value stands against its limits (paper §5.1, Fig. 9) and how sure that is (ISO 14253-1).

Severity looks at the value alone, as the paper's colours do: green meets the limits, blue is outside them, red is
beyond the serious limits. The decision also looks at the value's expanded uncertainty U95, which serves as guard band:

    pass               inside the limits by more than U95
    conditional pass   inside, but by no more than U95
    conditional fail   outside, but by no more than U95
    fail               outside by more than U95

What was found and may be no fastener is unconfirmed: nobody but a person judges it.
What was not measured is its own state and never a pass; what has no limit is judged neither way. A value whose U95 is
wider than the range that its limits leave cannot be judged by them and counts as not measured.

A seam's step may have limits of its own into the wind (the downstream side stands higher) and out of it. Where the
air's direction across the seam is not known, the step must meet both.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TypeVar

from metrology.kinds import Kind, Quantity, load
from metrology.limits import DEFAULT_ZONE, Limit, PanelSpec, Zone
from metrology.plausibility import unjudged, without
from metrology.requirements import Requirement, downstream_of, limit_of, of_quantity, requirements
from metrology.results import Course, Decision, Feature, Severity
from metrology.stretches import with_stretches
from metrology.verdicts import DECISIONS, SEVERITIES, Verdict

__all__ = ["DEFAULT_ZONE", "RULE", "Limit", "PanelSpec", "Zone", "as_measured", "decisive", "judge"]

Row = TypeVar("Row", bound=Feature)
RULE = "ISO 14253-1, guard band U95"


def _judge(required: Requirement) -> Verdict:
    limit, value, u95 = required.limit, required.value, required.u95
    if limit is None:
        return Verdict(None, "no limit", None)
    if value is None or u95 is None:
        return Verdict(None, "not measured", f"{required.name} not measured")
    severity, decision = limit.severity(value), limit.decision(value, u95)
    if decision == "pass":
        return Verdict(severity, decision, None)
    words = {
        "conditional pass": "within U95 of a limit of",
        "conditional fail": "outside by less than U95 of",
        "fail": "outside",
    }[decision]
    said = f"{required.name} {value:+.3f} ± {u95:.3f} {required.unit} {words} {limit}; {RULE}"
    return Verdict(severity, decision, said)


def _gravest(verdicts: Sequence[Verdict], reason: str | None) -> Verdict:
    decision = min((v.decision for v in verdicts), key=list(DECISIONS).index)
    colours: list[Severity] = [v.severity for v in verdicts if v.severity is not None]
    if decision == "not measured":
        # A green quantity must not stand for the one that is missing; a failing one is still shown.
        colours = [c for c in colours if c != "green"]
    severity = min(colours, key=list(SEVERITIES).index) if colours else None
    reasons = [reason, *(v.reason for v in verdicts)]
    return Verdict(severity, decision, "; ".join(dict.fromkeys(r for r in reasons if r)) or None)


def _judgeable(kind: Kind, row: Row, zone: Zone) -> Row:
    """The feature without the values that are too vague for their limits."""
    for quantity in kind.quantities:
        limit = limit_of(zone, quantity, downstream_of(quantity, row))
        if problem := _too_vague(quantity.name, quantity.unit, getattr(row, quantity.u95_column), limit):
            row = without(row, quantity, problem)
    return row


def _too_vague(name: str, unit: str, u95: float | None, limit: Limit | None) -> str | None:
    """Why a value says nothing: its U95 is wider than what its limits leave."""
    left = limit.range if limit else None
    if u95 is None or not left or u95 <= left:  # limits that allow one value leave nothing
        return None
    return f"{name}: found U95 of {u95:.3g} {unit}, expected less than the {left:.3g} {unit} that its limits leave"


def judge(kind: Kind, rows: Sequence[Row], spec: PanelSpec) -> list[Row]:
    """All features of one kind with severity, decision and the reason for anything short of a pass.

    Positions along a course also name the stretch that they are of.
    """
    judged = [_judged(kind, _judgeable(kind, row, spec.zone(row.zone)), spec) for row in rows]
    return with_stretches(kind, judged, spec) if kind.is_course else judged  # type: ignore[type-var]


def decisive(kind: Kind, row: Feature, spec: PanelSpec) -> Quantity | None:
    """The quantity whose verdict a judged row has, of several the one farthest beyond its limits.

    None where something else than a limit decided.
    """
    zone = spec.zone(row.zone)
    found = [
        (0.0 if required.value is None else required.limit.margin_share(required.value), quantity)
        for quantity in kind.quantities_of(row)
        for required in of_quantity(quantity, row, zone)
        if required.limit is not None and _judge(required).decision == row.decision
    ]
    return min(found, key=lambda each: each[0])[1] if found else None


def as_measured(kind: Kind, row: Row) -> Row:
    """A judged row as it was before, so that another specification can judge it: without what `judge` said of it."""
    names = "|".join(re.escape(quantity.name) for quantity in kind.quantities)
    reason = re.sub(rf"(?:^|; )(?:{names})(?: [^;±]*)? ± .*?; {re.escape(RULE)}", "", row.reason or "")
    parts = [rf"(?:{names})(?: [^;]*)? not measured"]
    otherwise: Verdict | None = load(kind.verdict)(row) if kind.verdict else None
    unlimited: Verdict | None = load(kind.unlimited)(row) if kind.unlimited else None
    parts += [re.escape(said.reason) for said in (otherwise, unlimited) if said and said.reason]
    for part in parts:
        reason = re.sub(rf"(?:^|; ){part}(?=$|; )", "", reason)
    decision: Decision = "unconfirmed" if row.decision == "unconfirmed" else "no limit"
    if isinstance(row, Course):
        row = row.changed(stretch=None, beyond_mm=None)
    return row.changed(severity=None, decision=decision, reason=reason.removeprefix("; ") or None)


def _judged(kind: Kind, row: Row, spec: PanelSpec) -> Row:
    if row.decision == "unconfirmed":
        return unjudged(kind, row)
    otherwise: Verdict | None = load(kind.verdict)(row) if kind.verdict else None
    parts = [*([otherwise] if otherwise else []), *(_judge(required) for required in requirements(kind, row, spec))]
    verdict = _gravest(parts, row.reason)
    if verdict.decision == "no limit" and kind.unlimited:
        unlimited: Verdict | None = load(kind.unlimited)(row)
        verdict = _gravest([unlimited], row.reason) if unlimited else verdict
    return row.changed(severity=verdict.severity, decision=verdict.decision, reason=verdict.reason)

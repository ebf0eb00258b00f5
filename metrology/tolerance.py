"""Verdicts: how a measured value stands against its limits (paper §5.1, Fig. 9) and how sure that is (ISO 14253-1).

Severity looks at the value alone, as the paper's colours do: green meets the limits, blue is outside them, red is
beyond the serious limits. The decision also looks at the value's expanded uncertainty U95, which serves as guard band:

    pass               inside the limits by more than U95
    conditional pass   inside, but by no more than U95
    conditional fail   outside, but by no more than U95
    fail               outside by more than U95

What was found and may be no fastener is unconfirmed: it is judged by nobody but a person.
What was not measured is its own state and never a pass; what has no limit is judged neither way. A value whose U95 is
wider than the range that its limits leave cannot be judged by them and counts as not measured.

A seam's step may have limits of its own into the wind (the downstream side stands higher) and out of it. Where the
air's direction across the seam is not known, the step must meet both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from metrology.fastener import size_said, size_verdict
from metrology.limits import DEFAULT_ZONE, Limit, PanelSpec, Zone
from metrology.plausibility import unjudged, without_height, without_step, without_tilt, without_width
from metrology.requirements import Requirement, downstream_of, limit_of, rivet_requirements, station_requirements
from metrology.results import Decision, Rivet, SeamStation, Severity
from metrology.verdicts import DECISIONS, SEVERITIES

__all__ = ["DEFAULT_ZONE", "RULE", "Limit", "PanelSpec", "Zone", "judge_rivets", "judge_stations"]

RULE = "ISO 14253-1, guard band U95"


@dataclass(frozen=True)
class _Verdict:
    severity: Severity | None
    decision: Decision
    reason: str | None


def _judge(required: Requirement) -> _Verdict:
    limit, value, u95 = required.limit, required.value, required.u95
    if limit is None:
        return _Verdict(None, "no limit", None)
    if value is None or u95 is None:
        return _Verdict(None, "not measured", f"{required.name} not measured")
    severity, decision = limit.severity(value), limit.decision(value, u95)
    if decision == "pass":
        return _Verdict(severity, decision, None)
    words = {
        "conditional pass": "within U95 of a limit of",
        "conditional fail": "outside by less than U95 of",
        "fail": "outside",
    }[decision]
    said = f"{required.name} {value:+.3f} ± {u95:.3f} {required.unit} {words} {limit}; {RULE}"
    return _Verdict(severity, decision, said)


def _judge_size(rivet: Rivet) -> _Verdict:
    """Another fastener than the pattern's is a finding whatever its height."""
    verdict, said = size_verdict(rivet), size_said(rivet)
    if verdict == "wrong":
        return _Verdict("red", "fail", said)
    return _Verdict("blue", "conditional fail", said) if verdict == "doubtful" else _Verdict(None, "no limit", None)


def _gravest(verdicts: Sequence[_Verdict], reason: str | None) -> _Verdict:
    decision = min((v.decision for v in verdicts), key=list(DECISIONS).index)
    colours: list[Severity] = [v.severity for v in verdicts if v.severity is not None]
    if decision == "not measured":
        # A green quantity must not stand for the one that is missing; a failing one is still shown.
        colours = [c for c in colours if c != "green"]
    severity = min(colours, key=list(SEVERITIES).index) if colours else None
    reasons = [reason, *(v.reason for v in verdicts)]
    return _Verdict(severity, decision, "; ".join(dict.fromkeys(r for r in reasons if r)) or None)


def _judgeable_rivet(rivet: Rivet, zone: Zone) -> Rivet:
    """The rivet without the values that are too vague for their limits."""
    if problem := _too_vague("height", "mm", rivet.height_u95_mm, zone.height_mm):
        rivet = without_height(rivet, problem)
    if problem := _too_vague("tilt", "°", rivet.tilt_u95_deg, zone.tilt_deg):
        rivet = without_tilt(rivet, problem)
    return rivet


def _judgeable_station(station: SeamStation, zone: Zone) -> SeamStation:
    """The seam station without the values that are too vague for their limits."""
    if problem := _too_vague("step", "mm", station.step_u95_mm, limit_of(zone, "step_mm", downstream_of(station))):
        station = without_step(station, problem)
    if problem := _too_vague("width", "mm", station.width_u95_mm, zone.width_mm):
        station = without_width(station, problem)
    return station


def _too_vague(name: str, unit: str, u95: float | None, limit: Limit | None) -> str | None:
    """Why a value says nothing: its U95 is wider than what its limits leave."""
    left = limit.range if limit else None
    if u95 is None or not left or u95 <= left:  # limits that allow one value leave nothing
        return None
    return f"{name}: found U95 of {u95:.3g} {unit}, expected less than the {left:.3g} {unit} that its limits leave"


def judge_rivets(rivets: Sequence[Rivet], spec: PanelSpec) -> list[Rivet]:
    """The rivets with severity, decision and the reason for anything short of a pass."""
    judged = []
    for measured in rivets:
        if measured.decision == "unconfirmed":
            judged.append(unjudged(measured))
            continue
        rivet = _judgeable_rivet(measured, spec.zone(measured.zone))
        parts = [_judge_size(rivet), *(_judge(required) for required in rivet_requirements(rivet, spec))]
        verdict = _gravest(parts, rivet.reason)
        judged.append(replace(rivet, severity=verdict.severity, decision=verdict.decision, reason=verdict.reason))
    return judged


def judge_stations(stations: Sequence[SeamStation], spec: PanelSpec) -> list[SeamStation]:
    """The seam stations with severity, decision and the reason for anything short of a pass."""
    judged = []
    for measured in stations:
        station = _judgeable_station(measured, spec.zone(measured.zone))
        verdict = _gravest([_judge(required) for required in station_requirements(station, spec)], station.reason)
        judged.append(replace(station, severity=verdict.severity, decision=verdict.decision, reason=verdict.reason))
    return judged

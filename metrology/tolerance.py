"""Verdicts: how a measured value stands against its limits (paper §5.1, Fig. 9) and how sure that is (ISO 14253-1).

Severity looks at the value alone, as the paper's colours do: green meets the limits, blue is outside them, red is
beyond the serious limits. The decision also looks at the value's expanded uncertainty U95, which serves as guard band:

    pass               inside the limits by more than U95
    conditional pass   inside, but by no more than U95
    conditional fail   outside, but by no more than U95
    fail               outside by more than U95

What was not measured is its own state and never a pass; what has no limit is judged neither way. A value whose U95 is
wider than the range that its limits leave cannot be judged by them and counts as not measured.

A seam's step may have limits of its own into the wind (the downstream side stands higher) and out of it. Where the
air's direction across the seam is not known, the step must meet both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import get_args

from metrology.errors import SpecError
from metrology.plausibility import without_height, without_step, without_tilt, without_width
from metrology.results import Decision, Rivet, SeamStation, Severity

RULE = "ISO 14253-1, guard band U95"

_SEVERITIES: tuple[Severity, ...] = get_args(Severity)
# From harmless to grave; a feature takes the gravest of its quantities' verdicts.
_DECISIONS: tuple[Decision, ...] = (
    "no limit",
    "pass",
    "conditional pass",
    "not measured",
    "conditional fail",
    "fail",
)


@dataclass(frozen=True)
class Limit:
    """Limits of one quantity, in its own unit; None leaves a side open.

    Attributes
    ----------
    lower, upper : float or None
        The value must lie between them.
    serious_lower, serious_upper : float or None
        Beyond these a deviation is serious (red).
    source, revision : str
        The document the limits come from.
    """

    lower: float | None = None
    upper: float | None = None
    serious_lower: float | None = None
    serious_upper: float | None = None
    source: str = ""
    revision: str = ""

    def __post_init__(self) -> None:
        ladder = [x for x in (self.serious_lower, self.lower, self.upper, self.serious_upper) if x is not None]
        if ladder != sorted(ladder):
            raise SpecError(
                f"limits: found serious_lower {self.serious_lower}, lower {self.lower}, upper {self.upper}, "
                f"serious_upper {self.serious_upper}, expected them in ascending order"
            )
        if self.lower is None and self.upper is None:
            raise SpecError("limits: found neither lower nor upper, expected at least one of them")

    def margin(self, value: float) -> float:
        """Distance to the nearest limit: positive inside, negative outside."""
        sides = []
        if self.lower is not None:
            sides.append(value - self.lower)
        if self.upper is not None:
            sides.append(self.upper - value)
        return min(sides)

    @property
    def range(self) -> float | None:
        """Width of what the limits leave; None where a side is open."""
        return None if self.lower is None or self.upper is None else self.upper - self.lower

    def severity(self, value: float) -> Severity:
        """The paper's colour for a value."""
        if self.margin(value) >= 0:
            return "green"
        below = self.serious_lower is not None and value < self.serious_lower
        above = self.serious_upper is not None and value > self.serious_upper
        return "red" if below or above else "blue"

    def decision(self, value: float, u95: float) -> Decision:
        """ISO 14253-1 decision for a value with expanded uncertainty u95."""
        margin = self.margin(value)
        if margin >= 0:
            return "pass" if margin > u95 else "conditional pass"
        return "fail" if -margin > u95 else "conditional fail"

    def __str__(self) -> str:
        low = "−∞" if self.lower is None else f"{self.lower:+.3f}"
        high = "+∞" if self.upper is None else f"{self.upper:+.3f}"
        origin = " ".join(part for part in (self.source, self.revision) if part)
        return f"{low} … {high}" + (f" ({origin})" if origin else "")


@dataclass(frozen=True)
class Zone:
    """A tolerance zone of a panel: the limits that hold for the features in it.

    Attributes
    ----------
    height_mm, tilt_deg, width_mm : Limit or None
    step_mm : Limit or None
        Of the step in either direction.
    step_into_wind_mm, step_out_of_wind_mm : Limit or None
        Upper limits of the step's amount where the downstream side stands higher, and where it stands lower.
    """

    height_mm: Limit | None = None
    tilt_deg: Limit | None = None
    step_mm: Limit | None = None
    width_mm: Limit | None = None
    step_into_wind_mm: Limit | None = None
    step_out_of_wind_mm: Limit | None = None

    def __post_init__(self) -> None:
        for name in ("step_into_wind_mm", "step_out_of_wind_mm"):
            limit = getattr(self, name)
            if limit is None:
                continue
            if limit.lower is not None or limit.serious_lower is not None or limit.upper is None or limit.upper < 0:
                raise SpecError(f"{name}: found {limit}, expected an upper limit of the step's amount alone")


DEFAULT_ZONE = "default"


@dataclass(frozen=True)
class PanelSpec:
    """What a panel must meet. Features without a zone of their own are judged by the zone "default"."""

    panel: str
    revision: str
    zones: Mapping[str, Zone] = field(default_factory=dict)

    def zone(self, name: str | None = None) -> Zone:
        """The zone of that name; what it leaves open is as in the zone "default"."""
        default = self.zones.get(DEFAULT_ZONE, Zone())
        zone = self.zones.get(name or DEFAULT_ZONE, default)
        given = {f.name: getattr(zone, f.name) for f in fields(Zone) if getattr(zone, f.name) is not None}
        return replace(default, **given)


@dataclass(frozen=True)
class _Verdict:
    severity: Severity | None
    decision: Decision
    reason: str | None


def _judge(name: str, unit: str, value: float | None, u95: float | None, limit: Limit | None) -> _Verdict:
    if limit is None:
        return _Verdict(None, "no limit", None)
    if value is None or u95 is None:
        return _Verdict(None, "not measured", f"{name} not measured")
    severity, decision = limit.severity(value), limit.decision(value, u95)
    if decision == "pass":
        return _Verdict(severity, decision, None)
    words = {
        "conditional pass": "within U95 of a limit of",
        "conditional fail": "outside by less than U95 of",
        "fail": "outside",
    }[decision]
    return _Verdict(severity, decision, f"{name} {value:+.3f} ± {u95:.3f} {unit} {words} {limit}; {RULE}")


def _judge_wind(station: SeamStation, zone: Zone) -> _Verdict:
    """The step against its limits into and out of the wind, as one range of the signed step."""
    into, out = zone.step_into_wind_mm, zone.step_out_of_wind_mm
    if into is None and out is None:
        return _judge("step", "mm", None, None, None)
    if station.step_into_wind_mm is not None:
        limit, name, step = _either_way(out, into), "step into the wind", station.step_into_wind_mm
        return _judge(name, "mm", step, station.step_u95_mm, limit)
    amount = None if station.step_mm is None else abs(station.step_mm)
    name = "step (wind direction unknown)"
    return _gravest([_judge(name, "mm", amount, station.step_u95_mm, limit) for limit in (into, out)], None)


def _either_way(out: Limit | None, into: Limit | None) -> Limit:
    """Limits of the step counted positive into the wind, from the amounts allowed either way."""
    origins = [(limit.source, limit.revision) for limit in (out, into) if limit is not None]
    sources, revisions = (" / ".join(dict.fromkeys(parts)) for parts in zip(*origins, strict=True))

    def mirrored(amount: float | None) -> float | None:
        return None if amount is None else -amount

    return Limit(
        lower=mirrored(out.upper) if out else None,
        serious_lower=mirrored(out.serious_upper) if out else None,
        upper=into.upper if into else None,
        serious_upper=into.serious_upper if into else None,
        source=sources,
        revision=revisions,
    )


def _gravest(verdicts: Sequence[_Verdict], reason: str | None) -> _Verdict:
    decision = max((v.decision for v in verdicts), key=_DECISIONS.index)
    colours = [v.severity for v in verdicts if v.severity is not None]
    if decision == "not measured":
        # A green quantity must not stand for the one that is missing; a failing one is still shown.
        colours = [c for c in colours if c != "green"]
    severity = max(colours, key=_SEVERITIES.index) if colours else None
    reasons = [reason, *(v.reason for v in verdicts)]
    return _Verdict(severity, decision, "; ".join(dict.fromkeys(r for r in reasons if r)) or None)


def _judgeable_rivet(rivet: Rivet, zone: Zone) -> Rivet:
    """The rivet without the values that are too vague for their limits."""
    if problem := _too_vague("height", "mm", rivet.height_u95_mm, [_range(zone.height_mm)]):
        rivet = without_height(rivet, problem)
    if problem := _too_vague("tilt", "°", rivet.tilt_u95_deg, [_range(zone.tilt_deg)]):
        rivet = without_tilt(rivet, problem)
    return rivet


def _judgeable_station(station: SeamStation, zone: Zone) -> SeamStation:
    """The seam station without the values that are too vague for their limits."""
    into, out = zone.step_into_wind_mm, zone.step_out_of_wind_mm
    ranges = [_range(zone.step_mm)]
    if station.step_into_wind_mm is None:  # the step must keep to either amount, upwards and downwards
        ranges += [2 * limit.upper for limit in (into, out) if limit is not None and limit.upper is not None]
    elif into is not None or out is not None:
        ranges.append(_either_way(out, into).range)
    if problem := _too_vague("step", "mm", station.step_u95_mm, ranges):
        station = without_step(station, problem)
    if problem := _too_vague("width", "mm", station.width_u95_mm, [_range(zone.width_mm)]):
        station = without_width(station, problem)
    return station


def _range(limit: Limit | None) -> float | None:
    return None if limit is None else limit.range


def _too_vague(name: str, unit: str, u95: float | None, ranges: Sequence[float | None]) -> str | None:
    """Why a value says nothing: its U95 is wider than the narrowest range that its limits leave."""
    narrowest = min((width for width in ranges if width), default=None)  # limits that allow one value leave none
    if u95 is None or narrowest is None or u95 <= narrowest:
        return None
    return f"{name}: found U95 of {u95:.3g} {unit}, expected less than the {narrowest:.3g} {unit} that its limits leave"


def judge_rivets(rivets: Sequence[Rivet], spec: PanelSpec) -> list[Rivet]:
    """The rivets with severity, decision and the reason for anything short of a pass."""
    judged = []
    for measured in rivets:
        zone = spec.zone(measured.zone)
        rivet = _judgeable_rivet(measured, zone)
        verdict = _gravest(
            [
                _judge("height", "mm", rivet.height_mean_mm, rivet.height_u95_mm, zone.height_mm),
                _judge("tilt", "°", rivet.tilt_deg, rivet.tilt_u95_deg, zone.tilt_deg),
            ],
            rivet.reason,
        )
        judged.append(replace(rivet, severity=verdict.severity, decision=verdict.decision, reason=verdict.reason))
    return judged


def judge_stations(stations: Sequence[SeamStation], spec: PanelSpec) -> list[SeamStation]:
    """The seam stations with severity, decision and the reason for anything short of a pass."""
    judged = []
    for measured in stations:
        zone = spec.zone(measured.zone)
        station = _judgeable_station(measured, zone)
        verdict = _gravest(
            [
                _judge("step", "mm", station.step_mm, station.step_u95_mm, zone.step_mm),
                _judge_wind(station, zone),
                _judge("width", "mm", station.width_mm, station.width_u95_mm, zone.width_mm),
            ],
            station.reason,
        )
        judged.append(replace(station, severity=verdict.severity, decision=verdict.decision, reason=verdict.reason))
    return judged

"""Limits, the zones of a panel that they hold in, and the specification that has them all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from metrology.errors import SpecError
from metrology.kinds import LIMITS, Kind
from metrology.results import Decision, Severity


@dataclass(frozen=True)
class Limit:
    """Limits of one quantity, in its own unit; None leaves a side open."""

    lower: float | None = None
    upper: float | None = None
    """lower, upper: the value must lie between them."""
    serious_lower: float | None = None
    serious_upper: float | None = None
    """serious_lower, serious_upper: beyond these a deviation is serious (red)."""
    source: str = ""
    revision: str = ""
    """source, revision: the document the limits come from."""

    def __post_init__(self) -> None:
        ladder = [x for x in (self.serious_lower, self.lower, self.upper, self.serious_upper) if x is not None]
        if ladder != sorted(ladder):
            raise SpecError(
                f"limits: found serious_lower {self.serious_lower}, lower {self.lower}, upper {self.upper}, "
                f"serious_upper {self.serious_upper}, expected them in ascending order"
            )
        if self.lower is None and self.upper is None:
            raise SpecError("limits: found neither lower nor upper, expected at least one of them")

    def relative(self, value: float) -> float | None:
        """Where a value stands between its limits: 0 in their middle, ±1 at them; None where they have no width.

        Of a limit on one side it is the value over the limit, −1 at a lower one.
        """
        scaling = self.scaling
        return None if scaling is None else (value - scaling[0]) / scaling[1]

    @property
    def scaling(self) -> tuple[float, float] | None:
        """What is taken off a value, and what the rest is divided by, to have it relative to the limits."""
        if self.lower is not None and self.upper is not None:
            return (
                (0.5 * (self.lower + self.upper), 0.5 * (self.upper - self.lower)) if self.lower < self.upper else None
            )
        if self.upper is not None:
            return (0.0, self.upper) if self.upper > 0 else None
        return (0.0, -self.lower) if self.lower is not None and self.lower < 0 else None

    @property
    def bounds(self) -> tuple[float | None, float | None, float | None, float | None]:
        """Lower, upper, serious lower, serious upper: the limits without their source."""
        return self.lower, self.upper, self.serious_lower, self.serious_upper

    @property
    def range(self) -> float | None:
        """Width of what the limits leave; None where a side is open."""
        return None if self.lower is None or self.upper is None else self.upper - self.lower

    def margin(self, value: float) -> float:
        """Distance to the nearest limit: positive inside, negative outside."""
        sides = []
        if self.lower is not None:
            sides.append(value - self.lower)
        if self.upper is not None:
            sides.append(self.upper - value)
        return min(sides)

    def margin_share(self, value: float) -> float:
        """`margin` as a share of what the limits leave; itself where they have no width."""
        _, reach = self.scaling or (0.0, 1.0)
        return self.margin(value) / reach

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
class GradedLimit(Limit):
    """An upper limit of an amount that goes with an extent; `upper` is the greatest."""

    steps: tuple[tuple[float, float], ...] = ()
    """tuple of (extent, limit): extents ascending; between them the limit is interpolated, beyond them the nearest one
    holds."""

    def __post_init__(self) -> None:
        super().__post_init__()
        extents = [extent for extent, _ in self.steps]
        if len(extents) < 2 or extents != sorted(set(extents)) or min(min(step) for step in self.steps) < 0:
            raise SpecError(f"steps: found {self.steps}, expected two or more, extents ascending, nothing negative")

    def upper_at(self, extent: float) -> float:
        """The limit at an extent."""
        extents, uppers = (np.array(column, float) for column in zip(*self.steps, strict=True))
        return float(np.interp(extent, extents, uppers))

    def upper_from(self, extent: float) -> float:
        """The greatest limit at an extent or a larger one."""
        return max(self.upper_at(extent), *(upper for at, upper in self.steps if at >= extent), 0.0)

    @property
    def said(self) -> str:
        """The steps, for people."""
        return ", ".join(f"{upper:g} at {extent:g}" for extent, upper in self.steps)


Zone = Mapping[str, Limit]
"""A tolerance zone of a panel: limits by their names (`metrology.kinds.LIMITS`) for the features in it."""
DEFAULT_ZONE = "default"


@dataclass(frozen=True)
class PanelSpec:
    """What a panel must meet. Features without a zone of their own are judged by the zone "default"."""

    panel: str
    revision: str
    zones: Mapping[str, Zone] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, limit in (item for zone in self.zones.values() for item in zone.items()):
            if not LIMITS[name].amount:
                continue
            if limit.lower is not None or limit.serious_lower is not None or limit.upper is None or limit.upper < 0:
                raise SpecError(f"{name}: found {limit}, expected an upper limit of the step's amount alone")

    def zone(self, name: str | None = None) -> Zone:
        """The zone of that name; what it leaves open is as in the zone "default"."""
        default = self.zones.get(DEFAULT_ZONE, {})
        return {**default, **self.zones.get(name or DEFAULT_ZONE, {})}

    def limits_any(self, kind: Kind) -> bool:
        """Whether any zone has a limit of a kind's quantities."""
        names = {limit.name for quantity in kind.quantities for limit in quantity.all_limits}
        return any(names & zone.keys() for zone in self.zones.values())

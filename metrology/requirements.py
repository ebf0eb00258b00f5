"""Which limits a feature must meet: told here, for the inspection, close-ups, trends and reports alike.

A seam's step may have limits of its own into the wind (the downstream side stands higher) and out of it. Where the
air's direction across the seam is not known, the step must meet both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from metrology.kinds import Kind, Quantity
from metrology.limits import GradedLimit, Limit, PanelSpec, Zone
from metrology.results import Feature

Downstream = Literal[-1, 0, 1]
"""Whether a seam's side B lies downstream of side A (1), upstream (−1), or that is not known (0)."""


@dataclass(frozen=True)
class Requirement:
    """A quantity of a feature beside the limit that it must meet."""

    name: str
    unit: str
    """name, unit: for people."""
    value: float | None
    u95: float | None
    """value, u95: as measured; None where it was not."""
    limit: Limit | None
    """None where the specification has none for it."""
    signed: bool = False
    """Whether the value has a direction."""


def requirements(kind: Kind, row: Feature, spec: PanelSpec) -> list[Requirement]:
    """What a feature must meet."""
    zone = spec.zone(row.zone)
    return [required for quantity in kind.quantities_of(row) for required in of_quantity(quantity, row, zone)]


def of_quantity(quantity: Quantity, row: Feature, zone: Zone) -> list[Requirement]:
    """What one quantity of a feature must meet in a zone."""
    value, u95 = getattr(row, quantity.column), getattr(row, quantity.u95_column)
    limit, *by_wind = (zone.get(limit.name) for limit in quantity.limits)
    own = Requirement(quantity.name, quantity.unit, value, u95, limit, quantity.signed)
    graded = _by_extent(quantity, row, zone)
    if not any(by_wind):
        return [graded] if graded and limit is None else [own, *([graded] if graded else [])]
    into, out = by_wind
    required = [own] if limit else []
    as_met = getattr(row, quantity.into_wind)
    if as_met is not None:
        name, both = f"{quantity.name} into the wind", _either_way(out, into)
        return [*required, Requirement(name, quantity.unit, as_met, u95, both, signed=True)]
    name, amount = f"{quantity.name} (wind direction unknown)", None if value is None else abs(value)
    return required + [Requirement(name, quantity.unit, amount, u95, each) for each in (into, out) if each]


def _by_extent(quantity: Quantity, row: Feature, zone: Zone) -> Requirement | None:
    """What a zone asks of a quantity's amount by the extent that the feature has.

    How well the extent is known is part of the uncertainty. Of a feature that is hidden in part, or whose extent has no
    U95, the extent is at least this: it fails what no larger one may have.
    """
    graded = quantity.by_extent
    limit = zone.get(graded.limit.name) if graded else None
    if graded is None or not isinstance(limit, GradedLimit):
        return None
    value, u95 = _value(row, quantity.column), _value(row, quantity.u95_column)
    extent, extent_u95 = _value(row, graded.column), _value(row, graded.u95_column)
    if value is None or u95 is None or extent is None:
        return Requirement(f"{quantity.name} by {graded.word}", quantity.unit, None, None, limit)
    if getattr(row, "hidden_by", None) or extent_u95 is None:
        upper, spread = limit.upper_from(extent), 0.0
    else:
        upper = limit.upper_at(extent)
        spread = 0.5 * abs(limit.upper_at(extent + extent_u95) - limit.upper_at(extent - extent_u95))
    serious = None if limit.serious_upper is None else max(limit.serious_upper, upper)
    there = Limit(upper=upper, serious_upper=serious, source=limit.source, revision=limit.revision)
    name = f"{quantity.name} for a {graded.word} of {extent:.1f} mm"
    return Requirement(name, quantity.unit, abs(value), float(np.hypot(u95, spread)), there)


def downstream_of(quantity: Quantity, row: Feature | Mapping[str, Any]) -> Downstream:
    """On which side of a seam the air arrives, as the value and the value as the air meets it say."""
    value, as_met = (_value(row, name) if name else None for name in (quantity.column, quantity.into_wind))
    if value is None or as_met is None:
        return 0
    return 1 if value * as_met >= 0 else -1


def _value(row: Feature | Mapping[str, Any], name: str) -> float | None:
    value: float | None = row[name] if isinstance(row, Mapping) else getattr(row, name)
    return None if value is None or value != value else value


def limit_of(zone: Zone, quantity: Quantity, downstream: Downstream = 0) -> Limit | None:
    """Everything that a zone asks of a quantity, as one limit of its signed value.

    Parameters
    ----------
    quantity : Quantity
        Where limits by the wind are part of it, the value is side B above side A.
    """
    limit, *by_wind = (zone.get(limit.name) for limit in quantity.limits)
    if not any(by_wind):
        return limit
    into, out = by_wind
    ways = {1: [(out, into)], -1: [(into, out)], 0: [(into, into), (out, out)]}[downstream]
    for way in ways:
        limit = _both(limit, _either_way(*way))
    return limit


def _either_way(fallen: Limit | None, risen: Limit | None) -> Limit | None:
    """Limits of a signed step from the amounts that it may fall and rise."""
    if fallen is None and risen is None:
        return None
    return Limit(
        lower=_mirrored(fallen.upper) if fallen else None,
        serious_lower=_mirrored(fallen.serious_upper) if fallen else None,
        upper=risen.upper if risen else None,
        serious_upper=risen.serious_upper if risen else None,
        **_origins(fallen, risen),
    )


def _both(one: Limit | None, other: Limit | None) -> Limit | None:
    """The limit that a value meets where it meets both; severities and margins are the graver of both."""
    if one is None or other is None:
        return one or other

    def nearer(name: str) -> float | None:
        given = [x for x in (getattr(one, name), getattr(other, name)) if x is not None]
        return (max if name.endswith("lower") else min)(given) if given else None

    lower, upper = nearer("lower"), nearer("upper")
    if lower is not None and upper is not None and lower > upper:
        return one  # nothing meets both: the specification's own limit is the one to show
    serious_lower, serious_upper = nearer("serious_lower"), nearer("serious_upper")
    return Limit(lower, upper, serious_lower, serious_upper, **_origins(one, other))


def _mirrored(amount: float | None) -> float | None:
    return None if amount is None else -amount


def _origins(*limits: Limit | None) -> dict[str, str]:
    given = [limit for limit in limits if limit is not None]
    return {name: " / ".join(dict.fromkeys(getattr(limit, name) for limit in given)) for name in ("source", "revision")}

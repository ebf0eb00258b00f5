"""Which limits a feature must meet: told here, for the inspection, close-ups, trends and reports alike.

A seam's step may have limits of its own into the wind (the downstream side stands higher) and out of it. Where the
air's direction across the seam is not known, the step must meet both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from metrology.limits import Limit, PanelSpec, Zone
from metrology.results import Rivet, SeamStation

Downstream = Literal[-1, 0, 1]
"""Whether a seam's side B lies downstream of side A (1), upstream (−1), or that is not known (0)."""


@dataclass(frozen=True)
class Requirement:
    """A quantity of a feature beside the limit that it must meet.

    Attributes
    ----------
    name, unit : str
        For people.
    value, u95 : float or None
        As measured; None where it was not.
    limit : Limit or None
        None where the specification has none for it.
    """

    name: str
    unit: str
    value: float | None
    u95: float | None
    limit: Limit | None


def rivet_requirements(rivet: Rivet, spec: PanelSpec) -> list[Requirement]:
    """What a rivet must meet."""
    zone = spec.zone(rivet.zone)
    return [
        Requirement("height", "mm", rivet.height_mean_mm, rivet.height_u95_mm, zone.height_mm),
        Requirement("tilt", "°", rivet.tilt_deg, rivet.tilt_u95_deg, zone.tilt_deg),
    ]


def station_requirements(station: SeamStation, spec: PanelSpec) -> list[Requirement]:
    """What a place along a seam must meet."""
    zone, u95 = spec.zone(station.zone), station.step_u95_mm
    into, out = zone.step_into_wind_mm, zone.step_out_of_wind_mm
    required = []
    if zone.step_mm is not None or (into is None and out is None):
        required.append(Requirement("step", "mm", station.step_mm, u95, zone.step_mm))
    if station.step_into_wind_mm is not None:
        if limit := _either_way(out, into):
            required.append(Requirement("step into the wind", "mm", station.step_into_wind_mm, u95, limit))
    else:
        amount = None if station.step_mm is None else abs(station.step_mm)
        required += [
            Requirement("step (wind direction unknown)", "mm", amount, u95, limit) for limit in (into, out) if limit
        ]
    if station.joint == "lap":
        return required  # it has no gap
    return [*required, Requirement("width", "mm", station.width_mm, station.width_u95_mm, zone.width_mm)]


def downstream_of(station: SeamStation) -> Downstream:
    """On which side of a seam station the air arrives, as its two steps say."""
    if station.step_mm is None or station.step_into_wind_mm is None:
        return 0
    return 1 if station.step_mm * station.step_into_wind_mm >= 0 else -1


def limit_of(zone: Zone, quantity: str, downstream: Downstream = 0) -> Limit | None:
    """Everything that a zone asks of a quantity, as one limit of its signed value.

    Parameters
    ----------
    zone : Zone
    quantity : str
        A field of `Zone`; of "step_mm" the limits by wind are part, and the value is side B above side A.
    downstream : −1, 0 or 1
    """
    limit: Limit | None = getattr(zone, quantity)
    if quantity != "step_mm":
        return limit
    into, out = zone.step_into_wind_mm, zone.step_out_of_wind_mm
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

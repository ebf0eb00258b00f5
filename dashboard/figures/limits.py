"""A value between its limits, as a bar of HTML: it is shown often, and a chart would cost more than all the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashboard.locale import Locale
from dashboard.palette import BLUE, GREEN, RED
from metrology.tolerance import Limit
from storage.templates import rendered

_REACH = 2.0  # half the scale's width, in outermost limits
_AIR = 0.12  # beside what the scale must show, as a share of that


@dataclass(frozen=True)
class Scale:
    """What a bar shows, in the value's unit."""

    low: float
    high: float
    """low, high: its ends."""
    zones: tuple[tuple[float, float, str], ...]
    """From, to and colour, those below first."""
    ticks: tuple[float, ...]
    """The limits beyond which a value does not pass."""
    value: float | None
    """Where the value is drawn; None where there is none."""
    beyond: bool
    """Whether the value lies beyond the scale's end, at which it is drawn."""
    spread: float
    """Half of what its uncertainty covers; 0 where it is not known, or beyond the end."""


def limit_scale(value: float | None, u95: float | None, limit: Limit) -> Scale:
    """The scale of a value with its limits; of a value far outside the limits stay legible."""
    lower, upper, serious_lower, serious_upper = limit.bounds
    marks = [mark for mark in limit.bounds if mark is not None]
    reach = _REACH * max(map(abs, marks)) or np.inf
    known = value is not None and bool(np.isfinite(value))
    shown = float(np.clip(value, -reach, reach)) if value is not None and known else None
    beyond = shown is not None and shown != value
    spread = u95 if u95 is not None and np.isfinite(u95) and shown is not None and not beyond else 0.0
    places = [0.0, *marks]
    if shown is not None:
        places += np.clip([shown - 1.3 * spread, shown + 1.3 * spread], -reach, reach).tolist()
    low, high = with_air(places)
    serious = serious_lower is not None or serious_upper is not None
    zones = [(low, high, RED if serious else BLUE)]
    if serious:
        zones.append((_or(serious_lower, low), _or(serious_upper, high), BLUE))
    zones.append((_or(lower, low), _or(upper, high), GREEN))
    ticks = tuple(mark for mark in (lower, upper) if mark is not None)
    return Scale(low, high, tuple(zones), ticks, shown, beyond, spread)


def with_air(places: Sequence[float]) -> tuple[float, float]:
    """The ends of a scale that shows these places, with some air beside them."""
    low, high = float(min(places)), float(max(places))
    air = max(0.01, _AIR * (high - low))
    return low - air, high + air


def limit_bar(value: float | None, u95: float | None, limit: Limit, unit: str, locale: Locale) -> str:
    """A value with its uncertainty on a scale with the zones of its limits."""
    scale = limit_scale(value, u95, limit)

    def percent(place: float) -> float:
        return round(100 * (place - scale.low) / (scale.high - scale.low), 2)

    sign = "" if scale.value is None else "◆" if not scale.beyond else "▶" if scale.value > 0 else "◀"
    return rendered(
        "dashboard",
        "limit_bar.html",
        zones=[(percent(low), percent(high) - percent(low), colour) for low, high, colour in scale.zones],
        ticks=[(percent(tick), locale.number(tick, 2, sign=True)) for tick in scale.ticks],
        at=None if scale.value is None else percent(scale.value),
        spread=0 if scale.value is None else percent(scale.value + scale.spread) - percent(scale.value),
        sign=sign,
        words=locale.measured(value, u95, unit),
    )


def _or(mark: float | None, end: float) -> float:
    return end if mark is None else mark

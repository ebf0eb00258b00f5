"""What the values of a chart are held against: the limits that each of them was judged by.

Features of different zones, and runs of different specifications, have different limits. Where all that a chart shows
have the same, it is drawn in the quantity's unit. Else each value is taken relative to its own limits: 0 is in their
middle, ±1 is at them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dashboard.words import _
from metrology.requirements import Downstream
from metrology.tolerance import Limit

Scale = tuple[str, str, str, int, float, float]
"""config_hash, panel_spec, zone, downstream; what is taken off a value, and what the rest is divided by."""
SIGNS: tuple[Downstream, ...] = (-1, 0, 1)


@dataclass(frozen=True)
class LimitGroup:
    """Values that were judged alike."""

    config_hash: str
    panel_spec: str
    zone: str
    n: int
    """How many values; 0 where only a step of the other sign occurs."""
    downstream: Downstream
    """Of seams, see `metrology.requirements.limit_of`."""
    limit: Limit | None
    readable: bool = True
    """Whether the specification that the run keeps can be read by this version."""


@dataclass(frozen=True)
class Standard:
    """The limits of a chart."""

    limit: Limit | None
    """In the chart's unit: of the quantity, or ±1."""
    scales: tuple[Scale, ...] = ()
    """How to make values relative; empty where the chart is in the quantity's own unit."""
    note: str = ""
    """What a person must know about the limits; "" where there is nothing to say."""

    @property
    def relative(self) -> bool:
        """Whether values are relative to their own limits."""
        return bool(self.scales)


PLAIN = Standard(None)
"""Values as they are."""


def standard_of(groups: Sequence[LimitGroup]) -> Standard:
    """What the values of these groups can be held against together."""
    shown = [group for group in groups if group.n]
    unreadable = sum(group.n for group in shown if not group.readable)
    if len({group.limit.bounds if group.limit else None for group in shown}) < 2 and not unreadable:
        limit = next((group.limit for group in shown), None)
        return Standard(limit, note="" if limit else _("The specification has no limit for this quantity."))
    limited = [group for group in shown if group.limit is not None]
    if not limited:
        return Standard(None, note=_("The limits of these runs cannot be read by this version."))
    scales = tuple(
        (g.config_hash, g.panel_spec, g.zone, g.downstream, *g.limit.scaling)
        for g in groups
        if g.limit is not None and g.limit.scaling is not None
    )
    return Standard(_common(limited), scales, _difference(shown, limited))


def _common(limited: Sequence[LimitGroup]) -> Limit | None:
    """±1 on the sides on which all have a limit."""
    lower, upper = (all(g.limit and g.limit.bounds[side] is not None for g in limited) for side in (0, 1))
    if not lower and not upper:
        return None
    return Limit(-1.0 if lower else None, 1.0 if upper else None, source=_("each one's own limits"))


def _difference(shown: Sequence[LimitGroup], limited: Sequence[LimitGroup]) -> str:
    bounds = sorted({str(group.limit).split(" (")[0] for group in limited})
    named = "; ".join(bounds[:4]) + (" " + _("and {n} more", n=len(bounds) - 4) if len(bounds) > 4 else "")
    said = (
        _(
            "These values were judged by different limits ({named}), so each is shown relative to its own: "
            "0 is in the middle of them, ±1 is at them (of a limit on one side: value over limit).",
            named=named,
        )
        if len(bounds) > 1
        else _("Values are shown relative to their limits ({named}): ±1 is at them.", named=named)
    )
    if not has_capability(shown):
        said += " " + _("Some of the limits are on one side only: there is no capability over all of them.")
    left = sum(g.n for g in shown if g.limit is None or g.limit.scaling is None)
    return said + (
        " " + _("Values without a limit that can be read or divided by, left out: {n}.", n=left) if left else ""
    )


def has_capability(groups: Sequence[LimitGroup]) -> bool:
    """Whether the limits of all values are on the same sides."""
    return len({(g.limit.lower is None, g.limit.upper is None) for g in groups if g.n and g.limit}) < 2

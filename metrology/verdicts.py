"""How severities and decisions look and how grave they are: one table for screen, paper and projector.

A symbol means the same everywhere, and so does the rank. Colours differ by medium: those of the screen show on light
and dark ground, those of the paper are darker, those of the projector are the paper's (§5.1) green, blue and red made
bright; all are apart for colour-blind eyes (Okabe and Ito, "Color Universal Design", 2008), and none stands alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from metrology.results import Decision, Severity

Symbol = Literal["disc", "diamond", "cross", "ring"]


@dataclass(frozen=True)
class Verdict:
    """What a feature, or one of its quantities, is judged to be; `reason` says why it is no pass."""

    severity: Severity | None
    decision: Decision
    reason: str | None = None


@dataclass(frozen=True)
class SeverityLook:
    """A severity."""

    words: str
    short: str
    """For the projector, in capitals."""
    symbol: Symbol
    """Filled disc, filled diamond, diagonal cross, empty ring. The projector's ring round a head has ticks where the
    diamond has its corners or the cross its arms, none for a disc, and is broken for a ring."""
    sign: str
    """The symbol as a letter."""
    screen: str
    paper: str
    """screen, paper: colour as #RRGGBB."""
    projector: tuple[int, int, int]
    """(red, green, blue): 0 … 255."""


@dataclass(frozen=True)
class DecisionLook:
    """A decision."""

    sign: str
    """Never one of the severities' signs."""
    tone: Literal["good", "fair", "doubtful", "bad", "none"]
    """How it is shaded where it stands as a word."""
    note: str = ""
    """Behind a projected value."""


SEVERITIES: dict[Severity | None, SeverityLook] = {
    "red": SeverityLook("seriously outside", "SERIOUS", "cross", "✖", "#D55E00", "#D55E00", (255, 64, 48)),
    "blue": SeverityLook("slightly outside", "OUT", "diamond", "◆", "#56B4E9", "#0072B2", (70, 150, 255)),
    None: SeverityLook("not judged", "NOT JUDGED", "ring", "○", "#8C8C8C", "#6B7280", (255, 255, 255)),
    "green": SeverityLook("meets the limits", "OK", "disc", "●", "#009E73", "#009E73", (0, 214, 110)),
}
"""From grave to harmless."""

DECISIONS: dict[Decision, DecisionLook] = {
    "fail": DecisionLook("✗", "bad"),
    "conditional fail": DecisionLook("(✗)", "doubtful", "*"),
    "not measured": DecisionLook("?", "none"),
    "unconfirmed": DecisionLook("…", "none"),
    "conditional pass": DecisionLook("(✓)", "fair", "*"),
    "pass": DecisionLook("✓", "good"),
    "no limit": DecisionLook("–", "none"),
}
"""From grave to harmless; a feature takes the gravest of its quantities' decisions."""

OUTSIDE: tuple[Decision, ...] = tuple(name for name, look in DECISIONS.items() if look.tone in ("bad", "doubtful"))
"""The value lies beyond a limit."""
IN_ORDER: tuple[Decision, ...] = ("pass", "no limit")
"""What nobody needs to look at."""
OPEN: tuple[Decision, ...] = tuple(name for name in DECISIONS if name not in IN_ORDER)
"""What a person must look at."""


def gravity(decision: str) -> int:
    """0 for the gravest decision; a word of another version ranks last."""
    order = list[str](DECISIONS)
    return order.index(decision) if decision in order else len(order)

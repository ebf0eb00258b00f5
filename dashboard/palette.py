"""The screen's colours; how verdicts look is said in `metrology.verdicts`, for screen, paper and projector at once."""

from __future__ import annotations

from dashboard.words import _
from metrology.results import Decision
from metrology.verdicts import DECISIONS as LOOKS
from metrology.verdicts import OPEN, SEVERITIES, Symbol

GREEN, BLUE, RED, GREY = (SEVERITIES[name].screen for name in ("green", "blue", "red", None))
# Okabe and Ito, "Color Universal Design" (2008), the lighter of each pair so that dark ground carries them too.
ORANGE, YELLOW, PURPLE = "#E69F00", "#F0E442", "#CC79A7"
INK = "#8A8F98"  # lines and text that must show on both grounds

_PLOTLY: dict[Symbol, str] = {"disc": "circle", "diamond": "diamond", "cross": "x", "ring": "circle-open"}
SEVERITY_COLOURS: dict[str | None, str] = {name: look.screen for name, look in SEVERITIES.items()}
SEVERITY_SYMBOLS: dict[str | None, str] = {name: _PLOTLY[look.symbol] for name, look in SEVERITIES.items()}
SEVERITY_WORDS: dict[str | None, str] = {name: look.words for name, look in SEVERITIES.items()}

DECISIONS: tuple[Decision, ...] = tuple(LOOKS)
"""From grave to harmless."""
OPEN_DECISIONS: tuple[Decision, ...] = OPEN
"""What a person must look at."""
DECISION_SIGNS: dict[str, str] = {name: look.sign for name, look in LOOKS.items()}
_BADGES = {"bad": "red", "doubtful": "orange", "fair": "blue", "good": "green", "none": "gray"}
DECISION_BADGES: dict[str, str] = {name: _BADGES[look.tone] for name, look in LOOKS.items()}
_TONES = {"bad": RED, "doubtful": ORANGE, "fair": BLUE, "good": GREEN, "none": GREY}
DECISION_COLOURS: dict[str, str] = {name: _TONES[look.tone] for name, look in LOOKS.items()}

DIVERGING = [[0.0, "#0072B2"], [0.25, "#56B4E9"], [0.5, "#F2F2F2"], [0.75, "#E69F00"], [1.0, "#D55E00"]]
"""Below, on and above the skin."""
SEQUENTIAL = "Cividis"
COUNTS = [[0.0, "rgba(0,158,115,0.25)"], [1e-9, "#F0E442"], [0.4, "#E69F00"], [1.0, "#D55E00"]]
"""Nothing to do is green, then yellow to vermilion."""
MISSING = "rgba(128,128,128,0.18)"


def quantity_words(name: str) -> str:
    """A quantity as people call it: what is stored as the width of a seam is its gap."""
    return _("gap") if name == "width" else _(name)


def decision_words(decision: object) -> str:
    """A decision with its sign; a word of another version as it is."""
    name = str(decision)
    return f"{DECISION_SIGNS[name]} {_(name)}" if name in DECISION_SIGNS else name

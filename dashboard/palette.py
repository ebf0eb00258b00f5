"""Colours and shapes of verdicts: apart for colour-blind eyes on light and dark ground, and never colour alone."""

from __future__ import annotations

# Okabe and Ito, "Color Universal Design" (2008), the lighter of each pair so that dark ground carries them too.
GREEN, BLUE, RED, ORANGE, YELLOW, PURPLE, GREY = (
    "#009E73",
    "#56B4E9",
    "#D55E00",
    "#E69F00",
    "#F0E442",
    "#CC79A7",
    "#8C8C8C",
)
INK = "#8A8F98"  # lines and text that must show on both grounds

SEVERITY_COLOURS: dict[str | None, str] = {"green": GREEN, "blue": BLUE, "red": RED, None: GREY}
SEVERITY_SYMBOLS: dict[str | None, str] = {"green": "circle", "blue": "diamond", "red": "x", None: "cross-thin"}
SEVERITY_WORDS: dict[str | None, str] = {
    "green": "meets the limits",
    "blue": "slightly outside",
    "red": "seriously outside",
    None: "not judged",
}

DECISIONS = ("fail", "conditional fail", "not measured", "conditional pass", "pass", "no limit")
"""From grave to harmless."""
OPEN_DECISIONS = ("fail", "conditional fail", "not measured", "conditional pass")
"""What a person must look at."""
DECISION_MARKS = {
    "fail": "✖ fail",
    "conditional fail": "◆ conditional fail",
    "not measured": "? not measured",
    "conditional pass": "◇ conditional pass",
    "pass": "● pass",
    "no limit": "– no limit",
}
DECISION_BADGES = {
    "fail": "red",
    "conditional fail": "orange",
    "not measured": "gray",
    "conditional pass": "blue",
    "pass": "green",
    "no limit": "gray",
}

DIVERGING = [[0.0, "#0072B2"], [0.25, "#56B4E9"], [0.5, "#F2F2F2"], [0.75, "#E69F00"], [1.0, "#D55E00"]]
"""Below, on and above the skin."""
SEQUENTIAL = "Cividis"
COUNTS = [[0.0, "rgba(0,158,115,0.25)"], [1e-9, "#F0E442"], [0.4, "#E69F00"], [1.0, "#D55E00"]]
"""Nothing to do is green, then yellow to vermilion."""
MISSING = "rgba(128,128,128,0.18)"

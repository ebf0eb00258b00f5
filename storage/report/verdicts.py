"""Verdicts as a report shows them: word, sign and colour together, so that nobody depends on colours."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from metrology.results import Decision, Severity

# From grave to harmless. A scan with something not measured has not passed.
ORDER: tuple[Decision, ...] = (
    "fail",
    "conditional fail",
    "not measured",
    "conditional pass",
    "pass",
    "no limit",
)
SIGNS: dict[str, str] = {
    "fail": "✗",
    "conditional fail": "(✗)",
    "not measured": "?",
    "conditional pass": "(✓)",
    "pass": "✓",
    "no limit": "–",
}
CLASSES: dict[str, str] = {
    "fail": "fail",
    "conditional fail": "doubt",
    "not measured": "none",
    "conditional pass": "nearly",
    "pass": "pass",
    "no limit": "none",
}
# Okabe and Ito's colours, apart for every common kind of colour vision: green meets, blue is out, red is serious.
COLOURS: dict[Severity | None, str] = {"green": "#009E73", "blue": "#0072B2", "red": "#D55E00", None: "#6b7280"}


def gravest(features: Iterable[Mapping[str, Any]]) -> str:
    """The gravest decision; "not measured" where there is nothing to decide on."""
    return min((feature["decision"] for feature in features), key=ORDER.index, default="not measured")


def counted(features: Iterable[Mapping[str, Any]]) -> list[tuple[str, int]]:
    """How often each decision occurs, gravest first."""
    found = Counter(feature["decision"] for feature in features)
    return [(decision, found[decision]) for decision in ORDER if found[decision]]


def needs_attention(feature: Mapping[str, Any]) -> bool:
    """Whether a person should look at a feature."""
    return feature["decision"] not in ("pass", "no limit")

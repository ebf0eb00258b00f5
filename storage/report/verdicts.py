"""Verdicts as a report shows them: word, sign and colour together, so that nobody depends on colours."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from metrology.results import Severity
from metrology.verdicts import DECISIONS, OPEN, SEVERITIES, gravity
from storage.wording import _

SIGNS: dict[str, str] = {name: look.sign for name, look in DECISIONS.items()}
_CLASSES = {"bad": "fail", "doubtful": "doubt", "fair": "nearly", "good": "pass", "none": "none"}
CLASSES: dict[str, str] = {name: _CLASSES[look.tone] for name, look in DECISIONS.items()}
COLOURS: dict[Severity | None, str] = {name: look.paper for name, look in SEVERITIES.items()}


def key() -> str:
    """What the symbols of drawings mean."""
    return "; ".join(f"{look.sign} {_(look.words)}" for look in reversed(SEVERITIES.values()))


def gravest(features: Iterable[Mapping[str, Any]]) -> str:
    """The gravest decision; "not measured" where there is nothing to decide on."""
    return min((feature["decision"] for feature in features), key=gravity, default="not measured")


def counted(features: Iterable[Mapping[str, Any]]) -> list[tuple[str, int]]:
    """How often each decision occurs, gravest first."""
    found = Counter(feature["decision"] for feature in features)
    return [(decision, found[decision]) for decision in DECISIONS if found[decision]]


def needs_attention(feature: Mapping[str, Any]) -> bool:
    """Whether a person should look at a feature."""
    return feature["decision"] in OPEN

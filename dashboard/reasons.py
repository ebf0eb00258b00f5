"""Stored reasons and warnings in the person's language.

Results keep their reasons as English text, clause after clause, and warnings as sentences. What one of these patterns
fits is worded anew; anything else stays as it was stored.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache, lru_cache

from dashboard.causes import CAUSES
from dashboard.palette import quantity_words
from dashboard.refusals import GENERAL, HALVES, REFUSALS
from dashboard.sentences import CLAUSES, SENTENCES, WORDS
from dashboard.words import _, language
from metrology.kinds import KINDS

PATTERNS = (
    "from {first} to {last} mm ({length} mm), worst at {worst} mm: {reason}",
    "from {first} to {last} mm ({length} mm), worst at {worst} mm",
    "{quantity} {value} ± {u95} {unit} outside by less than U95 of {limit}",
    "{quantity} {value} ± {u95} {unit} within U95 of a limit of {limit}",
    "{quantity} {value} ± {u95} {unit} outside {limit}",
    "{quantity} not measured",
    "{quantity}: found U95 of {u95} {unit}, expected less than the {left} {unit2} that its limits leave",
    "skin: points in {n} of {all} directions, at least {least} needed",
    "skin: {n} usable points, at least {least} needed",
    "skin: its points lie too unevenly for a surface",
    "head: its points lie on no one surface",
    "head: {n} points clear of its recesses, at least {least} needed",
    "head: its points scatter {n} times as far as the skin's",
    "points lie too unevenly for a surface",
    "no points at the head",
    "its rim shows in {share} of all directions, and the surface has no step",
    "a ring that one camera shows and the other does not",
    "a ring without a step, whose line is unlike the gaps of the fasteners here",
    "a ring without a step, whose line is unlike the gaps of the fasteners here: {reason}",
    "a ring that hardly steps, whose line is unlike the fasteners' gaps here: {reason}",
    "a wide line that steps, unlike the fasteners' gaps here: {reason}",
    "it is wider",
    "it takes more light",
    "it looks alike from both cameras, as paint does",
    "they are dark, and it is bright",
    "they are bright, and it is dark",
    "a ring where too few points of the skin tell what it is",
    "head: {n} points clear of its rim, at least {least} needed",
    "head: {n} points between recess and rim, at least {least} needed",
    "a ring without a step, of another size than the fasteners here and in no row of theirs",
    "it stands out of the skin unlike all fasteners here, in no row of theirs: a chip or a drop may lie there",
    "too few points of skin beside the seam",
    "skin lines meet at another angle than beside: something lies on the skin",
    "too narrow for its width to be measured: under {limit} mm",
    "temporary fastener: it stands {height} mm proud",
    "flushness is not measured",
    "open hole of {diameter} mm where no limit asks for one",
    "missing fastener {fastener}: {reason}",
    "missing: {reason}",
    "no head found where the pattern has one",
    "the skin was not measured there",
    "{reason} ({hole})",
    "open hole of {diameter} mm",
    "filled hole of {diameter} mm",
    "open hole",
    "filled hole",
    "filled hole of {diameter} mm: what belongs there is to be decided",
    "filled hole: what belongs there is to be decided",
    "something lies on the skin: remove it and scan again",
    "no circle follows its rim",
    "{defect} without a limit that judges it: to be decided",
    "line without measurable depth: its points leave ±{depth} mm",
    *CAUSES,
    *CLAUSES,
)
"""What reasons say, by the places in it; the first that fits is taken."""
_MORE = re.compile(r" and (\d+) more$")
_TEXTS, _NAMES = (
    ("reason", "said", "what", "advice", "cause"),
    ("defect", "many", "per", "subject", "camera", "extent", "decision", "verdict"),
)
_WORDED = {
    "quantity": lambda text: _quantity(text),
    "names": lambda text: _MORE.sub(lambda found: f" {_('and {n} more', n=found[1])}", text),
    **dict.fromkeys(_TEXTS, lambda text: worded(text)),
    **dict.fromkeys(("found", "expected"), lambda text: _half(text)),
    **dict.fromkeys(_NAMES, lambda text: _(text)),
}
"""Places that hold words of ours."""
_QUANTITIES = "|".join(
    re.escape(name)
    for name in sorted(
        {WORDS[0]} | {name for kind in KINDS for q in kind.quantities for name in (q.name, q.said)}, reverse=True
    )
)
PARTLY = (
    "{quantity} into the wind", "{quantity} (wind direction unknown)", "{quantity} by {extent}",
    "{quantity} for a {extent} of {size} mm",
)  # fmt: skip
"""What a limit asks of a quantity where it does not ask the same of all features."""
_PLACES = {
    "quantity": rf"(?:{_QUANTITIES})(?: into the wind| \(wind direction unknown\)| by \w+| for a \w+ of [\d.]+ mm)?",
    "extent": r"\w+", "reason": ".+", "said": "(?:at most|no stretch|mean) .+?", "rule": r"[\w.-]+",
    "group": r"[\w.-]+", "n": r"[\d.]+", "hole": r"H\d+", "station": r"\S+",
}  # fmt: skip
"""What may stand in a place, where not anything may."""
_PLACE_OF_QUANTITY = {**_PLACES, "quantity": _QUANTITIES}
AND = " and "
"""Between parts of what was found."""
SEPARATOR = " · "
"""Between warnings that stand in one text."""


def worded(text: str) -> str:
    """A stored reason, clause by clause."""
    return _of_language(language(), text)


@lru_cache(maxsize=5000)
def _of_language(_language: str, text: str) -> str:
    return SEPARATOR.join(map(_sentence, text.split(SEPARATOR)))


def _sentence(text: str) -> str:
    whole = _fitted(text, SENTENCES) or (_fitted(text, PATTERNS) if text.startswith("from ") else None)
    whole = whole or _fitted(text, REFUSALS)
    return whole or "; ".join(map(_clause, text.split("; ")))


def _clause(text: str) -> str:
    return _fitted(text, PATTERNS) or _fitted(text, HALVES) or _fitted(text, GENERAL) or text


def _half(text: str) -> str:
    """What was found or expected, each part of it that is worded: the longest parts first."""
    parts, said = text.split(AND), list[str]()
    while parts:
        ends = range(len(parts), 0, -1)
        end = next((end for end in ends if _fitted(AND.join(parts[:end]), HALVES)), 1)
        part = AND.join(parts[:end])
        said.append(_fitted(part, HALVES) or part)
        del parts[:end]
    return _(AND).join(said)


def _quantity(text: str) -> str:
    """A quantity, or what a limit asks of it, as people call it."""
    for pattern in PARTLY:
        if found := re.fullmatch(expression_of(pattern, _PLACE_OF_QUANTITY), text):
            values = {
                name: said if name == "size" else (quantity_words if name == "quantity" else _)(said)
                for name, said in found.groupdict().items()
            }
            return _(pattern, **values)
    return quantity_words(text)


def _fitted(clause: str, patterns: tuple[str, ...]) -> str | None:
    for pattern, expression in _expressions(patterns).items():
        if found := expression.fullmatch(clause):
            values = {
                name: _WORDED[name](text) if name in _WORDED else text for name, text in found.groupdict().items()
            }
            return _(pattern, **values) if values else _(pattern)
    return None


@cache
def _expressions(patterns: tuple[str, ...]) -> dict[str, re.Pattern[str]]:
    return {pattern: re.compile(expression_of(pattern, _PLACES)) for pattern in patterns}


def expression_of(pattern: str, places: Mapping[str, str]) -> str:
    """The expression that finds what stands in a pattern's places, each by its name and of what may stand there."""
    parts = re.split(r"\{(\w+)\}", pattern)
    return "".join(
        f"(?P<{part}>{places.get(part, '.+?')})" if i % 2 else re.escape(part) for i, part in enumerate(parts)
    )

"""The unit of lengths, as a command or a file says it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
_WORDS = {
    "mm": r"mm|milli-?met(?:er|re)s?",
    "cm": r"cm|centi-?met(?:er|re)s?",
    "m": r"m|met(?:er|re)s?",
    "in": r"in|inch(?:es)?",
}
_KEY = re.compile(r"(?i)(?:.*\.)?(?:(?:length|translation|baseline|distance|world|t)_?)?units?(?:_of_(?:length|t))?")
_ENDING = re.compile(r"(?i)(?:^|[._])(?:t|tvec|trans|translation|baseline)_(mm|cm|m|meters?|metres?)$")


def without_unit(name: str) -> str:
    """The name of a length without the unit that it ends in."""
    return name[: match.start(1) - 1] if (match := _ENDING.search(name)) else name


def told_unit(values: Mapping[str, Any]) -> float | None:
    """Millimetres of the unit that a file names (`units: m`, `T_mm`); None where it names none, or two.

    Parameters
    ----------
    values : mapping
        Flat names to values.
    """
    said = [value for name, value in values.items() if isinstance(value, str) and _KEY.fullmatch(name)]
    said += [match[1] for name in values if (match := _ENDING.search(name))]
    found = {
        MM_PER_UNIT[unit]
        for text in said
        for unit, words in _WORDS.items()
        if re.fullmatch(words, text.strip(), re.IGNORECASE)
    }
    return found.pop() if len(found) == 1 else None

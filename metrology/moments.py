"""Moments as text: ISO 8601 with a zone, and nothing else that Python or a library would take for a time."""

from __future__ import annotations

import re
from datetime import UTC, datetime

_EXAMPLE = "such as 2026-11-20T08:15:00Z or 2026-11-20T09:15:00+01:00"
_EXPECTED = f"an ISO 8601 time with its zone, {_EXAMPLE}"
# Extended or basic, to the minute at least. Digits are 0 to 9 only.
_DATE_AND_TIME = (
    r"(?:[0-9]{4}-[0-9]{2}-[0-9]{2}[Tt ][0-9]{2}:[0-9]{2}(?::[0-9]{2}(?:[.,][0-9]+)?)?"
    r"|[0-9]{8}[Tt][0-9]{4}(?:[0-9]{2}(?:[.,][0-9]+)?)?)"
)
_ZONE = r"(?:[Zz]|[+-][0-9]{2}(?::?[0-9]{2})?)"


def moment_of(text: str) -> datetime:
    """The moment that ISO 8601 text with a zone names, in UTC; what follows the sixth digit of a second is left out.

    Raises
    ------
    ValueError
        What was expected, in words.
    """
    if not re.fullmatch(_DATE_AND_TIME + _ZONE, text):
        raise ValueError(_EXPECTED)
    try:
        moment = datetime.fromisoformat(text.upper())
    except ValueError:
        raise ValueError(f"a day that there is, hours 00 to 23, minutes and seconds 00 to 59, {_EXAMPLE}") from None
    return in_utc(moment)


def in_utc(moment: datetime) -> datetime:
    """A moment that carries its zone, in UTC."""
    if moment.tzinfo is None:
        raise ValueError(_EXPECTED)
    try:
        return moment.astimezone(UTC)
    except OverflowError:
        raise ValueError("a time that UTC has, too") from None

"""In which language a report is written: English, unless whoever makes it brings another's words.

    with written_in(wording):
        scene_report(store, scene)

Texts of the reports are English in the code; a translation is asked of the wording where a text is used.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass


@dataclass(frozen=True)
class Wording:
    """The words of a language."""

    language: str = "en"
    """Its code."""
    text: Callable[[str], str] = str
    """A text of the code in this language."""
    reason: Callable[[str], str] = str
    """A stored reason or warning in this language."""
    decimal: str = "."
    """The decimal mark."""


AT, STRETCH = "{name} at {place} mm", "{name} {first}–{last} mm"
"""How a position along a course is named, and a stretch of it."""
_ALONG = re.compile(r"(?<![\w@.+-])(?P<name>[^\s,;:()@]+)@(?P<first>-?\d+\.\d)(?:-(?P<last>-?\d+\.\d))?(?![\w.])")
_current: ContextVar[Wording] = ContextVar("wording")
_ENGLISH = Wording()


@contextmanager
def written_in(wording: Wording | None) -> Iterator[None]:
    """What is written within is in this language."""
    token = _current.set(wording or _ENGLISH)
    try:
        yield
    finally:
        _current.reset(token)


def wording() -> Wording:
    """Of the language that is written in."""
    return _current.get(_ENGLISH)


def N_(text: str) -> str:
    """Mark a text for translation; it is worded where it is shown."""
    return text


def _(text: str, /, **values: object) -> str:
    """A text in the language, with values in its places."""
    worded = wording().text(text)
    return worded.format(**values) if values else worded


def capital(text: str) -> str:
    """A text with a capital at its beginning."""
    return text[:1].upper() + text[1:]


def reason(text: object) -> str:
    """A stored reason or warning in the language; "" of none."""
    return named(wording().reason(str(text))) if text else ""


def named(text: str) -> str:
    """A text with its positions and stretches of courses as people read them."""
    return positions_said(text, wording().text, lambda place: decimals(place.removesuffix(".0")))


def positions_said(text: str, word: Callable[[str], str], number: Callable[[str], str]) -> str:
    """A text with what is written as ids are in words: M1@8.0 is M1 at 8 mm, M1@136.0-200.0 is M1 136–200 mm.

    Parameters
    ----------
    word : callable
        `AT` and `STRETCH` in the language.
    number : callable
        A place as people write it.
    """

    def said(found: re.Match[str]) -> str:
        first, last = (number(place) if place else "" for place in found.group("first", "last"))
        name = found["name"]
        return (word(STRETCH) if last else word(AT)).format(name=name, place=first, first=first, last=last)

    return _ALONG.sub(said, text)


def decimals(number: str) -> str:
    """A number as the language writes it."""
    return number.replace(".", wording().decimal)

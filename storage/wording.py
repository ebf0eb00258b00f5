"""In which language a report is written: English, unless whoever makes it brings another's words.

    with written_in(wording):
        scene_report(store, scene)

Texts of the reports are English in the code; a translation is asked of the wording where a text is used.
"""

from __future__ import annotations

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


def _(text: str, /, **values: object) -> str:
    """A text in the language, with values in its places."""
    worded = wording().text(text)
    return worded.format(**values) if values else worded


def capital(text: str) -> str:
    """A text with a capital at its beginning."""
    return text[:1].upper() + text[1:]


def reason(text: object) -> str:
    """A stored reason or warning in the language; "" of none."""
    return wording().reason(str(text)) if text else ""


def decimals(number: str) -> str:
    """A number as the language writes it."""
    return number.replace(".", wording().decimal)

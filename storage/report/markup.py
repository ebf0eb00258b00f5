"""The parts that every report page has: the shell, tables, numbers, pictures within the page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from typing import Any

from markupsafe import Markup

from storage.report.letterhead import Letterhead
from storage.report.verdicts import CLASSES, SIGNS
from storage.templates import data_uri, part, rendered
from storage.wording import _, decimals

_PACKAGE = "storage.report"


def page(
    template: str, title: str, package: str = _PACKAGE, letterhead: Letterhead | None = None, **values: Any
) -> str:
    """A whole HTML document that refers to nothing outside itself."""
    made = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    return rendered(package, template, title=title, made=made, letterhead=letterhead, **values)


def section(name: str, *values: Any) -> Markup:
    """A section that several reports share."""
    return part(_PACKAGE, "sections.html", name, *values)


def _part(name: str, *values: Any) -> Markup:
    return part(_PACKAGE, "parts.html", name, *values)


def badge(decision: str, count: int | None = None, big: bool = False) -> Markup:
    """A decision with its sign, and how often it occurs."""
    return _part("badge", _(decision), SIGNS[decision], CLASSES[decision], count, big)


def link(anchor: str, text: str) -> Markup:
    """A link to another part of the page."""
    return _part("link", anchor, text)


def code(text: str) -> Markup:
    """A name as a program writes it."""
    return _part("code", text)


def missing(text: str) -> Markup:
    """A link of a chain that is not there, and what would close it."""
    return _part("missing", text)


def number(value: float | None, digits: int, sign: bool = False) -> str:
    """A number, or a dash."""
    return "–" if value is None else decimals(f"{value:{'+' if sign else ''}.{digits}f}")


def with_u95(value: float | None, u95: float | None, digits: int, sign: bool = False) -> str:
    """A value with its expanded uncertainty."""
    if value is None:
        return "–"
    return number(value, digits, sign) + ("" if u95 is None else f" ± {number(u95, digits)}")


def table(
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    numeric: Sequence[int] = (),
    groups: Sequence[tuple[str, int]] = (),
) -> Markup:
    """A table; `numeric` columns stand right-aligned, a last column "why" is set smaller.

    Parameters
    ----------
    groups : sequence of (name, number of columns)
        Heads that several columns share, in a row above theirs.
    """
    return _part("table", heads, rows, numeric, groups)


def facts(pairs: Iterable[tuple[str, str]]) -> Markup:
    """Names and what they are."""
    return _part("facts", pairs)


def figure(content: str, caption: str) -> Markup:
    """A picture or drawing with words under it."""
    return _part("figure", content, caption)


def png_figure(content: bytes, words: str, caption: str) -> Markup:
    """A PNG within the page; `words` stand for it where pictures are not shown."""
    return figure(_part("picture", data_uri(content, "png"), words), caption)


def moment(value: datetime | None) -> str:
    """A time in UTC."""
    return "–" if value is None else f"{value.astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC"

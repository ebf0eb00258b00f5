"""What the pages say, in the person's language.

    _("Nothing was found on this scan.")          a text of the pages
    _("{n} scans", n=locale.whole(number))        with values, which a translation may put elsewhere
    _(decision)                                   a word that is declared elsewhere (`dashboard.catalogue.declared`)
    TITLE = N_("Overview")                        a text that is worded later, by _(TITLE)

Texts are English in the code; `locales/LANGUAGE/LC_MESSAGES/dashboard.po` has them in other languages, and
`python -m dashboard.catalogue LANGUAGE` brings such a file up to date. What has no translation is English.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from pathlib import Path

import streamlit as st
from streamlit import runtime

ENGLISH = "en"
LANGUAGES = {ENGLISH: "English", "de": "Deutsch"}
"""What each language calls itself."""
KEPT = "flushline_language"
"""Where a session keeps its language: a click is acted on before the page speaks."""
_FOLDER = Path(__file__).parent / "locales"
_spoken: ContextVar[str | None] = ContextVar("language", default=None)


def _known(language: str) -> str:
    return language if language in LANGUAGES else ENGLISH


def speak(language: str) -> None:
    """From now on texts are worded in a language."""
    _spoken.set(_known(language))


@contextmanager
def speaking(language: str) -> Iterator[None]:
    """Texts that are asked for within are worded in a language."""
    token = _spoken.set(_known(language))
    try:
        yield
    finally:
        _spoken.reset(token)


def language() -> str:
    """The language that texts are worded in."""
    spoken = _spoken.get()
    if spoken is None and runtime.exists():
        spoken = st.session_state.get(KEPT)
    return spoken or ENGLISH


def N_(text: str) -> str:
    """Mark a text for translation; it is worded where it is shown."""
    return text


def _(text: str, /, **values: object) -> str:
    """A text in the person's language, with values in its places."""
    spoken = language()
    worded = text if spoken == ENGLISH else translations(spoken).get(text, text)
    return worded.format(**values) if values else worded


def po_file(language: str) -> Path:
    """The catalogue of a language."""
    return _FOLDER / language / "LC_MESSAGES" / "dashboard.po"


@cache
def translations(language: str) -> Mapping[str, str]:
    """Translations by their English texts."""
    from babel.messages.pofile import read_po

    with po_file(language).open("rb") as file:
        catalogue = read_po(file)
    return {str(message.id): str(message.string) for message in catalogue if message.id and message.string}

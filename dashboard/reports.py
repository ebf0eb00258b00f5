"""Reports in the person's language, and buttons for them; they are made when somebody asks for them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import streamlit as st

from dashboard.locale import Locale
from dashboard.words import ENGLISH, _, language, speaking, translations
from storage.report import Report
from storage.wording import Wording


def wording_of(locale: Locale, spoken: str) -> Wording:
    """The words of reports in a language."""
    known = {} if spoken == ENGLISH else translations(spoken)

    def reason(text: str) -> str:
        with speaking(spoken):  # made when it is asked for, which is no run of the page
            return locale.reason(text)

    return Wording(spoken, lambda text: known.get(text, text), reason, locale.separators[0])


def offer_report(name: str, locale: Locale, made: Callable[[Wording], Report]) -> None:
    """Buttons for a report as PDF and as HTML.

    Parameters
    ----------
    name : str
        Of the file, without its suffix.
    made : callable
        Gives the report in these words.
    """
    words = wording_of(locale, language())
    with st.container(horizontal=True, vertical_alignment="center", width="content"):
        for label, suffix, kind in (
            (_("Report (PDF)"), ".pdf", "application/pdf"),
            (_("Report (HTML)"), ".html", "text/html"),
        ):
            st.download_button(
                label,
                partial(_file, partial(made, words), suffix),
                f"{name}{suffix}",
                kind,
                icon=":material/picture_as_pdf:" if suffix == ".pdf" else ":material/html:",
                on_click="ignore",
                key=f"report-{suffix}",
            )


def _file(made: Callable[[], Report], suffix: str) -> bytes:
    return made().file(suffix)

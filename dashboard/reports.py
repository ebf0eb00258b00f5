"""Buttons for reports; they are made when somebody asks for them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import streamlit as st

from dashboard.words import _
from storage.report import Report


def offer_report(name: str, made: Callable[[], Report]) -> None:
    """Buttons for a report as PDF and as HTML.

    Parameters
    ----------
    name : str
        Of the file, without its suffix.
    """
    with st.container(horizontal=True, vertical_alignment="center"):
        for label, suffix, kind in (
            (_("Report (PDF)"), ".pdf", "application/pdf"),
            (_("Report (HTML)"), ".html", "text/html"),
        ):
            st.download_button(
                label,
                partial(_file, made, suffix),
                f"{name}{suffix}",
                kind,
                icon=":material/picture_as_pdf:" if suffix == ".pdf" else ":material/html:",
                on_click="ignore",
                key=f"report-{suffix}",
            )


def _file(made: Callable[[], Report], suffix: str) -> bytes:
    return made().file(suffix)

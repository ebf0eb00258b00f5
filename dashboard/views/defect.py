"""The close-up of a defect of the skin on a page."""

from __future__ import annotations

from typing import Any

import streamlit as st

from dashboard.closeup import NOT_KEPT
from dashboard.figures.defect import defect_map, defect_sections
from dashboard.frame import plain
from dashboard.locale import Locale
from dashboard.words import N_, _
from metrology.fits import DefectForm

_MAP = N_("Heights over the skin as it would be without the defect; grey: no points of sound skin.")
_EDGE = N_(
    "The straight-edge lies on the surface. On skin that is curved under it, the gap under it is less than the depth, "
    "which counts from the skin as it would be."
)


def show_defect(locale: Locale, measured: Any, form: DefectForm | None) -> None:
    """Its map, and the sections along and across it, as the run kept them."""
    if form is None:
        st.info(_("No close-up: {problem}", problem=plain(_(NOT_KEPT))))
        return
    options = {"displaylogo": False}
    depth, u95 = float(measured.depth_mm), float(measured.depth_u95_mm)
    st.plotly_chart(defect_map(form, locale, 280), key="defect-map", config=options)
    st.plotly_chart(defect_sections(form, depth, u95, locale), key="defect-sections", config=options)
    st.caption(_(_MAP) + (f" {_(_EDGE)}" if depth > 0 else ""))

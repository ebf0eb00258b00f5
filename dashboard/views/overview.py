"""Overview: what is new since this person looked before, and where work waits."""

from __future__ import annotations

import streamlit as st

from dashboard.address import one_of
from dashboard.frame import PageContext, told
from dashboard.views.morning import what_is_new
from dashboard.views.waiting import where_work_waits
from dashboard.words import N_, _

TITLE = N_("Overview")
_VIEWS = {N_("What is new"): what_is_new, N_("Where work waits"): where_work_waits}


def render(context: PageContext) -> None:
    """Show the page."""
    problem = context.archive.review().problem
    if problem:
        st.warning(_("The review log needs attention: {problem}", problem=told(problem)), icon=":material/warning:")
    left, right, __ = st.columns([3, 4, 5])
    view = left.segmented_control(
        _("View"), list(_VIEWS), format_func=_, label_visibility="collapsed", **one_of("view", list(_VIEWS))
    )
    _VIEWS.get(str(view), what_is_new)(context, right)

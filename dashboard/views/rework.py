"""Before and after rework, side by side, as the panel page shows it."""

from __future__ import annotations

import streamlit as st

from dashboard.before_after import Side, before_and_after
from dashboard.frame import PageContext, plain
from dashboard.palette import decision_words, quantity_words
from dashboard.panels import PanelView
from dashboard.words import _
from metrology.kinds import BY_NAME
from storage.review import Feature
from storage.wording import capital

_WIDTH_PX = 180


def show_before_after(context: PageContext, view: PanelView, chosen: Feature) -> None:
    """The feature as it was when work was decided about it, and as the newest scan since shows it."""
    found = before_and_after(context.archive, view, chosen)
    if found is None:
        return
    with st.container(border=True, key="before-after"):
        st.markdown(f":small[**{capital(_(found.disposition))}: {_(found.state)}**]")
        if not found.same_names:
            st.caption(_("The panel was not recognised on one of these scans: names do not tell the same feature."))
            return
        for column, side, words in zip(
            st.columns(2), (found.before, found.after), (_("Before"), _("After")), strict=True
        ):
            with column:
                _show(context, chosen, side, words)


def _show(context: PageContext, chosen: Feature, side: Side, words: str) -> None:
    if side.picture is not None:
        st.image(side.picture, width=_WIDTH_PX)
    st.markdown(f":small[**{words}** · {context.locale.time(side.scene.captured_at)}]")
    if side.row is None:
        st.caption(_("not found on this scan"))
        return
    values = [
        f"{quantity_words(quantity.name)} "
        + context.locale.measured(
            getattr(side.row, quantity.column), getattr(side.row, quantity.u95_column), quantity.unit, quantity.signed
        )
        for quantity in BY_NAME[chosen.kind].quantities[:2]
    ]
    st.caption(plain(" · ".join([decision_words(str(side.row.decision)), *values])))

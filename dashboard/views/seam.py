"""Panel: one seam along its whole length."""

from __future__ import annotations

from collections.abc import Sequence

import streamlit as st

from dashboard.address import one_of
from dashboard.figures.seam import seam_course_figure
from dashboard.frame import PageContext
from dashboard.panels import PanelView
from dashboard.picking import clickable_chart
from dashboard.seam_course import SeamCourse, seam_course
from dashboard.views.panel_tables import look_at
from dashboard.words import _
from metrology.kinds import SEAM_STATION
from storage.review import Feature


def show_seam(context: PageContext, view: PanelView, seams: Sequence[str], chosen: Feature | None) -> None:
    """Step and gap of a seam from its beginning to its end; a click leads to the close-up of a position."""
    looked_at = chosen.id.split("@")[0] if chosen is not None and chosen.kind == SEAM_STATION.name else ""
    name = seams[0]
    if len(seams) > 1:
        name = str(st.segmented_control(_("Seam"), seams, label_visibility="collapsed",
                                        **one_of("seam", seams, looked_at)) or name)  # fmt: skip
    course = seam_course(context.archive, view, name)
    fig = seam_course_figure(course, chosen, context.locale)
    clickable_chart(fig, f"seam-{name}", look_at, {"displaylogo": False}, above=330)
    st.caption(" ".join(_said(course)))


def _said(course: SeamCourse) -> list[str]:
    """What the chart shows, in words."""
    said = [
        _(
            "Dashed: limits. Grey band: ± U95. Coloured bands: stretches that do not simply pass. Click a position for "
            "its close-up."
        )
    ]
    if course.before:
        said.append(_("Grey line: {aircraft}, the aircraft before.", aircraft=course.before))
    if course.downstream:
        way = "A → B" if course.downstream == 1 else "B → A"
        said.append(_("The air flows {way}: a step above 0 faces the wind.", way=way))
    else:
        said.append(_("Step: side B above side A; the specification does not say where the wind blows."))
    return said

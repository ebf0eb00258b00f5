"""One feature: what was measured, how it stands against its limits, why, and what it was measured on."""

from __future__ import annotations

from typing import Any

import streamlit as st

from dashboard.closeup import RivetCloseUp, SeamSection, rivet_close_up, seam_section
from dashboard.figures.closeup import rivet_map, rivet_section, seam_figure
from dashboard.figures.limits import limit_bar
from dashboard.figures.scene import SceneFeatures
from dashboard.findings import feature_parameter, feature_words
from dashboard.frame import PageContext, link, plain, told
from dashboard.palette import DECISION_BADGES, decision_words, quantity_words
from dashboard.scenes import find_feature, required_by, requirements
from dashboard.views.defect import show_defect
from dashboard.words import N_, _
from metrology.errors import FlushlineError
from metrology.kinds import BY_NAME, DEFECT, RIVET, SEAM_STATION
from metrology.requirements import limit_of
from metrology.tolerance import PanelSpec
from storage.review import Feature
from storage.wording import capital

HOW_DECIDED = N_(
    "Decided after ISO 14253-1: a value fails or passes where it lies beyond or within its limits by more than its "
    "uncertainty (U95, which holds in 95 of 100 cases). Nearer to a limit it fails or passes conditionally: the "
    "measurement alone cannot tell."
)


def close_up(context: PageContext, row: Any, features: SceneFeatures, chosen: Feature, compact: bool = False) -> None:
    """What was measured at one feature, how it stands against its limits, and why.

    Parameters
    ----------
    compact : bool
        Without the maps: for narrow places.
    """
    measured = find_feature(features, chosen)
    if measured is None:
        st.info(_("This feature is not on the newest run of the scan."))
        return
    kind = BY_NAME[chosen.kind]
    with st.container(horizontal=True, vertical_alignment="center"):
        named = feature_words(chosen.id, context.locale)
        st.markdown(f"**{capital(_(kind.subject))} {plain(named)}**")
        decision = str(measured.decision)
        st.badge(plain(decision_words(decision)), color=DECISION_BADGES.get(decision, "gray"))  # type: ignore[arg-type]
        if compact:
            link(
                "scene",
                _("Close-up"),
                ":material/center_focus_strong:",
                scene=row.scene_id,
                feature=feature_parameter(chosen),
            )
        link(
            "trends",
            _("Trend"),
            ":material/show_chart:",
            what=kind.subject,
            panel=row.panel,
            station=row.station,
            name=str(getattr(measured, kind.id_columns[0])),
        )
    _values(context, row, measured, chosen)
    if kind is RIVET:
        _diameter(context, measured)
    reason = getattr(measured, "reason", None)
    if not absent(reason):
        why = plain(context.locale.reason(reason))
        st.markdown(":small[**" + _("Why") + f":** {why}]", help=_(HOW_DECIDED))
    if kind is DEFECT and (accepted := context.archive.accepted(str(row.scene_id)).get(chosen.id)):
        st.markdown(f":small[:material/history: {plain(context.locale.reason(str(accepted)))}]")
    if compact:
        return
    try:
        cloud, fits = context.archive.cloud(row.cloud_path), context.archive.fits(row.bundle_path)
    except FlushlineError as problem:
        st.info(_("No close-up: {problem}", problem=told(problem)))
        return
    if kind is RIVET:
        _rivet(context, row, measured, rivet_close_up(cloud, measured, fits.head(chosen.id)))
    elif kind is SEAM_STATION:
        fit = fits.section(str(measured.seam_id), float(measured.s_mm))
        _seam(context, seam_section(cloud, measured, fit))
    elif kind is DEFECT:
        show_defect(context.locale, measured, fits.form(chosen.id))


def _values(context: PageContext, row: Any, measured: Any, chosen: Feature) -> None:
    """Every value that was judged, with the limit it was judged by."""
    locale = context.locale
    try:
        required = requirements(context.archive, row.bundle_path, chosen, measured)
    except FlushlineError:
        required = None
    if required is None:
        st.caption(_("This version cannot read the limits of this run; the verdict is the run's own."))
        required = required_by(chosen, measured, PanelSpec("", ""))
    for start in range(0, len(required), 2):
        for column, wanted in zip(st.columns(2), required[start : start + 2], strict=False):
            with column:
                value = locale.measured(wanted.value, wanted.u95, wanted.unit, wanted.signed)
                st.markdown(f":small[{capital(quantity_words(wanted.name))} **{plain(value)}**]")
                if wanted.limit is None:
                    st.caption(_("no limit"))
                    continue
                st.html(limit_bar(wanted.value, wanted.u95, wanted.limit, wanted.unit, locale))


def _diameter(context: PageContext, measured: Any) -> None:
    """The head's diameter beside the one that its place asks for, where that is known."""
    if absent(measured.diameter_nominal_mm) or absent(measured.diameter_mm):
        return
    found = context.locale.measured(measured.diameter_mm, measured.diameter_u95_mm, "mm", False)
    expected = context.locale.number(measured.diameter_nominal_mm, 1)
    of_expected = _("of {expected} mm expected", expected=expected)
    title = _("Diameter")
    st.markdown(f":small[{title}] **{plain(found)}** :small[{of_expected}]")


def _rivet(context: PageContext, row: Any, measured: Any, found: RivetCloseUp | str) -> None:
    if isinstance(found, str):
        st.info(_("No close-up: {problem}.", problem=plain(found)))
        return
    spec = context.archive.specification(row.bundle_path)
    zone = None if absent(measured.zone) else str(measured.zone)
    limit = limit_of(spec.zone(zone), RIVET.quantities[0]) if spec else None
    options = {"displaylogo": False}
    st.plotly_chart(rivet_section(found, limit, context.locale, 205), key="section", config=options)
    st.plotly_chart(rivet_map(found, context.locale, 190), key="rivet-map", config=options)


def _seam(context: PageContext, found: SeamSection | str) -> None:
    if isinstance(found, str):
        st.info(_("No section: {problem}.", problem=plain(found)))
        return
    st.plotly_chart(seam_figure(found, context.locale, 360), key="section", config={"displaylogo": False})
    st.caption(
        _(
            "L1, L2: the skin on sides A and B. D, G: where the edges turn down most steeply. D′, G′: the edges on the "
            "skin lines. H: step, B above A. W: gap. All as the inspection fitted them."
        )
    )


def absent(value: object) -> bool:
    """Whether a cell of a table is empty."""
    return value is None or (isinstance(value, float) and value != value)

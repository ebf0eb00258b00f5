"""The close-up of a panel's feature, with sliders to the same place on other aircraft and on other nights."""

from __future__ import annotations

from typing import Any

import streamlit as st

from dashboard.findings import feature_parameter, feature_words
from dashboard.frame import PageContext, link, plain
from dashboard.panels import InScan
from dashboard.same_place import at_same_place, scans_of_place
from dashboard.scenes import load_scene_row
from dashboard.views.feature import close_up
from dashboard.words import _


def show_at_place(context: PageContext, found: InScan) -> None:
    """The feature on one of the scans of its place; at first on the one that is in the panel."""
    scene = _chosen(context, found)
    if scene.scene_id == found.scene.scene_id:
        _show(context, scene, found)
        return
    there = at_same_place(context.archive, found, scene)
    if there.feature is None:
        at = context.locale.time(scene.captured_at)
        st.info(
            _("Names do not tell the same feature on the scan of {aircraft}, {time}: the panel was not recognised "
              "there or here.", aircraft=plain(scene.aircraft_serial), time=at)
            if not there.comparable
            else _("The scan of {aircraft}, {time}, has nothing at this place.",
                   aircraft=plain(scene.aircraft_serial), time=at)
        )  # fmt: skip
        return
    _show(context, scene, InScan(scene, there.features, there.feature))
    if there.by_name:
        st.caption(_("Found by its name: without a pattern of the panel nothing else tells that it is the same one."))


def _chosen(context: PageContext, found: InScan) -> Any:
    """The scan that the sliders name: an aircraft, and a night of it."""
    own, key = found.scene, f"{found.scene.scene_id}-{found.feature}"
    scans = scans_of_place(context.archive, own, context.settings.not_aircraft)
    aircraft = [str(name) for name in scans["aircraft_serial"].drop_duplicates(keep="last")]
    left, right = st.columns(2)
    serial = str(own.aircraft_serial)
    if len(aircraft) > 1:
        with left:
            serial = st.select_slider(_("Aircraft"), aircraft, serial, key=f"aircraft-{key}")
    nights = scans[scans["aircraft_serial"] == serial]
    names = [str(name) for name in nights["scene_id"]]
    times = dict(zip(names, (context.locale.time(at) for at in nights["captured_at"]), strict=True))
    first = str(own.scene_id) if serial == own.aircraft_serial else names[-1]
    if len(names) > 1:
        with right:
            first = st.select_slider(_("Night"), names, first, format_func=times.__getitem__, key=f"{serial}-{key}")
    return own if first == own.scene_id else load_scene_row(context.archive, first) or own


def _show(context: PageContext, scene: Any, found: InScan) -> None:
    words, at = feature_words(found.feature.id, context.locale), context.locale.time(scene.captured_at)
    st.caption(
        _("{name} on the scan of {aircraft}, station {station}, {time}", name=plain(words),
          aircraft=plain(scene.aircraft_serial), station=plain(scene.station), time=at)
    )  # fmt: skip
    close_up(context, scene, found.features, found.feature)
    link("review", _("Decide in the review"), ":material/fact_check:", aircraft=scene.aircraft_serial,
         panel=scene.panel, scene=scene.scene_id, feature=feature_parameter(found.feature))  # fmt: skip

"""Runs and rigs: what the flows did, how long each step took, and how the rigs are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC

import pandas as pd
import streamlit as st

from dashboard.address import one_of
from dashboard.figures.runs import rig_figure, seconds_figure
from dashboard.filters import newest_scan
from dashboard.findings import LAST_WEEK, PERIODS, Selection, start_of
from dashboard.flow_runs import configured_api, flow_runs
from dashboard.frame import PageContext, go, plain
from dashboard.quarantine import put_aside
from dashboard.reasons import SEPARATOR
from dashboard.room import show_chart
from dashboard.tables import show_table
from dashboard.words import N_, _
from metrology.steps import TIMED
from storage.archive.views import TAKEN_AT

TITLE = N_("Runs and rigs")


def render(context: PageContext) -> None:
    """Show the page."""
    left, right = st.columns([1, 4], vertical_alignment="bottom")
    period = left.selectbox(_("Scanned"), list(PERIODS), format_func=_, **one_of("period", list(PERIODS), LAST_WEEK))
    selection = Selection(since=start_of(period, newest_scan(context.archive)))
    view = right.segmented_control(_("View"), list(_VIEWS), format_func=_, **one_of("view", list(_VIEWS)))
    _VIEWS.get(str(view), _runs)(context, selection)


def _runs(context: PageContext, selection: Selection) -> None:
    condition, parameters = selection.where()
    medians = ", ".join(f"median(seconds_{step}) AS seconds_{step}" for step in TIMED)
    nights = context.archive.rows(
        "SELECT date_trunc('day', processed_at) AS day, count(*) AS scenes, "
        "count(*) FILTER (status <> 'ok') AS warned, count(*) FILTER (rig_verdict = 'unjudged') AS unjudged, "
        "min(processed_at) AS first, max(processed_at) AS last, median(seconds_total) AS seconds_total, "
        f"{medians} FROM scenes WHERE {condition} GROUP BY 1 ORDER BY 1 DESC LIMIT 400",
        parameters,
    )
    if nights.empty:
        st.info(_("No scan was inspected in that time."))
        return
    left, right = st.columns([3, 2])
    with left:
        st.markdown(_("**Scans inspected per day** (UTC)"))
        nights["date"] = [replace(context.locale, zone=UTC).day(day) for day in nights["day"]]
        show_table(
            nights,
            {
                "date": _("Day"),
                "scenes": _("Scans"),
                "warned": _("With warnings"),
                "unjudged": _("Rig not judged"),
                "first": _("First stored"),
                "last": _("Last stored"),
                "seconds_total": _("Median, s"),
            },
            context.locale,
            key="nights",
            height=400,
            above=300,
        )
    with right:
        st.markdown(_("**Seconds per step**, median of each day"))
        show_chart(seconds_figure(nights, context.locale), "seconds", above=290)


def _rigs(context: PageContext, selection: Selection) -> None:
    condition, parameters = selection.where()
    days = context.archive.rows(
        f"SELECT rig_id, date_trunc('day', {TAKEN_AT}) AS day, max({TAKEN_AT}) AS last_used, count(*) AS scenes, "
        "median(epipolar_rms_px) AS epipolar, median(projector_rms_px) AS projector, "
        "median(sigma_z_median_mm) AS sigma, median(valid_fraction) AS valid, "
        "count(*) FILTER (rig_verdict = 'unjudged') AS unjudged "
        f"FROM scenes WHERE {condition} GROUP BY ALL ORDER BY 2, 1",
        parameters,
    )
    if days.empty:
        st.info(_("Nothing was scanned in that time."))
        return
    show_chart(rig_figure(days, context.locale), "rigs", above=520)
    st.caption(
        _(
            "Cameras: how far what both see lies from where one says the other must see it. Projector: how far what "
            "it showed lies from where the rig says (medians of a day). A slow rise is drift, a jump is a knock: "
            "calibrate again. Noise: standard deviation of a point's depth."
        )
    )
    latest = days.groupby("rig_id", as_index=False).last()
    for counted in ("scenes", "unjudged"):
        latest[counted] = latest["rig_id"].map(days.groupby("rig_id")[counted].sum())
    show_table(
        latest.rename(
            columns={
                "epipolar": "epipolar_px",
                "projector": "projector_px",
                "sigma": "sigma_mm",
                "valid": "valid_fraction",
            }
        ),
        {
            "rig_id": _("Rig calibration"),
            "last_used": _("Last used"),
            "scenes": _("Scans"),
            "unjudged": _("Rig not judged"),
            "epipolar_px": _("Cameras, px (last day)"),
            "projector_px": _("Projector, px (last day)"),
            "sigma_mm": _("Noise, mm (last day)"),
            "valid_fraction": _("Share of pixels with a point (last day)"),
        },
        context.locale,
        key="rig-table",
        height=180,
    )


def _flows(context: PageContext, _selection: Selection) -> None:
    api = configured_api(context.settings.prefect_api)
    if api is None:
        st.info(
            _(
                "No Prefect server is configured. Start the dashboard with PREFECT_API_URL set, or name the server in "
                "its settings (`prefect_api`), to see scheduled and failed flow runs."
            )
        )
        return
    runs = flow_runs(api)
    left, right = st.columns([5, 1], vertical_alignment="center")
    left.markdown(_("**Flow runs** at {api}, the newest first · select one to open it in Prefect", api=plain(api)))
    right.button(_("Look again"), icon=":material/refresh:", key="look-again")
    if runs.empty:
        st.info(_("The server knows no run of Flushline's flows yet."))
        return
    _link_to_picked(runs)
    show_table(
        runs,
        {
            "flow": _("Flow"),
            "run": _("Flow run"),
            "state": _("State"),
            "started": _("Started"),
            "seconds": _("Seconds"),
            "message": _("Message"),
        },
        context.locale,
        key="flow-runs",
        names=list(runs["page"]),
        picked=_pick_run,
        above=300,
    )


def _pick_run(page: str) -> None:
    st.session_state["flow_run"] = page


def _link_to_picked(runs: pd.DataFrame) -> None:
    picked = runs[runs["page"] == st.session_state.get("flow_run")]
    for run in picked.head(1).to_dict("records"):
        st.link_button(_("Open {run} in Prefect", run=plain(run["run"])), run["page"], icon=":material/open_in_new:")


def _failures(context: PageContext, selection: Selection) -> None:
    condition, parameters = selection.where()
    warned = context.archive.rows(
        "SELECT aircraft_serial, panel, station, captured_at, scene_id, rig_id, rig_verdict, "
        f"array_to_string(warnings, '{SEPARATOR}') AS reason, status FROM scenes "
        f"WHERE status <> 'ok' AND {condition} ORDER BY {TAKEN_AT} DESC, scene_id LIMIT 500",
        parameters,
    )
    st.markdown(_("**Inspected with warnings** · select one to open it"))
    if warned.empty:
        st.success(_("No inspection in that time had a warning."), icon=":material/check:")
    else:
        show_table(
            warned,
            {
                "aircraft_serial": _("Aircraft"),
                "panel": _("Panel"),
                "station": _("Station"),
                "captured_at": _("Scanned"),
                "rig_id": _("Rig"),
                "rig_verdict": _("Rig check"),
                "reason": _("Warning"),
            },
            context.locale,
            key="warned",
            height=400,
            names=[str(scene) for scene in warned["scene_id"]],
            picked=lambda scene: go("scene", scene=scene),
            above=420,
        )
    st.markdown(_("**Could not be inspected**"))
    inboxes = context.settings.inboxes
    if not inboxes:
        st.caption(_("Name the inboxes in the settings (`inboxes = [...]`) to see what their quarantine holds."))
        return
    failed = put_aside(inboxes)
    if failed.empty:
        st.success(_("No scan is in quarantine."), icon=":material/check:")
        return
    show_table(
        failed,
        {"at": _("Put aside"), "scene": _("Folder of the scan"), "inbox": _("Inbox"), "why": _("Why")},
        context.locale,
        key="failed",
    )


_VIEWS: dict[str, Callable[[PageContext, Selection], None]] = {
    N_("Runs and seconds per step"): _runs,
    N_("Rig health"): _rigs,
    N_("Warnings and failures"): _failures,
    N_("Flow runs"): _flows,
}

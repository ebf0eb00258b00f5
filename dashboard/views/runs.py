"""Runs and rigs: what the flows did, how long each step took, and how the rigs are."""

from __future__ import annotations

import pandas as pd
import streamlit as st

from dashboard.figures.runs import rig_figure, seconds_figure
from dashboard.filters import newest_scan
from dashboard.findings import LAST_WEEK, PERIODS, Selection, start_of
from dashboard.frame import Desk, go
from dashboard.tables import show_table
from storage.archive.schema import STEPS

TITLE = "Runs and rigs"


def render(desk: Desk) -> None:
    """Show the page."""
    period = st.selectbox(
        "Scanned", list(PERIODS), index=list(PERIODS).index(LAST_WEEK), key="period", bind="query-params", width=240
    )
    selection = Selection(since=start_of(period, newest_scan(desk.archive)))
    runs, rigs, failures = st.tabs(["Runs and seconds per step", "Rig health", "Warnings and failures"])
    with runs:
        _runs(desk, selection)
    with rigs:
        _rigs(desk, selection)
    with failures:
        _failures(desk, selection)


def _runs(desk: Desk, selection: Selection) -> None:
    condition, parameters = selection.where()
    medians = ", ".join(f"median(seconds_{step}) AS seconds_{step}" for step in STEPS)
    nights = desk.archive.rows(
        "SELECT date_trunc('day', processed_at) AS day, count(*) AS scenes, "
        "count(*) FILTER (status <> 'ok') AS warned, "
        "min(processed_at) AS first, max(processed_at) AS last, median(seconds_total) AS seconds_total, "
        f"{medians} FROM scenes WHERE {condition} GROUP BY 1 ORDER BY 1 DESC LIMIT 400",
        parameters,
    )
    if nights.empty:
        st.info("No scene was inspected in that time.")
        return
    left, right = st.columns([6, 5])
    with left:
        st.markdown("**Scenes inspected per day** (UTC)")
        nights["date"] = [desk.habits.day(day) for day in nights["day"]]
        show_table(
            nights,
            {
                "date": "Day",
                "scenes": "Scenes",
                "warned": "With warnings",
                "first": "First stored",
                "last": "Last stored",
                "seconds_total": "Seconds per scene (median)",
            },
            desk.habits,
            key="nights",
            mode="none",
            height=400,
        )
    with right:
        st.markdown("**Seconds per step**, median of each day")
        st.plotly_chart(seconds_figure(nights, desk.habits), key="seconds", config={"displaylogo": False})


def _rigs(desk: Desk, selection: Selection) -> None:
    condition, parameters = selection.where()
    days = desk.archive.rows(
        "SELECT rig_id, date_trunc('day', captured_at) AS day, count(*) AS scenes, "
        "median(epipolar_rms_px) AS epipolar, "
        "max(epipolar_rms_px) AS epipolar_worst, median(sigma_z_median_mm) AS sigma, median(valid_fraction) AS valid "
        f"FROM scenes WHERE {condition} GROUP BY ALL ORDER BY 2, 1",
        parameters,
    )
    if days.empty:
        st.info("No scene was scanned in that time.")
        return
    st.plotly_chart(rig_figure(days, desk.habits), key="rigs", config={"displaylogo": False})
    st.caption(
        "Rig fit: how far features seen by both cameras lie from their epipolar lines (median of a day). A slow rise "
        "is drift, a jump is a knock: calibrate again. Noise: standard deviation of a point's depth."
    )
    latest = days.groupby("rig_id", as_index=False).last()
    show_table(
        latest.rename(columns={"epipolar": "epipolar_px", "sigma": "sigma_mm", "valid": "valid_fraction"}),
        {
            "rig_id": "Rig calibration",
            "day": "Last used",
            "scenes": "Scenes that day",
            "epipolar_px": "Rig fit, px",
            "sigma_mm": "Noise, mm",
            "valid_fraction": "Share of pixels with a point",
        },
        desk.habits,
        key="rig-table",
        mode="none",
        height=180,
    )


def _failures(desk: Desk, selection: Selection) -> None:
    condition, parameters = selection.where()
    warned = desk.archive.rows(
        "SELECT aircraft_serial, panel, station, captured_at, scene_id, rig_id, "
        f"array_to_string(warnings, '; ') AS reason, status FROM scenes "
        f"WHERE status <> 'ok' AND {condition} ORDER BY captured_at DESC LIMIT 500",
        parameters,
    )
    st.markdown("**Inspected with warnings** · select one to open it")
    if warned.empty:
        st.success("No inspection in that time had a warning.", icon=":material/check:")
    else:
        picked = show_table(
            warned,
            {
                "aircraft_serial": "Aircraft",
                "panel": "Panel",
                "station": "Station",
                "captured_at": "Scanned",
                "rig_id": "Rig",
                "reason": "Warning",
            },
            desk.habits,
            key="warned",
            height=240,
        )
        if picked:
            go("scene", scene=str(warned["scene_id"].iloc[picked[0]]))
    st.markdown("**Could not be inspected**")
    failed = failed_scenes(desk)
    if failed.empty:
        st.caption("No scene waits in a quarantine folder of this store.")
        return
    show_table(failed, {"scene": "Scene folder", "at": "When", "reason": "Why"}, desk.habits, key="failed", mode="none")


def failed_scenes(desk: Desk) -> pd.DataFrame:
    """What the flows set aside, newest first."""
    rows = []
    for note in sorted((desk.archive.root / "quarantine").glob("*/reason.txt")):
        try:
            text, at = note.read_text(encoding="utf-8", errors="replace"), note.stat().st_mtime
        except OSError:
            continue
        rows.append((note.parent.name, pd.Timestamp(at, unit="s", tz="UTC"), plain_line(text)))
    frame = pd.DataFrame(rows, columns=["scene", "at", "reason"])
    return frame.sort_values("at", ascending=False) if len(frame) else frame


def plain_line(text: str) -> str:
    """Text on one line."""
    return " ".join(text.split())[:500]

"""Overview: aircraft × panels, when they were last scanned, how they stand, and what waits for a person."""

from __future__ import annotations

import pandas as pd
import streamlit as st

from dashboard.figures.overview import decision_bar, panel_matrix
from dashboard.filters import newest_scan, scene_filters
from dashboard.findings import STATION_ID, Selection
from dashboard.frame import Desk, go, link, plain
from dashboard.habits import Habits
from dashboard.palette import DECISION_MARKS, DECISION_SIGNS, OPEN_DECISIONS
from dashboard.tables import show_table

TITLE = "Overview"
_MOST_ROWS = 200


def render(desk: Desk) -> None:
    """Show the page."""
    selection = scene_filters(desk.archive)
    panels = panel_states(desk, selection)
    if panels.empty:
        st.info("No scan matches these filters. Clear one of them to see more.")
        return
    _totals(desk, panels)
    problem = desk.archive.review().problem
    if problem:
        st.warning(f"The review log needs attention: {plain(problem)}", icon=":material/warning:")
    left, right = st.columns([6, 5])
    with left:
        _waiting(desk, panels, selection)
    with right:
        _matrix(desk.habits, panels)


def panel_states(desk: Desk, selection: Selection) -> pd.DataFrame:
    """One row per panel of each aircraft, from the newest scan of each station; the most work first."""
    condition, parameters = selection.where()
    sql = f"""
WITH s AS (
    SELECT scene_id, aircraft_serial, panel, captured_at, n_rivets, n_stations, status
    FROM latest_scenes WHERE {condition}
), bad AS (
    SELECT scene_id, 'rivet' AS feature_kind, rivet_id AS feature_id, decision, abs(height_mean_mm) AS off_mm
    FROM rivets WHERE decision NOT IN ('pass', 'no limit')
    UNION ALL
    SELECT scene_id, 'seam station', {STATION_ID}, decision, abs(step_mm)
    FROM seam_stations WHERE decision NOT IN ('pass', 'no limit')
), per_scene AS (
    SELECT scene_id,
        count(*) FILTER (decision = 'fail') AS fail,
        count(*) FILTER (decision = 'conditional fail') AS conditional_fail,
        count(*) FILTER (decision = 'not measured') AS not_measured,
        count(*) FILTER (decision = 'conditional pass') AS conditional_pass,
        max(off_mm) AS worst_mm,
        count(*) FILTER (d.disposition IS NULL AND g.signed_by IS NULL) AS waiting
    FROM bad LEFT JOIN reviewed d USING (scene_id, feature_kind, feature_id) LEFT JOIN signed g USING (scene_id)
    GROUP BY scene_id
)
SELECT aircraft_serial, panel, coalesce(sum(waiting), 0)::BIGINT AS waiting,
    coalesce(sum(fail), 0)::BIGINT AS fail, coalesce(sum(conditional_fail), 0)::BIGINT AS conditional_fail,
    coalesce(sum(not_measured), 0)::BIGINT AS not_measured,
    coalesce(sum(conditional_pass), 0)::BIGINT AS conditional_pass,
    coalesce(sum(n_rivets), 0)::BIGINT + coalesce(sum(n_stations), 0)::BIGINT AS features,
    max(worst_mm) AS worst_mm, count(*) AS scenes, count(*) FILTER (status <> 'ok') AS with_warnings,
    max(captured_at) AS last_scan
FROM s LEFT JOIN per_scene USING (scene_id)
GROUP BY ALL ORDER BY waiting DESC, fail DESC, last_scan DESC, aircraft_serial, panel
"""
    return desk.archive.rows_with_review(sql, parameters)


def _totals(desk: Desk, panels: pd.DataFrame) -> None:
    habits = desk.habits
    boxes = st.columns([1.3, 0.7, 0.7, 0.7, 1.9, 3.4], vertical_alignment="center")
    boxes[0].metric(
        "Waiting for a person",
        habits.whole(panels["waiting"].sum()),
        help="Rivets and seam stations of the newest scans that do not simply pass, without a disposition, on scenes "
        "that are not signed off.",
    )
    boxes[1].metric("Aircraft", habits.whole(panels["aircraft_serial"].nunique()))
    boxes[2].metric("Panels", habits.whole(len(panels)), help="Panels counted on each aircraft.")
    boxes[3].metric("Scans", habits.whole(panels["scenes"].sum()), help="The newest scan of each station.")
    boxes[4].metric("Last scan", habits.time(newest_scan(desk.archive)))
    with boxes[5]:
        counts = _counts(panels)
        st.html(decision_bar(counts, habits))
        said = " · ".join(f"{DECISION_MARKS[name]} {habits.whole(count)}" for name, count in counts.items())
        st.markdown(f":small[{said}]")


def _counts(panels: pd.DataFrame) -> dict[str, int]:
    counts: dict[str, int] = {decision: int(panels[decision.replace(" ", "_")].sum()) for decision in OPEN_DECISIONS}
    return {**counts, "pass": max(0, int(panels["features"].sum()) - sum(counts.values()))}


def _waiting(desk: Desk, panels: pd.DataFrame, selection: Selection) -> None:
    shown = panels.head(_MOST_ROWS)
    more = len(panels) - len(shown)
    st.markdown(
        "**Where work waits** · select a row to review that panel"
        + (f" · {desk.habits.whole(len(shown))} of {desk.habits.whole(len(panels))} panels" if more else "")
    )
    picked = show_table(
        shown,
        {
            "aircraft_serial": "Aircraft",
            "panel": "Panel",
            "waiting": "Waiting",
            "fail": f"{DECISION_SIGNS['fail']} Fail",
            "conditional_fail": f"{DECISION_SIGNS['conditional fail']} Cond. fail",
            "not_measured": "? Not measured",
            "worst_mm": "Worst, mm",
            "last_scan": "Last scan",
        },
        desk.habits,
        key="panels",
        height=430,
    )
    if picked:
        row = shown.iloc[picked[0]]
        go("review", aircraft=str(row["aircraft_serial"]), panel=str(row["panel"]))
    if panels["waiting"].sum() == 0:
        st.success("Nothing waits: every finding of these panels has a disposition.", icon=":material/check:")
    elif not selection.aircraft and not selection.panels:
        link("review", "Review what waits, the worst first", icon=":material/fact_check:")


def _matrix(habits: Habits, panels: pd.DataFrame) -> None:
    aircraft = panels.groupby("aircraft_serial")["last_scan"].max().sort_values(ascending=False)
    fig, shown = panel_matrix(panels, list(aircraft.index), habits)
    note = f" · the newest {shown} of {len(aircraft)} aircraft" if shown < len(aircraft) else ""
    st.markdown(f"**Aircraft × panels** · findings waiting, click to review{note}")
    event = st.plotly_chart(
        fig, key="matrix", on_select="rerun", selection_mode="points", config={"displayModeBar": False}
    )
    points = event["selection"]["points"] if event else []
    if points and points[0].get("customdata"):
        aircraft_serial, panel = points[0]["customdata"][:2]
        go("review", aircraft=str(aircraft_serial), panel=str(panel))

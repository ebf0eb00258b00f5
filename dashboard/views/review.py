"""Tolerance review: everything that does not simply pass, why, and what shall happen with it."""

from __future__ import annotations

from typing import Any

import pandas as pd
import streamlit as st

from dashboard.filters import scene_filters
from dashboard.findings import (
    STATES,
    Selection,
    Wanted,
    feature_from_parameter,
    feature_of,
    feature_parameter,
    findings,
)
from dashboard.frame import Desk, plain
from dashboard.palette import OPEN_DECISIONS
from dashboard.pictures import around, load_picture
from dashboard.review_report import csv_report, html_report
from dashboard.scenes import find_feature, load_features, load_scene_row
from dashboard.tables import show_table
from dashboard.views.scene import close_up
from metrology.errors import FlushlineError
from storage.archive.sign_off import sign_off
from storage.review import DISPOSITIONS, MAX_COMMENT, Disposition, Feature, FeatureKind, ReviewLog

TITLE = "Tolerance review"
_KINDS: tuple[FeatureKind, ...] = ("rivet", "seam station")
_CROP_PX = 90
_COLUMNS = {
    "aircraft_serial": "Aircraft",
    "panel": "Panel",
    "station": "Station",
    "feature_id": "Feature",
    "value_mm": "Value, mm",
    "u95_mm": "± U95",
    "decision": "Verdict",
    "disposition": "Disposition",
    "captured_at": "Scanned",
    "reason": "Why",
}


def render(desk: Desk) -> None:
    """Show the page."""
    wanted = _filters(desk)
    rows = findings(desk.archive, wanted)
    if rows.empty:
        _nothing(desk, wanted)
        return
    total = int(rows["total"].iloc[0])
    at = _place(rows)
    left, right = st.columns([13, 9])
    with left:
        _exports(desk, rows, total)
        # The key names the rows: a new list starts with a new selection.
        picked = show_table(
            rows,
            {name: title for name, title in _COLUMNS.items() if wanted.state != "open" or name != "disposition"},
            desk.habits,
            key=f"findings-{st.session_state.get('findings_turn', 0)}-{_name_of(rows)}",
            height=470,
            mode="multi-row",
            selected=at,
        )
    chosen = [row for row in picked if row < len(rows)] or [at]
    with right:
        _detail(desk, rows, chosen)


def _name_of(rows: pd.DataFrame) -> int:
    return hash(tuple(rows["scene_id"] + rows["feature_id"]))


def _filters(desk: Desk) -> Wanted:
    selection = scene_filters(desk.archive)
    first, second, third = st.columns([3, 2, 1.4])
    decisions = first.pills(
        "Verdict",
        OPEN_DECISIONS,
        selection_mode="multi",
        default=OPEN_DECISIONS,
        key="verdict",
        bind="query-params",
    )
    kinds = second.pills(
        "What",
        _KINDS,
        selection_mode="multi",
        default=list(_KINDS),
        key="kind",
        bind="query-params",
    )
    state = third.selectbox("State", STATES, key="state", bind="query-params")
    return Wanted(tuple(decisions), tuple(kinds), state, selection)


def _nothing(desk: Desk, wanted: Wanted) -> None:
    if wanted.state == "open" and wanted.decisions and wanted.kinds:
        st.success("Nothing waits here: no open finding matches these filters.", icon=":material/check:")
    else:
        st.info("Nothing matches these filters. Choose at least one verdict and one kind of feature.")
    _sign_off_of_scene(desk)


def _place(rows: pd.DataFrame) -> int:
    """Where the list stands: at the feature that the URL names, else at the top."""
    scene, feature = st.query_params.get("scene"), feature_from_parameter(st.query_params.get("feature"))
    if scene:
        matches = rows["scene_id"] == scene
        if feature is not None:
            both = matches & (rows["feature_kind"] == feature.kind) & (rows["feature_id"] == feature.id)
            matches = both if both.any() else matches
        if matches.any():
            return int(matches.to_numpy().argmax())
    return min(int(st.session_state.get("place", 0)), len(rows) - 1) if not scene else 0


def _exports(desk: Desk, rows: pd.DataFrame, total: int) -> None:
    shown = f"the gravest {desk.habits.whole(len(rows))} of " if total > len(rows) else ""
    with st.container(horizontal=True, vertical_alignment="center"):
        st.caption(f"{shown}{desk.habits.whole(total)} findings · tick several of a list to dispose of them at once")
        with st.popover("Export", icon=":material/download:"):
            st.caption("The findings of this list, with their dispositions.")
            st.download_button(
                "CSV", lambda: csv_report(rows, desk.habits), "review.csv", "text/csv", on_click="ignore", key="csv"
            )
            st.download_button(
                "HTML report",
                lambda: html_report(rows, desk.archive, desk.habits, desk.settings.title),
                "review.html",
                "text/html",
                on_click="ignore",
                key="html",
            )


def _detail(desk: Desk, rows: pd.DataFrame, chosen: list[int]) -> None:
    first = rows.iloc[chosen[0]]
    scene = load_scene_row(desk.archive, str(first["scene_id"]))
    if scene is None:
        st.info("This scan is not in the store any more; choose another finding.")
        return
    features = load_features(desk.archive, scene)
    feature = feature_of(first)
    with st.container(border=True):
        with st.container(horizontal=True, vertical_alignment="center", gap="small"):
            _steps(rows, chosen[0])
            st.caption(
                f"{plain(scene.aircraft_serial)} · {plain(scene.panel)} · {plain(scene.station)} · "
                f"{desk.habits.time(scene.captured_at)}"
            )
        words, picture = st.columns([4, 1])
        with words:
            close_up(desk, scene, features, feature, compact=True)
        with picture:
            _crop(desk, scene, find_feature(features, feature))
        _history(desk, scene.scene_id, feature)
    _decide(desk, rows, chosen, scene)


def _crop(desk: Desk, scene: Any, measured: Any) -> None:
    try:
        picture = load_picture(desk.archive.file(scene.preview_path))
    except FlushlineError:
        return
    if measured is None or measured.u_px != measured.u_px:
        return
    reach = _CROP_PX * picture.shape[1] / 1624
    st.image(around(picture, float(measured.u_px), float(measured.v_px), max(20.0, reach)), width="stretch")


def _steps(rows: pd.DataFrame, at: int) -> None:
    """Buttons to go through the list, with keys."""
    back = st.button("↑", shortcut="k", disabled=at == 0, help="Previous finding", key="previous")
    ahead = st.button("↓", shortcut="j", disabled=at >= len(rows) - 1, help="Next finding", key="next")
    if back or ahead:
        _stand_at(rows, at + (1 if ahead else -1))


def _stand_at(rows: pd.DataFrame, at: int) -> None:
    row = rows.iloc[at]
    st.query_params["scene"] = str(row["scene_id"])
    st.query_params["feature"] = feature_parameter(Feature(row["feature_kind"], str(row["feature_id"])))
    st.session_state["place"] = at
    st.session_state["findings_turn"] = st.session_state.get("findings_turn", 0) + 1
    st.rerun()


def _decide(desk: Desk, rows: pd.DataFrame, chosen: list[int], scene: Any) -> None:
    """The form that disposes of the chosen findings, and signs the scene off."""
    review = desk.archive.review()
    if review.problem:
        st.error(plain(review.problem), icon=":material/error:")
        return
    signed = review.sign_offs().get(scene.scene_id)
    if signed:
        st.info(
            f"Signed off by {plain(signed.who)}, {desk.habits.time(signed.at)}: this scan is locked.",
            icon=":material/lock:",
        )
        return
    if not desk.person.may_review:
        st.caption("You may look; disposing and signing off needs the role reviewer.")
        return
    with st.form("decide", clear_on_submit=False, border=True):
        disposition = st.pills("Disposition", DISPOSITIONS, key="disposition")
        left, right = st.columns([5, 3])
        with left:
            comment = st.text_input("Comment", key="comment", max_chars=MAX_COMMENT, placeholder="what and why")
        with right:
            who = _who(desk)
        count = f" ({len(chosen)} findings)" if len(chosen) > 1 else ""
        if st.form_submit_button(f"Record{count}", type="primary", icon=":material/edit_note:"):
            _record(desk, rows.iloc[chosen], disposition, comment, who)
    _sign_off(desk, scene)


def _who(desk: Desk) -> str:
    if desk.person.verified:
        return desk.person.name
    return str(
        st.text_input(
            "Your name", key="who", max_chars=120, help="Nobody logs in here, so the log keeps the name you give."
        )
        or ""
    )


def _record(desk: Desk, chosen: pd.DataFrame, disposition: Disposition | None, comment: str, who: str) -> None:
    if not disposition or not who.strip():
        st.warning("Choose a disposition and give your name.")
        return
    log = ReviewLog(desk.archive.root)
    done = 0
    try:
        for (scene_id, run_id), part in chosen.groupby(["scene_id", "run_id"], sort=False):
            found = [feature_of(row) for row in part.itertuples()]
            shown = {f: _shown(row) for f, row in zip(found, part.to_dict("records"), strict=True)}
            log.dispose(who, str(scene_id), str(run_id), found, disposition, comment, shown)
            done += len(found)
    except FlushlineError as problem:
        st.error(plain(problem))
        return
    st.toast(f"Recorded: {disposition}, findings: {done}", icon=":material/check:")
    for name in ("scene", "feature"):
        st.query_params.pop(name, None)
    st.session_state["findings_turn"] = st.session_state.get("findings_turn", 0) + 1
    st.rerun()


def _shown(row: dict[str, Any]) -> dict[str, Any]:
    """What the person had before them."""
    names = (
        "value_mm",
        "u95_mm",
        "tilt_deg",
        "width_mm",
        "severity",
        "decision",
        "reason",
        "panel_spec",
        "software_version",
    )
    return {name: None if pd.isna(row[name]) else row[name] for name in names}


def _sign_off(desk: Desk, scene: Any) -> None:
    waiting = _waiting(desk, scene)
    with st.popover("Sign this scan off", icon=":material/lock:", disabled=waiting > 0):
        st.caption("Its dispositions can not be changed afterwards.")
        who = desk.person.name if desk.person.verified else str(st.session_state.get("who") or "")
        st.markdown(f"Signs: **{plain(who) or 'give your name in the form first'}**")
        if st.button("Sign off", type="primary", disabled=not who.strip()):
            shown = {
                "n_rivets": int(scene.n_rivets),
                "n_stations": int(scene.n_stations),
                "panel_spec": str(scene.panel_spec),
                "software_version": str(scene.software_version),
            }
            try:
                sign_off(desk.archive.root, who, scene.scene_id, scene.run_id, "", shown)
            except FlushlineError as problem:
                st.error(plain(problem))
            else:
                st.rerun()
    if waiting:
        verb = "finding of this scan still needs" if waiting == 1 else "findings of this scan still need"
        st.caption(f"{desk.habits.whole(waiting)} {verb} a disposition before it can be signed off.")


def _waiting(desk: Desk, scene: Any) -> int:
    moment = scene.captured_at.to_pydatetime()
    selection = Selection((scene.aircraft_serial,), (scene.panel,), (scene.station,), since=moment, until=moment)
    rows = findings(desk.archive, Wanted(selection=selection), most=1)
    return int(rows["total"].iloc[0]) if len(rows) else 0


def _sign_off_of_scene(desk: Desk) -> None:
    """Where the last finding of the URL's scan was disposed of: offer to sign it off."""
    scene = load_scene_row(desk.archive, str(st.query_params.get("scene") or ""))
    if scene is None or scene.scene_id in desk.archive.review().sign_offs() or not desk.person.may_review:
        return
    st.markdown(f"{plain(scene.aircraft_serial)} · {plain(scene.panel)} · {plain(scene.station)}")
    _who(desk)
    _sign_off(desk, scene)


def _history(desk: Desk, scene_id: str, feature: Feature) -> None:
    """What was decided about this feature so far."""
    entries = [
        entry
        for entry in desk.archive.review().entries
        if entry.scene_id == scene_id
        and (entry.action == "sign-off" or (entry.feature_kind, entry.feature_id) == (feature.kind, feature.id))
    ]
    for entry in entries[-4:]:
        what = entry.disposition or "signed off"
        comment = f" · {plain(entry.comment)}" if entry.comment else ""
        st.markdown(f":small[{desk.habits.time(entry.at)} **{what}** by {plain(entry.who)}{comment}]")

"""Archive: find scans, look at their pictures, open one or compare several."""

from __future__ import annotations

from functools import partial
from typing import Any

import pandas as pd
import streamlit as st

from dashboard.address import one_of
from dashboard.data import Archive
from dashboard.filters import scene_filters
from dashboard.findings import Selection
from dashboard.frame import PageContext, go
from dashboard.locale import NOTHING
from dashboard.palette import DECISION_SIGNS
from dashboard.pictures import data_uri, load_picture, shrunk
from dashboard.room import room
from dashboard.views.comparison import MOST_COMPARED, compare
from dashboard.words import N_, _
from metrology.errors import FlushlineError
from metrology.kinds import KINDS
from storage.archive.views import OUTSIDE_SQL, TAKEN_AT
from storage.archive.work import ATTENTION

TITLE = N_("Archive")
_PAGE = 20
_THUMBNAIL_PX = 132
_HEAD_PX, _ROW_PX = 38, 76
_ANY = N_("any verdict")
VERDICTS = {
    _ANY: "true",
    N_("with fails"): "fail > 0",
    N_("needs attention"): "bad > 0",
    N_("with unmeasured"): "not_measured > 0",
    N_("all pass"): "bad = 0 AND rig_verdict IS DISTINCT FROM 'unjudged'",
    N_("rig unjudged"): "rig_verdict = 'unjudged'",
}


def render(context: PageContext) -> None:
    """Show the page."""
    compared = [part for part in str(st.query_params.get("compare", "")).split(",") if part][:MOST_COMPARED]
    if len(compared) > 1:
        compare(context, list(dict.fromkeys(compared)))
        return
    selection = scene_filters(context.archive, more=True)
    verdict_field, page_field, actions = st.columns([2, 1, 5], vertical_alignment="bottom")
    verdict = verdict_field.selectbox(_("Verdict"), list(VERDICTS), format_func=_, **one_of("verdict", list(VERDICTS)))
    total = _count(context.archive, selection, verdict)
    pages = max(1, -(-total // _PAGE))
    page = page_field.number_input(_("Page"), 1, pages, key="page")
    scenes = _scenes(context.archive, selection, verdict, _PAGE, (int(page) - 1) * _PAGE)
    if scenes.empty:
        st.info(_("No scan matches these filters. Clear one of them to see more."))
        return
    with actions:
        buttons = st.container(horizontal=True, vertical_alignment="center")
    chosen = _list(context, scenes)
    with buttons:
        _way(_("Open"), ":material/center_focus_strong:", len(chosen) == 1, "scene", scene=",".join(chosen))
        _way(_("Compare"), ":material/compare:", 1 < len(chosen) <= MOST_COMPARED, "archive", compare=",".join(chosen))
        st.caption(
            _(
                "{total} scans, page {page} of {pages}. Tick one scan to open it, two to {most} to compare them.",
                total=context.locale.whole(total),
                page=page,
                pages=context.locale.whole(pages),
                most=MOST_COMPARED,
            )
        )


def _way(title: str, icon: str, possible: bool, page: str, **parameters: str) -> None:
    """A button to a page with what was ticked when it was drawn."""
    st.button(
        title,
        type="primary" if page == "scene" else "secondary",
        disabled=not possible,
        icon=icon,
        key=f"{title} {parameters}",
        on_click=partial(go, page, **parameters),
    )


def _found_sql(among: str) -> str:
    """Of scans, how many features and stretches of seams need attention; a stretch counts by its gravest verdict."""
    parts = [
        f"SELECT scene_id, bool_or({OUTSIDE_SQL}) AS outside, bool_or(decision = 'not measured') AS unknown "
        f"FROM {kind.table} WHERE {ATTENTION} AND {among} "
        f"GROUP BY scene_id, {f'coalesce(stretch, {kind.id_sql})' if kind.is_course else kind.id_sql}"
        for kind in KINDS
    ]
    return (
        "SELECT scene_id, count(*) FILTER (outside) AS fail, count(*) FILTER (unknown AND NOT outside) "
        f"AS not_measured, count(*) AS bad FROM ({' UNION ALL '.join(parts)}) GROUP BY scene_id"
    )


def _listed(selection: Selection, verdict: str) -> tuple[str, list[object]]:
    condition, parameters = selection.where()
    among = f"(FROM scenes WHERE {condition})"
    if verdict == _ANY:
        return f"FROM (SELECT scene_id, {TAKEN_AT} AS taken_at FROM {among})", parameters
    sql = (
        f"FROM (SELECT s.scene_id, s.rig_verdict, {TAKEN_AT} AS taken_at, coalesce(fail, 0) AS fail, "
        f"coalesce(not_measured, 0) AS not_measured, coalesce(bad, 0) AS bad FROM {among} s "
        f"LEFT JOIN ({_found_sql('true')}) USING (scene_id)) WHERE {VERDICTS.get(verdict, 'true')}"
    )
    return sql, parameters


def _count(archive: Archive, selection: Selection, verdict: str) -> int:
    sql, parameters = _listed(selection, verdict)
    return int(archive.rows(f"SELECT count(*) AS n {sql}", parameters)["n"][0])


def _scenes(archive: Archive, selection: Selection, verdict: str, most: int, skip: int) -> pd.DataFrame:
    sql, parameters = _listed(selection, verdict)
    found = _found_sql("scene_id IN (SELECT scene_id FROM page)")
    return archive.rows(
        f"WITH page AS MATERIALIZED (SELECT scene_id, taken_at {sql} ORDER BY taken_at DESC, scene_id "
        f"LIMIT {most} OFFSET {skip}) "
        "SELECT s.scene_id, aircraft_serial, panel, station, captured_at, coalesce(fail, 0) AS fail, "
        "coalesce(not_measured, 0) AS not_measured, n_rivets, n_seams, "
        "rig_id, rig_verdict, status, software_version, preview_path FROM page JOIN scenes s USING (scene_id) "
        f"LEFT JOIN ({found}) USING (scene_id) ORDER BY taken_at DESC, s.scene_id",
        parameters,
    )


def _list(context: PageContext, scenes: pd.DataFrame) -> list[str]:
    """The scans; returns the names of those that are ticked."""
    names = [str(name) for name in scenes["scene_id"]]
    shown = scenes.copy()
    shown.insert(0, "picture", [_thumbnail_of(context.archive, path) for path in scenes["preview_path"]])
    shown["captured_at"] = [context.locale.time(moment) for moment in scenes["captured_at"]]
    for name in ("rig_verdict", "status"):
        shown[name] = [word if pd.isna(word) else _(str(word)) for word in scenes[name]]
    shown = shown.drop(columns=["scene_id", "preview_path"])
    whole = _HEAD_PX + _ROW_PX * len(names)
    with room("scenes", min(480, whole), whole, above=288):
        event = st.dataframe(
            shown,
            hide_index=True,
            row_height=_ROW_PX,
            height="stretch",
            key=f"scenes-{hash(tuple(names))}",  # other rows begin without ticks
            on_select="rerun",
            selection_mode="multi-row",
            placeholder=NOTHING,
            column_config=_layout(),
        )
    return [names[row] for row in event["selection"]["rows"] if row < len(names)]


def _layout() -> dict[str, Any]:
    """Headings of the columns, with what needs words beside them."""
    return {
        "picture": st.column_config.ImageColumn(_("Picture"), width="small"),
        "aircraft_serial": _("Aircraft"),
        "panel": _("Panel"),
        "station": _("Station"),
        "captured_at": _("Scanned"),
        "fail": st.column_config.Column(
            DECISION_SIGNS["fail"] + " " + _("Fail"),
            help=_("Rivets, stretches of seams and the like outside their limits"),
        ),
        "not_measured": "? " + _("Not measured"),
        "n_rivets": _("Rivets"),
        "n_seams": _("Seams"),
        "rig_id": _("Rig"),
        "rig_verdict": st.column_config.Column(
            _("Rig check"),
            help=_("Whether the rig fits the scan; unjudged: the scan cannot tell; –: of an older version"),
        ),
        "status": _("Status"),
        "software_version": _("Version"),
    }


def _thumbnail_of(archive: Archive, path: object) -> str | None:
    try:
        return _thumbnail(str(archive.file(path)))
    except FlushlineError:
        return None


@st.cache_data(max_entries=2000, show_spinner=False)
def _thumbnail(path: str) -> str:
    from pathlib import Path

    return data_uri(shrunk(load_picture(Path(path)), _THUMBNAIL_PX))

"""What is new: what changed on the scans since a person looked before, and what needs somebody this morning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

import pandas as pd
import streamlit as st
from streamlit.delta_generator import DeltaGenerator

from dashboard.address import one_of
from dashboard.filters import newest_scan
from dashboard.findings import LAST_NIGHT, OPEN_WORK, PERIODS, Selection, Wanted, feature_parameter, findings, start_of
from dashboard.frame import PageContext, go, link
from dashboard.looks import Looks
from dashboard.news import Since, changes, drifts, due_rigs, new_scans, not_inspected
from dashboard.tables import show_table
from metrology.kinds import BY_NAME
from storage.archive.changes import CURED, NEW, WORSE
from storage.review import Feature

MY_LOOK = "I looked before"
_DRIFTING, _REWORK, _DUE, _ASIDE = "drifting", "open work", "rigs due", "not inspected"
_HELP = {
    NEW: "Features and stretches of seams that do not simply pass, and passed before or were not scanned before",
    WORSE: "They did not pass before either; now they are judged more gravely, or are off by more than the uncertainty",
    CURED: "They did not pass on the scan before, and do now",
    _DRIFTING: "Places whose value moves from aircraft to aircraft by more than chance allows",
    _REWORK: "Rework, repair or re-scan was asked for and is not done",
    _DUE: "Calibrations and verifications of rigs in use that are due within a week, or overdue",
    _ASIDE: "Scans put aside, and scans whose rig could not be judged",
}
_MOST = 300


@dataclass(frozen=True)
class _News:
    """Each list of the page by its name, and how many scans and panels they are about."""

    lists: dict[str, pd.DataFrame]
    scans: pd.DataFrame


def what_is_new(context: PageContext, beside: DeltaGenerator) -> None:
    """Counts of everything that needs somebody, and the list of what is chosen.

    Parameters
    ----------
    beside : DeltaGenerator
        Where it is chosen since when.
    """
    with beside:
        since, moment = _since(context)
    news = _gather(context, since, moment)
    lists = news.lists
    options = list(lists)
    first = next((name for name in options if len(lists[name])), options[0])
    chosen = st.segmented_control(
        "List", options, format_func=lambda name: f"{name.capitalize()} **{context.locale.whole(len(lists[name]))}**",
        label_visibility="collapsed", **one_of("list", options, first),
    )  # fmt: skip
    name = str(chosen or first)
    panels = news.scans.groupby(["aircraft_serial", "panel"]).ngroups
    st.caption(
        f"New scans: {context.locale.whole(len(news.scans))}, panels: {context.locale.whole(panels)} · {_HELP[name]}"
    )
    left, right = st.columns([13, 8])
    with left:
        _show(context, name, lists[name])
    with right:
        _panels(context, news)


def _since(context: PageContext) -> tuple[Since, datetime | None]:
    """What counts as new, and from which moment on."""
    now = datetime.now(UTC)
    looked = Looks(context.archive.root).look(context.person.name, now)
    options = (
        [MY_LOOK, *(name for name, span in PERIODS.items() if span)]
        if looked
        else [name for name, span in PERIODS.items() if span]
    )
    words = {MY_LOOK: f"{MY_LOOK} ({context.locale.time(looked)})"}
    chosen = st.selectbox(
        "New since", options, format_func=lambda name: f"New since {words.get(name, name)}",
        label_visibility="collapsed",
        **one_of("since", options, MY_LOOK if looked else LAST_NIGHT),
    )  # fmt: skip
    without = context.settings.not_aircraft
    if chosen == MY_LOOK and looked:
        return Since(looked, Selection(without=without)), looked
    start = start_of(str(chosen), newest_scan(context.archive))
    return Since(None, Selection(since=start, without=without)), start


def _gather(context: PageContext, since: Since, moment: datetime | None) -> _News:
    archive = context.archive
    found, scans = changes(archive, since), new_scans(archive, since)
    work = findings(archive, Wanted(state=OPEN_WORK, selection=Selection(without=context.settings.not_aircraft)))
    lists = {name: found[found["change"] == name].reset_index(drop=True) for name in (NEW, WORSE)}
    lists[_DRIFTING] = drifts(archive, since)
    lists[CURED] = found[found["change"] == CURED].reset_index(drop=True)
    lists[_REWORK] = work
    lists[_DUE] = due_rigs(archive, datetime.now(UTC))
    lists[_ASIDE] = not_inspected(context.settings.inboxes, scans, moment)
    return _News(lists, scans)


def _show(context: PageContext, name: str, rows: pd.DataFrame) -> None:
    if rows.empty:
        st.success(f"Nothing is {name}." if name not in (_REWORK, _DUE, _ASIDE) else f"No {name}: nothing to do here.",
                   icon=":material/check:")  # fmt: skip
        if name == _ASIDE and not context.settings.inboxes:
            st.caption("Name the inboxes in the settings (`inboxes = [...]`) to see what their quarantine holds.")
        return
    _SHOWN[name](context, name, rows.head(_MOST))


def _changed(context: PageContext, name: str, rows: pd.DataFrame) -> None:
    shown = rows.assign(place=[_place(context, row) for row in rows.itertuples()])
    columns = {
        "aircraft_serial": "Aircraft", "panel": "Panel", "station": "Station", "place": "Feature",
        "value_mm": "Value, mm", "before_mm": "Before, mm", "decision": "Verdict", "reason": "Why",
    }  # fmt: skip
    if name == CURED:
        columns.pop("decision")
        columns.pop("reason")
    names = [(str(row.scene_id), _address(row)) for row in rows.itertuples()]
    show_table(shown, columns, context.locale, f"news-{name}", 430, names, _open)
    st.caption("Select one for its picture.")


def _place(context: PageContext, row: object) -> str:
    """A feature's name, or a stretch of a course with its ends."""
    if not BY_NAME[row.feature_kind].is_course:  # type: ignore[attr-defined]
        return str(row.feature_id)  # type: ignore[attr-defined]
    ends = (context.locale.number(end, 0) for end in (row.from_mm, row.to_mm))  # type: ignore[attr-defined]
    return f"{row.name} {'–'.join(ends)} mm"  # type: ignore[attr-defined]


def _address(row: object) -> str:
    return feature_parameter(Feature(row.feature_kind, str(row.feature_id)))  # type: ignore[attr-defined]


def _open(name: tuple[str, str]) -> None:
    go("scene", scene=name[0], feature=name[1])


def _drift(context: PageContext, name: str, rows: pd.DataFrame) -> None:
    columns = {
        "panel": "Panel", "station": "Station", "name": "Feature", "value_mm": "Newest, mm",
        "difference_mm": "Moves each scan by, mm", "n": "Scans",
    }  # fmt: skip
    names = [(BY_NAME[r.feature_kind].subject, r.panel, r.station, r.name) for r in rows.itertuples()]
    shown = rows.assign(difference_mm=rows["slope"])
    show_table(shown, columns, context.locale, "news-drifting", 430, names, _open_trend)
    st.caption("Select one for its chart over time.")


def _open_trend(name: tuple[str, str, str, str]) -> None:
    what, panel, station, feature = map(str, name)
    go("trends", what=what, panel=panel, station=station, name=feature)


def _work(context: PageContext, name: str, rows: pd.DataFrame) -> None:
    columns = {
        "aircraft_serial": "Aircraft", "panel": "Panel", "station": "Station", "feature_id": "Feature",
        "disposition": "Asked for", "who": "By", "decided_at": "When", "comment": "Comment",
    }  # fmt: skip
    names = [(str(row.scene_id), _address(row)) for row in rows.itertuples()]
    show_table(rows, columns, context.locale, "news-work", 430, names, _open)
    link("review", "Decide in the review", ":material/fact_check:", state=OPEN_WORK)


def _due(context: PageContext, name: str, rows: pd.DataFrame) -> None:
    shown = rows.assign(state=["overdue" if late else "due soon" for late in rows["late"]])
    columns = {"rig_id": "Rig", "what": "What", "due_at": "Due", "state": "State"}
    show_table(shown, columns, context.locale, "news-due", 430)
    link("runs", "How the rigs are", ":material/precision_manufacturing:", view="Rig health")


def _aside(context: PageContext, name: str, rows: pd.DataFrame) -> None:
    columns = {"at": "When", "scene": "Scan", "what": "What", "why": "Why"}
    names = [scene if isinstance(scene, str) else None for scene in rows["scene_id"]]
    show_table(rows, columns, context.locale, "news-aside", 430, names, _open_scan)


def _open_scan(scene: str | None) -> None:
    if scene:
        go("scene", scene=scene)


def _panels(context: PageContext, news: _News) -> None:
    """The panels that were scanned, those with most news first."""
    if news.scans.empty:
        return
    key = ["aircraft_serial", "panel"]
    panels = news.scans.groupby(key, as_index=False).agg(scenes=("scene_id", "count"), last_scan=("captured_at", "max"))
    for name in (NEW, WORSE, CURED):
        counted = news.lists[name].groupby(key, as_index=False).size().rename(columns={"size": name})
        panels = panels.merge(counted, on=key, how="left")
        panels[name] = panels[name].fillna(0).astype(int)
    panels = panels.sort_values([NEW, WORSE, "last_scan"], ascending=False).head(_MOST)
    columns = {"aircraft_serial": "Aircraft", "panel": "Panel", NEW: "New", WORSE: "Worse", CURED: "Cured",
               "scenes": "Scans", "last_scan": "Last scan"}  # fmt: skip
    names = list(zip(panels["aircraft_serial"].astype(str), panels["panel"].astype(str), strict=True))
    show_table(panels, columns, context.locale, "news-panels", 430, names, _open_panel)
    st.caption("The panels that were scanned; select one to see it whole.")


def _open_panel(name: tuple[str, str]) -> None:
    go("panel", aircraft=name[0], panel=name[1])


_SHOWN: dict[str, Callable[[PageContext, str, pd.DataFrame], None]] = {
    NEW: _changed, WORSE: _changed, CURED: _changed, _DRIFTING: _drift, _REWORK: _work, _DUE: _due, _ASIDE: _aside,
}  # fmt: skip

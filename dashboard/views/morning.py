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
from dashboard.margins import about_the_verdict, mixed, with_margins
from dashboard.news import Since, changes, drifts, due_rigs, new_scans, not_inspected
from dashboard.tables import show_table
from dashboard.words import N_, _
from metrology.kinds import BY_NAME
from storage.archive.changes import CURED, NEW, WORSE
from storage.review import Feature
from storage.wording import capital

MY_LOOK = N_("I looked before")
_DRIFTING, _REWORK, _DUE, _ASIDE = N_("drifting"), N_("open work"), N_("rigs due"), N_("not inspected")
_HELP = {
    NEW: N_("Features and stretches of seams that do not simply pass, and passed before or were not scanned before"),
    WORSE: N_(
        "They did not pass before either, and now have a graver verdict, or their height, step, gap or depth is "
        "farther off by more than the uncertainty"
    ),
    CURED: N_("They did not pass on the scan before, and do now"),
    _DRIFTING: N_("Places whose value moves from aircraft to aircraft by more than chance allows"),
    _REWORK: N_("Rework, repair or re-scan was decided and is not done yet"),
    _DUE: N_("Calibrations and verifications of rigs in use that are due within a week, or overdue"),
    _ASIDE: N_("Scans put aside, and scans whose rig could not be judged"),
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
        _("List"), options,
        format_func=lambda name: f"{capital(_(name))} **{context.locale.whole(len(lists[name]))}**",
        label_visibility="collapsed", **one_of("list", options, first),
    )  # fmt: skip
    name = str(chosen or first)
    panels = news.scans.groupby(["aircraft_serial", "panel"]).ngroups
    st.caption(
        _(
            "New scans: {scans}, panels: {panels}",
            scans=context.locale.whole(len(news.scans)),
            panels=context.locale.whole(panels),
        )
        + f" · {_(_HELP[name])}"
    )
    _show(context, name, lists[name])
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
    words = {name: _(name) for name in options}
    words[MY_LOOK] = f"{_(MY_LOOK)} ({context.locale.time(looked)})"
    chosen = st.selectbox(
        _("New since"), options, format_func=lambda name: _("New since {name}", name=words[name]),
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
        listed = name in (_REWORK, _DUE, _ASIDE)
        said = _("No {name}: nothing to do here.", name=_(name)) if listed else _("Nothing is {name}.", name=_(name))
        st.success(said, icon=":material/check:")
        if name == _ASIDE and not context.settings.inboxes:
            st.caption(_("Name the inboxes in the settings (`inboxes = [...]`) to see what their quarantine holds."))
        return
    _SHOWN[name](context, name, rows.head(_MOST))


def _changed(context: PageContext, name: str, rows: pd.DataFrame) -> None:
    columns = {
        "aircraft_serial": _("Aircraft"), "panel": _("Panel"), "station": _("Station"), "feature_id": _("Feature"),
        "quantity": _("Quantity"), "value_mm": _("Value, mm"), "before_mm": _("Before, mm"),
        "decision": _("Verdict"), "reason": _("Why"),
    }  # fmt: skip
    if name == CURED:
        del columns["quantity"], columns["decision"], columns["reason"]
    elif mixed(judged := with_margins(context.archive, rows)):
        columns["value_mm"] = _("Value")
        rows = _about_the_verdict(judged)
    else:
        del columns["quantity"]
    names = [(str(row.scene_id), _address(row)) for row in rows.itertuples()]
    show_table(rows, columns, context.locale, f"news-{name}", 400, names, _open, above=550)
    st.caption(_("Select one for its picture."))


def _about_the_verdict(rows: pd.DataFrame) -> pd.DataFrame:
    """With the value that each verdict is about; of what scans are not compared by there is none from before."""
    shown = about_the_verdict(rows)
    return shown.assign(before_mm=shown["before_mm"].where(shown["value_mm"] == rows["value_mm"]))


def _address(row: object) -> str:
    return feature_parameter(Feature(row.feature_kind, str(row.feature_id)))  # type: ignore[attr-defined]


def _open(name: tuple[str, str]) -> None:
    go("scene", scene=name[0], feature=name[1])


def _drift(context: PageContext, name: str, rows: pd.DataFrame) -> None:
    columns = {
        "panel": _("Panel"), "station": _("Station"), "name": _("Feature"), "value_mm": _("Newest, mm"),
        "difference_mm": _("Moves each scan by, mm"), "n": _("Scans"),
    }  # fmt: skip
    names = [(BY_NAME[r.feature_kind].subject, r.panel, r.station, r.name) for r in rows.itertuples()]
    shown = rows.assign(difference_mm=rows["slope"])
    show_table(shown, columns, context.locale, "news-drifting", 400, names, _open_trend, above=550)
    st.caption(_("Select one for its chart over time."))


def _open_trend(name: tuple[str, str, str, str]) -> None:
    what, panel, station, feature = map(str, name)
    go("trends", what=what, panel=panel, station=station, name=feature)


def _work(context: PageContext, name: str, rows: pd.DataFrame) -> None:
    columns = {
        "aircraft_serial": _("Aircraft"), "panel": _("Panel"), "station": _("Station"), "feature_id": _("Feature"),
        "disposition": _("Decided"), "who": _("By"), "decided_at": _("When"), "comment": _("Comment"),
    }  # fmt: skip
    names = [(str(row.scene_id), _address(row)) for row in rows.itertuples()]
    show_table(rows, columns, context.locale, "news-work", 400, names, _open, above=550)
    link("review", _("Decide in the review"), ":material/fact_check:", state=OPEN_WORK)


def _due(context: PageContext, name: str, rows: pd.DataFrame) -> None:
    shown = rows.assign(state=[N_("overdue") if late else N_("due soon") for late in rows["late"]])
    columns = {"rig_id": _("Rig"), "what": _("What"), "due_at": _("Due"), "state": _("State")}
    show_table(shown, columns, context.locale, "news-due", 400)
    link("runs", _("How the rigs are"), ":material/precision_manufacturing:", view="Rig health")


def _aside(context: PageContext, name: str, rows: pd.DataFrame) -> None:
    columns = {"at": _("When"), "scene": _("Scan"), "what": _("What"), "why": _("Why")}
    names = [scene if isinstance(scene, str) else None for scene in rows["scene_id"]]
    show_table(rows, columns, context.locale, "news-aside", 400, names, _open_scan, above=550)


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
    columns = {
        "aircraft_serial": _("Aircraft"), "panel": _("Panel"),
        **{name: capital(_(name)) for name in (NEW, WORSE, CURED)},
        "scenes": _("Scans"), "last_scan": _("Last scan"),
    }  # fmt: skip
    names = list(zip(panels["aircraft_serial"].astype(str), panels["panel"].astype(str), strict=True))
    st.caption(_("The panels that were scanned; select one to see it whole."))
    show_table(panels, columns, context.locale, "news-panels", 220, names, _open_panel)


def _open_panel(name: tuple[str, str]) -> None:
    go("panel", aircraft=name[0], panel=name[1])


_SHOWN: dict[str, Callable[[PageContext, str, pd.DataFrame], None]] = {
    NEW: _changed, WORSE: _changed, CURED: _changed, _DRIFTING: _drift, _REWORK: _work, _DUE: _due, _ASIDE: _aside,
}  # fmt: skip

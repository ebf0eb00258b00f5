"""Tolerance review: everything that does not simply pass, why, and what shall happen with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import pandas as pd
import streamlit as st

from dashboard.address import one_of, put, some_of
from dashboard.deciding import ask_who, decide, say_outcome, say_signed
from dashboard.filters import ask_about_gauges, scene_filters
from dashboard.findings import (
    OPEN,
    STATES,
    Wanted,
    feature_from_parameter,
    feature_parameter,
    feature_words,
    findings,
    names_of,
    place_of,
)
from dashboard.frame import PageContext, link, plain
from dashboard.keys import keep_order
from dashboard.locale import NOTHING
from dashboard.margins import about_the_verdict, mixed, with_margins
from dashboard.marking import offer_mark_false, offer_taking_back
from dashboard.palette import OPEN_DECISIONS, decision_words
from dashboard.picking import clicked_row
from dashboard.review_report import csv_report, html_report
from dashboard.room import room
from dashboard.scenes import find_feature, load_features, load_scene_row, surroundings
from dashboard.signing import offer_sign_off
from dashboard.suggestions import suggest_comments
from dashboard.tables import fitting, styled_table
from dashboard.views.feature import HOW_DECIDED, close_up
from dashboard.words import N_, _, language
from metrology.errors import FlushlineError
from metrology.kinds import BY_NAME
from storage.review import Feature, ShownFinding
from storage.review_details import remarks

TITLE = N_("Tolerance review")
_TURN, _STAND = "findings_turn", "review_stand"
_ORDERS: dict[str, tuple[tuple[str, ...], bool]] = {
    N_("gravest"): ((), True),
    N_("farthest beyond"): (("margin_share",), True),
    N_("place"): (("aircraft_serial", "panel", "station", "feature_kind", "feature_id"), True),
    N_("newest scan"): (("captured_at",), False),
}
"""Columns that the list is sorted by, and whether upwards; the gravest first as they come."""
Name = tuple[str, Feature]
"""A finding: its scene and what it is there."""


def _columns() -> dict[str, str]:
    """What the list has, with headings."""
    return {
        "aircraft_serial": _("Aircraft"),
        "panel": _("Panel"),
        "station": _("Station"),
        "feature_id": _("Feature"),
        "quantity": _("Quantity"),
        "value_mm": _("Value, mm"),
        "u95_mm": _("± U95"),
        "margin": _("To limit"),
        "decision": _("Verdict"),
        "state": _("State"),
        "disposition": _("Disposition"),
        "reason": _("Why"),
        "captured_at": _("Scanned"),
    }


def render(context: PageContext) -> None:
    """Show the page."""
    wanted, order = _filters(context)
    rows = findings(context.archive, wanted)
    if len(rows):
        rows = _sorted(with_margins(context.archive, rows), order)
    names = [
        (str(scene), Feature(kind, str(name)))
        for scene, kind, name in zip(rows["scene_id"], rows["feature_kind"], rows["feature_id"], strict=True)
    ]
    at = _standing(context, names, wanted)
    if at is None:
        say_outcome(context, at)
        _nothing(context, wanted)
        return
    left, right = st.columns([13, 9])
    with left:
        say_outcome(context, at)  # here it moves no button
        ticked = _list(context, rows, names, at, wanted.selection.without) if names else _empty(wanted)
    with right:
        if ticked:
            _several(context, ticked)
        _one(context, names, at, alone=not ticked)
    suggest_comments(context.archive.review())  # what has nothing to show has a gap of its own: at the end
    keep_order()


def _sorted(rows: pd.DataFrame, order: str) -> pd.DataFrame:
    columns, ascending = _ORDERS[order]
    return rows.sort_values(list(columns), ascending=ascending, kind="stable", na_position="last") if columns else rows


def _filters(context: PageContext) -> tuple[Wanted, str]:
    selection = scene_filters(context.archive)
    if not selection.aircraft:  # who chooses a gauge sees it
        selection = replace(selection, without=context.settings.not_aircraft)
    first, second, third, fourth = st.columns([6.4, 4.9, 2, 2])
    decisions = first.pills(
        _("Verdict"),
        OPEN_DECISIONS,
        selection_mode="multi",
        format_func=_,
        help=_(HOW_DECIDED),
        **some_of("verdict", OPEN_DECISIONS, OPEN_DECISIONS),
    )
    names = list(BY_NAME)
    kinds = second.pills(
        _("What"), names, selection_mode="multi", format_func=lambda name: _(BY_NAME[name].subject),
        **some_of("kind", names, names),
    )  # fmt: skip
    state = third.selectbox(
        _("State"),
        STATES,
        format_func=_,
        help=_("Open: nobody decided yet, or with open work (rework, repair, re-scan that is not done)."),
        **one_of("state", STATES),
    )
    order = fourth.selectbox(
        _("Sorted by"), list(_ORDERS), format_func=_,
        help=_("The keys j and k go along this order, among the gravest 500."),
        **one_of("sort", list(_ORDERS)),
    )  # fmt: skip
    return Wanted(tuple(decisions), tuple(kinds), state, selection), str(order)


@dataclass(frozen=True)
class _Stand:
    """What this person looked at last, by which filters, and what the address named."""

    wanted: Wanted
    named: tuple[str | None, Feature | None]
    at: Name | None


def _standing(context: PageContext, names: Sequence[Name], wanted: Wanted) -> Name | None:
    """The finding that is looked at: the one that the address names, else the first of its scan, else the first.

    It stays when the list changes under it: only a person's click, or a filter that leaves it out, leads elsewhere.
    """
    last: _Stand | None = st.session_state.get(_STAND)
    named = st.query_params.get("scene"), feature_from_parameter(st.query_params.get("feature"))
    filtered = last is not None and last.named == named and last.wanted != wanted
    scene_id, feature = named
    at: Name | None
    if scene_id and feature and context.archive.shown(scene_id, feature):
        at = (scene_id, feature)
        if filtered and at not in names:
            _look_at(None)
            named, at = (None, None), names[0] if names else None
    elif scene_id and not feature and load_scene_row(context.archive, scene_id) is not None:
        at = next((name for name in names if name[0] == scene_id), None)
    elif last and last.at and last.named == named and not filtered and context.archive.shown(*last.at):
        at = last.at
    else:
        at = names[0] if names else None
    st.session_state[_STAND] = _Stand(wanted, named, at)
    return at


def _look_at(name: Name | None) -> None:
    """Look at a finding; without one at the first of the list."""
    put(scene=name[0] if name else None, feature=feature_parameter(name[1]) if name else None)


def _nothing(context: PageContext, wanted: Wanted) -> None:
    _empty(wanted)
    _sign_off_of_scene(context)


def _empty(wanted: Wanted) -> list[Name]:
    if wanted.state == OPEN and wanted.decisions and wanted.kinds:
        st.success(_("Nothing waits here: no open finding matches these filters."), icon=":material/check:")
    elif wanted.decisions and wanted.kinds:
        st.info(_("Nothing matches these filters. Clear one of them, or choose another state, to see more."))
    else:
        st.info(_("Nothing matches these filters. Choose at least one verdict and one kind of feature."))
    return []


def _sign_off_of_scene(context: PageContext) -> None:
    """Where nothing of the address's scan is listed: how it stands, and its sign-off."""
    scene = load_scene_row(context.archive, str(st.query_params.get("scene") or ""))
    if scene is None:
        return
    st.markdown(
        f"**{plain(scene.aircraft_serial)} · {plain(scene.panel)} · {plain(scene.station)}** · "
        f"{context.locale.time(scene.captured_at)}"
    )
    _signed(context, scene)
    if context.person.may_review and scene.scene_id not in context.archive.review().sign_offs():
        ask_who(context)
    offer_sign_off(context, scene)


def _signed(context: PageContext, scene: Any) -> None:
    if signed := context.archive.review().sign_offs().get(scene.scene_id):
        say_signed(context, signed)


def _list(
    context: PageContext, rows: pd.DataFrame, names: Sequence[Name], at: Name, without: Sequence[str]
) -> list[Name]:
    """The findings; a click looks at one. Returns those that are ticked."""
    _exports(context, rows, int(rows["total"].iloc[0]), without)
    shown = about_the_verdict(rows)
    several = mixed(rows)
    left_out = {"quantity": not several, "disposition": rows["disposition"].isna().all()}
    columns = {name: title for name, title in _columns().items() if not left_out.get(name)}
    if several:
        columns["value_mm"] = _("Value")
    # Which row is looked at is said in words: a mark of Streamlit's own would go with the row's number.
    shown["feature_id"] = [f"▸ {name[1].id}" if name == at else name[1].id for name in names]
    styled, config = styled_table(shown, columns, context.locale)
    # The key names the rows: another list begins without ticks, which would else go with the rows' numbers.
    key = f"findings-{st.session_state.get(_TURN, 0)}-{hash((tuple(names), tuple(rows['run_id'])))}"
    _select(key, names, at)
    height = fitting(430, len(rows))
    with room("findings", height, fitting(2000, len(rows)), above=360):
        event = st.dataframe(
            styled,
            hide_index=True,
            height="stretch",
            column_config=config,
            key=key,
            placeholder=NOTHING,
            on_select=clicked_row(key, names, _look_at, cells_only=True),
            selection_mode=["multi-row", "single-cell"],
        )
    return [names[row] for row in event["selection"]["rows"] if row < len(names)]


def _select(key: str, names: Sequence[Name], at: Name) -> None:
    """Select the row of what is looked at, so that it shows and can be clicked again after another one was."""
    state = st.session_state.get(key)
    ticked = list(state["selection"].get("rows") or ()) if state else []
    cells = [(names.index(at), _columns()["feature_id"])] if at in names else []
    st.session_state[key] = {"selection": {"rows": ticked, "columns": [], "cells": cells}}


def _exports(context: PageContext, rows: pd.DataFrame, total: int, without: Sequence[str]) -> None:
    whole = context.locale.whole
    found = _("1 finding") if total == 1 else _("{n} findings", n=whole(total))
    if total > len(rows):
        found = _("the gravest {n} of {found}", n=whole(len(rows)), found=found)
    with st.container(horizontal=True, vertical_alignment="center"):
        # On the left: a table with something selected shows tools above its right end.
        with st.popover(_("Export"), icon=":material/download:"):
            st.caption(_("The findings of this list, with their dispositions."))
            st.download_button(
                "CSV", lambda: csv_report(rows, context.locale), "review.csv", "text/csv", on_click="ignore", key="csv"
            )
            st.download_button(
                _("HTML report"),
                partial(html_report, rows, context.archive, context.locale, context.settings.title, language()),
                "review.html",
                "text/html",
                on_click="ignore",
                key="html",
            )
        if without:
            found += " · " + _("without {names}", names=plain(", ".join(without)))
        st.caption(found, help=_("Click a row to look at it; tick several to decide on them at once."))
        if not context.settings.not_aircraft:
            ask_about_gauges(context.archive)


def _several(context: PageContext, ticked: Sequence[Name]) -> None:
    """What is ticked, and the form that decides about all of it at once."""
    shown = [found for name in ticked if (found := context.archive.shown(*name))]
    with st.container(border=True):
        st.markdown(_("**Ticked, {n}:** {names}", n=len(shown), names=plain(names_of(shown, context.locale))))
        table = pd.DataFrame(
            {
                _("Feature"): feature_words(finding.feature.id, context.locale),
                _("Place"): place_of(finding),
                _("Value, mm"): context.locale.number(finding.values["value_mm"], sign=True),
                _("Verdict"): decision_words(finding.values["decision"]),
            }
            for finding in shown
        )
        st.dataframe(table, hide_index=True, height=fitting(180, len(table)))
        st.caption(_("Whatever is recorded here is recorded for all of them. Untick them to decide about one alone."))
        decide(context, shown, partial(_recorded, None))


def _one(context: PageContext, names: Sequence[Name], at: Name, alone: bool) -> None:
    """The finding that is looked at, and the form that decides about it where nothing is ticked."""
    scene_id, feature = at
    scene, shown = load_scene_row(context.archive, scene_id), context.archive.shown(scene_id, feature)
    if scene is None or shown is None:
        st.info(_("This finding is not in the store any more; choose another one."))
        return
    features = load_features(context.archive, scene, [BY_NAME[feature.kind]])
    # What is long scrolls within the box (see the style of the pages): the buttons below stay on the screen.
    with st.container(border=True, key="finding"):
        with st.container(horizontal=True, vertical_alignment="center", gap="small"):
            _steps(names, at)
            st.caption(
                f"**{plain(scene.aircraft_serial)} · {plain(scene.panel)} · {plain(scene.station)}** · "
                f"{context.locale.time(scene.captured_at)}"
            )
        _newer(shown)
        words, picture = st.columns([4, 1])
        with words:
            close_up(context, scene, features, feature, compact=True)
        with picture:
            _crop(context, scene, find_feature(features, feature))
        _history(context, shown)
    if alone:
        decide(context, [shown], partial(_recorded, _next(names, at)))
        with st.container(horizontal=True, vertical_alignment="center", gap="small"):
            offer_mark_false(context, shown)
            offer_taking_back(context, shown)
            offer_sign_off(context, scene)


def _newer(shown: ShownFinding) -> None:
    newest = shown.values["newest_scan"]
    if newest != shown.scene_id:
        link(
            "scene",
            _("Not the newest scan of this station: see the newest"),
            ":material/history:",
            scene=str(newest),
            feature=feature_parameter(shown.feature),
        )


def _recorded(then: Name | None) -> None:
    """After a decision: nothing stays ticked, and the next finding is looked at."""
    st.session_state[_TURN] = st.session_state.get(_TURN, 0) + 1
    if then:
        _look_at(then)


def _next(names: Sequence[Name], at: Name) -> Name | None:
    """The finding after one, else the one before it."""
    if at not in names:
        return None
    place = list(names).index(at)
    return names[place + 1] if place + 1 < len(names) else names[place - 1] if place else None


def _crop(context: PageContext, scene: Any, measured: Any) -> None:
    try:
        part = surroundings(context.archive, scene, measured)
    except FlushlineError:
        return
    if part is not None:
        st.image(part, width="stretch")


def _steps(names: Sequence[Name], at: Name) -> None:
    """Buttons to go through the list, with keys."""
    place = list(names).index(at) if at in names else -1
    before = names[place - 1] if place > 0 else None
    after = names[place + 1] if place + 1 < len(names) else None
    for sign, shortcut, name, words, key in (
        ("↑", "k", before, _("Previous finding"), "previous"),
        ("↓", "j", after, _("Next finding"), "next"),
    ):
        st.button(sign, shortcut=shortcut, disabled=name is None, help=words, key=key, on_click=_look_at, args=(name,))


def _history(context: PageContext, shown: ShownFinding) -> None:
    """How this finding stands, and what was decided about it so far."""
    entries = [
        entry
        for entry in context.archive.review().entries
        if entry.scene_id == shown.scene_id and (entry.action == "sign-off" or entry.feature == shown.feature)
    ]
    for entry in entries[-4:]:
        said = remarks(entry, _, context.locale.reason)
        comment = f" · {plain(said)}" if said else ""
        earlier = "" if entry.run_id == shown.run_id else " · " + _("on another run of this scan")
        said = _("**{what}** by {who}", what=_(entry.what), who=plain(entry.who))
        st.markdown(f":small[{context.locale.time(entry.at)} {said}{comment}{earlier}]")

"""Marks of a person on a scan: no fastener where the software found one, or a fastener that it missed.

A mark is an entry of the review log. It decides nothing and changes nothing that was measured; it is kept so that a
later version can be held against it.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import plotly.graph_objects as go
import streamlit as st

from dashboard.deciding import attempt, checksum_of, hint, who_and_why, who_decides
from dashboard.figures.base import escape
from dashboard.findings import feature_words
from dashboard.frame import PageContext, plain
from dashboard.palette import YELLOW  # no verdict has it, and it shows on a grey picture
from dashboard.words import _
from storage.archive.decisions import MARKED, mark_false, mark_missed, unmark
from storage.review import MAX_COMMENT, Entry, ShownFinding, ShownScene
from storage.review_details import remarks

_PLACE = "place:"
_APART_PX = 12.0
"""Between places of the picture that a click can name; half of it is as far as a click is off at most."""


def add_marks(fig: go.Figure, marks: list[Entry]) -> None:
    """Draw marks that have a place: a cross where no fastener is, a plus where one was missed."""
    placed = [(entry, entry.mark) for entry in marks if entry.mark and entry.mark.u_px is not None]
    if placed:
        fig.add_scatter(
            x=[mark.u_px for __, mark in placed], y=[mark.v_px for __, mark in placed], mode="markers",
            marker={"symbol": ["x-thin" if mark.kind == "false" else "cross-thin" for __, mark in placed], "size": 22,
                    "line": {"width": 3, "color": YELLOW}},
            text=[escape(_said(entry)) for entry, __ in placed], hovertemplate="%{text}<extra></extra>",
            name=_("Marks of people"),
        )  # fmt: skip


def add_places(fig: go.Figure, rows: int, columns: int) -> None:
    """Places of a picture that can be clicked; they cannot be seen."""
    u, v = np.meshgrid(np.arange(_APART_PX / 2, columns, _APART_PX), np.arange(_APART_PX / 2, rows, _APART_PX))
    fig.add_scattergl(
        x=u.ravel(), y=v.ravel(), mode="markers", marker={"color": "rgba(0,0,0,0)", "size": _APART_PX},
        customdata=[f"{_PLACE}{x:.0f},{y:.0f}" for x, y in zip(u.ravel(), v.ravel(), strict=True)],
        hovertemplate=_("column {u}, row {v}", u="%{x}", v="%{y}") + "<extra></extra>", showlegend=False,
    )  # fmt: skip


def place_clicked(scene_id: str, named: str) -> bool:
    """Whether a click named a place of the picture, which the form then has."""
    if not named.startswith(_PLACE):
        return False
    for key, number in zip(_place_keys(scene_id), named.removeprefix(_PLACE).split(","), strict=True):
        st.session_state[key] = int(number)
    return True


def offer_mark_false(context: PageContext, shown: ShownFinding | None) -> None:
    """The way to say that no fastener is where one was found; nothing where that is said, or the scan is locked."""
    if shown is None or shown.feature.kind not in {kind.name for kind in MARKED} or not _may(context, shown.scene_id):
        return
    if _marks_about(context, shown):
        return
    named, key = plain(feature_words(shown.feature.id, context.locale)), checksum_of(("false", shown))
    title = _("No fastener at {named}", named=named)
    with st.popover(f"{title} …", icon=":material/location_off:"), st.form(f"mark-{key}"):
        st.caption(_("Kept beside the scan. It decides nothing: the finding stands as it did, values stay."))
        st.text_input(_("Why is it none?"), key=f"why-{key}", max_chars=MAX_COMMENT)
        st.form_submit_button(title, key=f"false-{key}", on_click=_record_false, args=(context, shown, f"why-{key}"))


def offer_taking_back(context: PageContext, shown: ShownFinding) -> None:
    """The way to take back that no fastener is there."""
    for mark in _marks_about(context, shown) if _may(context, shown.scene_id) else ():
        _take_back(context, mark)


def offer_mark_missed(context: PageContext, scene: Any, rows: int, columns: int) -> None:
    """The way to say that a fastener was missed, at a place of the picture or as a note says."""
    scene_id = str(scene.scene_id)
    if not _may(context, scene_id):
        return
    shown = ShownScene(scene_id, str(scene.run_id))
    note, (u, v) = f"note-{scene_id}", _place_keys(scene_id)
    with st.form(f"missed-{scene_id}", border=False):
        column, row, words = st.columns([2, 2, 5])
        column.number_input(_("Column in the picture"), 0, columns - 1, None, key=u)
        row.number_input(_("Row in the picture"), 0, rows - 1, None, key=v)
        words.text_input(_("Note: what was missed, and where"), key=note, max_chars=MAX_COMMENT)
        st.form_submit_button(
            _("A fastener was missed here"), key=f"record-missed-{scene_id}", icon=":material/add_location:",
            on_click=_record_missed, args=(context, shown, note),
        )  # fmt: skip


def show_marks(context: PageContext, scene_id: str) -> None:
    """The marks of a scan that hold, each with the way to take it back."""
    for mark in context.archive.review().standing_marks(scene_id):
        said = _("**{what}** by {who}", what=plain(_said(mark)), who=plain(mark.who))
        st.markdown(f":small[{context.locale.time(mark.at)} {said}]")
        if _may(context, scene_id):
            _take_back(context, mark)


def _take_back(context: PageContext, mark: Entry) -> None:
    key = f"{mark.number}-{mark.checksum[:12]}"
    title = _("Take back mark {number}", number=mark.number)
    with st.popover(f"{title} …", icon=":material/undo:"), st.form(f"unmark-{key}"):
        st.text_input(_("Why is it taken back?"), key=f"why-{key}", max_chars=MAX_COMMENT)
        st.form_submit_button(title, key=f"back-{key}", on_click=_record_back, args=(context, mark, f"why-{key}"))


def _said(mark: Entry) -> str:
    name = f"{mark.feature.id}: " if mark.feature else ""
    return f"{name}{_(mark.what)} ({said})" if (said := remarks(mark, _, _)) else f"{name}{_(mark.what)}"


def _marks_about(context: PageContext, shown: ShownFinding) -> list[Entry]:
    marks = context.archive.review().standing_marks(shown.scene_id)
    return [mark for mark in marks if mark.feature == shown.feature]


def _place_keys(scene_id: str) -> tuple[str, str]:
    return f"mark-u-{scene_id}", f"mark-v-{scene_id}"


def _may(context: PageContext, scene_id: str) -> bool:
    review = context.archive.review()
    return context.person.may_review and not review.problem and scene_id not in review.sign_offs()


def _record_false(context: PageContext, shown: ShownFinding, why: str) -> None:
    given = who_and_why(context, why)
    if given is None:
        return
    who, reason = given
    named = plain(feature_words(shown.feature.id, context.locale))
    act = partial(mark_false, context.archive.root, who, shown, reason)
    attempt(context, act, _("Marked: no fastener at {named}.", named=named), None, lambda: None)


def _record_missed(context: PageContext, shown: ShownScene, note_key: str) -> None:
    who, note = who_decides(context), str(st.session_state.get(note_key) or "").strip()
    keys = _place_keys(shown.scene_id)
    u, v = (st.session_state.get(key) for key in keys)
    pixel = None if u is None or v is None else (float(u), float(v))
    if not who or (pixel is None and not note):
        hint(_("Give your name, and the place in the picture or a note that says it."))
        return

    def done() -> None:
        for key in (*keys, note_key):
            st.session_state.pop(key, None)

    act = partial(mark_missed, context.archive.root, who, shown, note, pixel)
    attempt(context, act, _("Marked: a fastener was missed."), None, done)


def _record_back(context: PageContext, mark: Entry, why: str) -> None:
    given = who_and_why(context, why)
    if given is None:
        return
    who, reason = given
    act = partial(unmark, context.archive.root, who, mark.scene_id, mark.number, reason)
    attempt(context, act, _("Mark {number} is taken back.", number=mark.number), None, lambda: None)

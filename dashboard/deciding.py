"""Forms by which people decide: about the findings that they were drawn with, and about nothing else.

A form carries what was on the screen: its button is given the findings with run, values and last decision when it is
drawn, and its name holds a checksum of them. A click is acted on before the page is drawn anew, with what the button
was given; nothing is looked up by its place in a list. What changed meanwhile is found by `storage.archive.decisions`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import streamlit as st

from dashboard.findings import names_of
from dashboard.frame import PageContext, link, plain, told
from dashboard.keys import name_of_browser
from dashboard.words import N_, _
from metrology.errors import FlushlineError, OutdatedError
from storage.archive.decisions import close_work, dispose, undo
from storage.archive.work import DECIDED, OPEN_WORK, UNRESOLVED
from storage.review import DISPOSITIONS, MAX_COMMENT, Disposition, Entry, Review, ShownFinding
from storage.review_details import LONGEST_NUMBER, Numbers, remarks

_OUTCOME = "review_outcome"
_GIVEN = "name_given"
ACCEPTS: tuple[Disposition, ...] = ("use as is", "repair")
"""What accepts a part that is not as drawn: where roles are configured, the design authority's to decide."""
_KEYS: dict[Disposition, str] = {"use as is": "u", "rework": "w", "repair": "p", "scrap": "s", "re-scan": "n"}
_WORK: tuple[Disposition, ...] = ("rework", "repair")
"""What may have a part and a work order."""
_NUMBERS = {
    "concession": N_("Concession or NCR number"),
    "part_number": N_("Part number"),
    "work_order": N_("Work order"),
}
_SHORT = {"concession": N_("Concession")}
"""What stands in the fields, which are narrow."""
_MOST_IN_A_ROW = 3
_SECOND_ROW = """<style>
.st-key-finding.st-key-finding {max-height: max(175px, calc(100vh - 515px));}
@media (max-width: 1100px) {.st-key-finding.st-key-finding {max-height: max(175px, calc(100vh - 630px));}}
</style>"""
"""A row more below the finding: its box is lower by as much, so that the button stays on the screen."""
Done = Callable[[], None]


@dataclass(frozen=True)
class _Outcome:
    """What became of the last click, shown until the next one or until another finding is looked at."""

    kind: str
    text: str
    scene_id: str | None = None
    at: tuple[object] | None = None


def _named(context: PageContext, shown: Sequence[ShownFinding]) -> str:
    names = names_of(shown, context.locale)
    return plain(_("{n} findings: {names}", n=len(shown), names=names) if len(shown) > 1 else names)


def checksum_of(shown: object) -> str:
    """Names what was shown, for the key of a button that acts on it."""
    return hashlib.sha256(repr(shown).encode()).hexdigest()[:16]


def say_outcome(context: PageContext, at: object) -> None:
    """What became of the last click, while the same finding is looked at as then.

    Parameters
    ----------
    at : object
        What is looked at.
    """
    outcome: _Outcome | None = st.session_state.get(_OUTCOME)
    if outcome is None or outcome.at not in (None, (at,)):
        st.session_state.pop(_OUTCOME, None)
        return
    st.session_state[_OUTCOME] = replace(outcome, at=(at,))
    if outcome.kind == "done":
        st.success(outcome.text, icon=":material/check:")
        _offer_sign_off(context, outcome.scene_id)
    elif outcome.kind == "hint":
        st.warning(outcome.text)
    else:
        st.error(outcome.text, icon=":material/block:")


def _offer_sign_off(context: PageContext, scene_id: str | None) -> None:
    """After the last decision of a scan: the way to its sign-off."""
    if scene_id is None or scene_id in context.archive.review().sign_offs() or scene_id == st.query_params.get("scene"):
        return
    if not any(standing.state in UNRESOLVED for standing in context.archive.standings(scene_id)):
        link(
            "review",
            _("Everything on that scan is decided: sign it off"),
            ":material/lock:",
            scene=scene_id,
            state=DECIDED,
        )


def decide(context: PageContext, shown: Sequence[ShownFinding], done: Done) -> None:
    """The form that disposes of findings; signed-off scans are locked.

    Parameters
    ----------
    done : callable
        What follows when it is recorded.
    """
    review = context.archive.review()
    if review.problem:
        st.error(told(review.problem), icon=":material/error:")
        return
    signed = next((entry for s in shown if (entry := review.sign_offs().get(s.scene_id))), None)
    if signed:
        say_signed(context, signed)
    elif not context.person.may_review:
        st.caption(_("You may look. Deciding and signing off needs the role of a reviewer."))
    else:
        _form(context, shown, done)
    _close(context, review, shown, done)
    if not signed and context.person.may_review:
        _undo(context, review, shown)


def say_signed(context: PageContext, signed: Entry) -> None:
    """That a scan is locked, by whom and since when."""
    said = _(
        "Signed off by {who}, {at}: this scan is locked.", who=plain(signed.who), at=context.locale.time(signed.at)
    )
    st.info(
        " ".join(part for part in (said, plain(remarks(signed, _, context.locale.reason))) if part),
        icon=":material/lock:",
    )


def _form(context: PageContext, shown: Sequence[ShownFinding], done: Done) -> None:
    key = checksum_of(shown)
    # Kept where the same findings are shown anew; the disposition is not.
    comment_key = f"comment-{checksum_of([(s.scene_id, s.feature) for s in shown])}"
    disposition = _choose_disposition(context, f"disposition-{key}")
    left, right = st.columns([2, 5])
    with left:
        ask_who(context)
    with right, st.form(f"decide-{key}", border=False):
        asked = _numbers_asked(context, disposition)
        boxes = st.columns([2] * len(asked) + ([3] if len(asked) < _MOST_IN_A_ROW else [])) if asked else []
        for name, box in zip(asked, boxes, strict=False):
            box.text_input(
                _(_NUMBERS[name]), key=f"{name}-{key}", max_chars=LONGEST_NUMBER, label_visibility="collapsed",
                placeholder=_(_SHORT.get(name, _NUMBERS[name])),
            )  # fmt: skip
        where: Any = boxes[-1] if len(boxes) > len(asked) else st
        if asked and where is st:
            st.html(_SECOND_ROW)
        where.text_input(
            _("Comment"), key=comment_key, max_chars=MAX_COMMENT, placeholder=_("Comment: what and why"),
            label_visibility="collapsed",
        )  # fmt: skip
        named = _named(context, shown)
        st.form_submit_button(
            _("Record *{decision}* for {named}", decision=_(disposition), named=named)
            if disposition
            else _("Record for {named}", named=named),
            type="primary",
            icon=":material/edit_note:",
            key=f"record-{key}",
            shortcut="Enter",
            on_click=_record,
            args=(context, tuple(shown), key, comment_key, done),
        )


def _numbers_asked(context: PageContext, disposition: str | None) -> list[str]:
    """Numbers of the paperwork that the form asks for: names of `Numbers`."""
    asked = ["concession"] if disposition in ACCEPTS and context.settings.concessions else []
    return [*asked, "part_number", "work_order"] if disposition in _WORK else asked


def _choose_disposition(context: PageContext, key: str) -> str | None:
    """Buttons with keys, of which one is chosen; those that this person may not choose are grey."""
    chosen: str | None = st.session_state.get(key)
    with st.container(horizontal=True, vertical_alignment="center", gap="small", key="decisions"):
        st.markdown(
            ":small[" + _("Disposition") + "]", width="content",
            help=_("A key chooses, Enter records. Another key changes the choice, Escape takes it back."),
        )  # fmt: skip
        for disposition in DISPOSITIONS:
            allowed = context.person.may_accept or disposition not in ACCEPTS
            st.button(
                _(disposition),
                key=f"{key}-{disposition}",
                type="primary" if disposition == chosen else "secondary",
                shortcut=_KEYS[disposition],
                disabled=not allowed,
                help=None
                if allowed
                else _("Only the design authority decides this (roles in the dashboard's settings)."),
                on_click=_choose,
                args=(key, disposition),
            )
        with st.container(key="take-back"):  # for its key alone; not drawn
            st.button("✕", key=f"none-{key}", shortcut="Escape", on_click=_choose, args=(key, None))
    return chosen


def _choose(key: str, disposition: str | None) -> None:
    """Choose a disposition, however often its key is pressed; None takes the choice back."""
    st.session_state[key] = disposition


def ask_who(context: PageContext, width: int | Literal["stretch"] = "stretch") -> None:
    """A field for the name, where nobody logs in; `width` in pixels. It keeps the name over pages and reloads."""
    if not context.person.verified:
        # Streamlit forgets what was typed into a field that a page does not have.
        st.session_state.setdefault("who", st.session_state.get(_GIVEN, name_of_browser()))
        st.text_input(
            _("Your name"), key="who", max_chars=120, placeholder=_("Your name") + " · Y", label_visibility="collapsed",
            width=width,
            help=_("Nobody logs in here, so the log keeps the name you give."),
        )  # fmt: skip
        st.session_state[_GIVEN] = st.session_state["who"]


def who_decides(context: PageContext) -> str:
    """The name of the log-in, else the one that was given; "" where there is none."""
    return context.person.name if context.person.verified else str(st.session_state.get("who") or "").strip()


def _record(context: PageContext, shown: tuple[ShownFinding, ...], key: str, comment_key: str, done: Done) -> None:
    disposition, who = st.session_state.get(f"disposition-{key}"), who_decides(context)
    if not disposition or not who:
        missing = _("Choose a disposition.") if who else _("Give your name.")
        hint(missing if disposition or who else _("Choose a disposition and give your name."))
        return
    asked = _numbers_asked(context, disposition)
    numbers = Numbers(**{name: _typed(f"{name}-{key}") for name in asked})
    if "concession" in asked and not numbers.concession:
        hint(_("*{decision}* needs its concession or NCR number.", decision=_(disposition)))
        return
    text = _("Recorded *{decision}* for {named}.", decision=_(disposition), named=_named(context, shown))
    act = partial(dispose, context.archive.root, who, shown, disposition, _typed(comment_key), numbers)
    attempt(context, act, text, shown[0].scene_id, done)


def _typed(key: str) -> str:
    return str(st.session_state.get(key) or "").strip()


def _close(context: PageContext, review: Review, shown: Sequence[ShownFinding], done: Done) -> None:
    """What to do about open work: wait for the next scan, or close it with a reason."""
    work = [review.work().get((s.scene_id, feature)) for s in shown for feature in s.features]
    if not all(work) or not _is_open(context, shown):
        return
    asked = _(" or ").join(sorted({_(str(entry.disposition)) for entry in work if entry}))
    named = _named(context, shown)
    st.caption(
        ":material/construction: "
        + _(
            "Open work: {asked} of {named}. It is done when a later scan of the station passes.",
            asked=asked,
            named=named,
        )
    )
    if context.person.may_review:
        title = _("Close *{asked}* of {named}", asked=asked, named=named)
        said = _("Closed *{asked}* of {named}.", asked=asked, named=named)
        why = _("Why is the work done, or not needed any more?")
        _with_reason(context, shown, _Act(title, why, said, close_work, ":material/task_alt:", done))


def _undo(context: PageContext, review: Review, shown: Sequence[ShownFinding]) -> None:
    """Undo the last decision about one finding with a reason, so that the one before it holds again."""
    if len(shown) > 1 or (last := review.undoable(shown[0].scene_id, *shown[0].features)) is None:
        return
    before = [entry.disposition for entry in review.held(shown[0].scene_id, shown[0].features[0])[:-1]]
    if set(before) & set(ACCEPTS) and not context.person.may_accept:
        return
    names = {"what": _(last.what), "named": _named(context, shown)}
    title, said = _("Undo *{what}* of {named}", **names), _("Undone: *{what}* of {named}.", **names)
    act = _Act(title, _("Why is it undone?"), said, undo, ":material/undo:", lambda: None)
    _with_reason(context, shown, act)


@dataclass(frozen=True)
class _Act:
    """Something that is recorded with a reason: its button, what is asked, what is said when it is done."""

    title: str
    why: str
    said: str
    record: Callable[[Path, str, Sequence[ShownFinding], str], object]
    icon: str
    done: Done


def _with_reason(context: PageContext, shown: Sequence[ShownFinding], act: _Act) -> None:
    key = checksum_of((act.record.__name__, shown))
    with st.popover(f"{act.title} …", icon=act.icon), st.form(f"form-{key}"):
        st.text_input(act.why, key=f"reason-{key}", max_chars=MAX_COMMENT)
        st.markdown(_("By **{who}**", who=plain(who_decides(context)) or _("give your name first")))
        st.form_submit_button(
            act.title, key=f"act-{key}", on_click=_record_reason, args=(context, tuple(shown), act, f"reason-{key}")
        )


def _is_open(context: PageContext, shown: Sequence[ShownFinding]) -> bool:
    states = {
        (scene_id, standing.feature): standing.state
        for scene_id in {s.scene_id for s in shown}
        for standing in context.archive.standings(scene_id)
    }
    return all(states.get((s.scene_id, s.feature)) == OPEN_WORK for s in shown)


def _record_reason(context: PageContext, shown: tuple[ShownFinding, ...], act: _Act, reason_key: str) -> None:
    if given := who_and_why(context, reason_key):
        record = partial(act.record, context.archive.root, given[0], shown, given[1])
        attempt(context, record, act.said, shown[0].scene_id, act.done)


def who_and_why(context: PageContext, reason_key: str) -> tuple[str, str] | None:
    """Name and reason as they were given; None where one is missing, which is said."""
    who, reason = who_decides(context), str(st.session_state.get(reason_key) or "").strip()
    if who and reason:
        return who, reason
    hint(_("Give your name and the reason."))
    return None


def hint(text: str) -> None:
    """Say what is missing, in place of recording anything."""
    st.session_state[_OUTCOME] = _Outcome("hint", text)


def attempt(context: PageContext, act: Callable[[], object], text: str, scene_id: str | None, done: Done) -> None:
    """Record something, and keep what became of it for `say_outcome`: `text`, or why it was refused."""
    try:
        act()
    except OutdatedError as problem:
        refusal = _(
            "**Not recorded**, nothing was changed. {problem}. What is there now is shown below.",
            problem=plain(context.locale.reason(problem)),
        )
        st.session_state[_OUTCOME] = _Outcome("refused", refusal)
    except FlushlineError as problem:
        st.session_state[_OUTCOME] = _Outcome(
            "refused", _("**Not recorded.** {problem}", problem=plain(context.locale.reason(problem)))
        )
    else:
        st.session_state[_OUTCOME] = _Outcome("done", text, scene_id)
        done()

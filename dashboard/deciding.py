"""Forms by which people decide: about the findings or the scan that they were drawn with, and about nothing else.

A form carries what was on the screen: its button is given the findings with run, values and last decision when it is
drawn, and its name holds a checksum of them. A click is acted on before the page is drawn anew, with what the button
was given; nothing is looked up by its place in a list. What changed meanwhile is found by `storage.archive.decisions`.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import pandas as pd
import streamlit as st

from dashboard.frame import PageContext, link, plain
from metrology.errors import FlushlineError, OutdatedError
from storage.archive.decisions import close_work, dispose, sign_off_all
from storage.archive.work import DECIDED, OPEN_WORK, UNRESOLVED, said
from storage.review import DISPOSITIONS, MAX_COMMENT, Disposition, Entry, Review, ShownFinding, ShownScene

_OUTCOME = "review_outcome"
_MOST_NAMED = 12
ACCEPTS: tuple[Disposition, ...] = ("use as is", "repair")
"""What accepts a part that is not as drawn: where roles are configured, the design authority's to decide."""
_KEYS: dict[Disposition, str] = {"use as is": "u", "rework": "w", "repair": "p", "scrap": "s", "re-scan": "n"}
Done = Callable[[], None]


@dataclass(frozen=True)
class _Outcome:
    """What became of the last click, shown until the next one or until another finding is looked at."""

    kind: str
    text: str
    scene_id: str | None = None
    at: tuple[object] | None = None


def name_of(shown: ShownFinding) -> str:
    """A finding in full: rivet or position, aircraft, panel, station."""
    return f"{shown.feature.id} ({place_of(shown)})"


def place_of(shown: ShownFinding) -> str:
    """Aircraft, panel and station of a finding."""
    return " ".join(str(shown.values[name]) for name in ("aircraft_serial", "panel", "station"))


def names_of(shown: Sequence[ShownFinding]) -> str:
    """Several findings in a line; with their places where these differ."""
    places = {place_of(finding) for finding in shown}
    names = [finding.feature.id if len(places) == 1 else name_of(finding) for finding in shown[:_MOST_NAMED]]
    more = f" and {len(shown) - _MOST_NAMED} more" if len(shown) > _MOST_NAMED else ""
    return ", ".join(names) + more + (f" ({places.pop()})" if len(places) == 1 else "")


def _named(shown: Sequence[ShownFinding]) -> str:
    count = f"{len(shown)} findings: " if len(shown) > 1 else ""
    return plain(f"{count}{names_of(shown)}")


def _checksum(shown: object) -> str:
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
        link("review", "All of that scan is decided: sign it off", ":material/lock:", scene=scene_id, state=DECIDED)


def decide(context: PageContext, shown: Sequence[ShownFinding], done: Done) -> None:
    """The form that disposes of findings; signed-off scans are locked.

    Parameters
    ----------
    done : callable
        What follows when it is recorded.
    """
    review = context.archive.review()
    if review.problem:
        st.error(plain(review.problem), icon=":material/error:")
        return
    _close(context, review, shown, done)
    signed = next((entry for s in shown if (entry := review.sign_offs().get(s.scene_id))), None)
    if signed:
        scan = "this scan" if len(shown) == 1 else plain(signed.scene_id)
        st.info(
            f"Signed off by {plain(signed.who)}, {context.locale.time(signed.at)}: {scan} is locked.",
            icon=":material/lock:",
        )
        return
    if not context.person.may_review:
        st.caption("You may look; disposing and signing off needs the role reviewer.")
        return
    key = _checksum(shown)
    # Kept where the same findings are shown anew; the disposition is not.
    comment_key = f"comment-{_checksum([(s.scene_id, s.feature) for s in shown])}"
    disposition = _choose_disposition(context, f"disposition-{key}")
    left, right = st.columns([2, 5])
    with left:
        ask_who(context)
    with right, st.form(f"decide-{key}", border=False):
        concession_key = f"concession-{key}"
        if disposition in ACCEPTS and context.settings.concessions:
            st.text_input(
                "Concession or NCR number",
                key=concession_key,
                max_chars=80,
                placeholder="concession or NCR number",
                label_visibility="collapsed",
            )
        st.text_input(
            "Comment",
            key=comment_key,
            max_chars=MAX_COMMENT,
            placeholder="comment: what and why",
            label_visibility="collapsed",
        )
        chosen = f" *{disposition}*" if disposition else ""
        st.form_submit_button(
            f"Record{chosen} for {_named(shown)}",
            type="primary",
            icon=":material/edit_note:",
            key=f"record-{key}",
            shortcut="Enter",
            on_click=_record,
            args=(context, tuple(shown), f"disposition-{key}", (concession_key, comment_key), done),
        )


def _choose_disposition(context: PageContext, key: str) -> str | None:
    """Buttons with keys, of which one is chosen; those that this person may not choose are grey."""
    st.markdown(":small[Disposition]")
    chosen: str | None = st.session_state.get(key)
    with st.container(horizontal=True, gap="small"):
        for disposition in DISPOSITIONS:
            allowed = context.person.may_accept or disposition not in ACCEPTS
            st.button(
                disposition,
                key=f"{key}-{disposition}",
                type="primary" if disposition == chosen else "secondary",
                shortcut=_KEYS[disposition],
                disabled=not allowed,
                help=None if allowed else "Use as is and repair are the design authority's: see the dashboard's roles.",
                on_click=_choose,
                args=(key, disposition),
            )
    return chosen


def _choose(key: str, disposition: str) -> None:
    """Choose a disposition; a second time takes the choice back."""
    st.session_state[key] = None if st.session_state.get(key) == disposition else disposition


def ask_who(context: PageContext) -> None:
    """A field for the name, where nobody logs in."""
    if not context.person.verified:
        st.text_input(
            "Your name", key="who", max_chars=120, placeholder="your name", label_visibility="collapsed",
            help="Nobody logs in here, so the log keeps the name you give.",
        )  # fmt: skip


def _who(context: PageContext) -> str:
    return context.person.name if context.person.verified else str(st.session_state.get("who") or "").strip()


def _record(
    context: PageContext, shown: tuple[ShownFinding, ...], disposition_key: str, text_keys: tuple[str, str], done: Done
) -> None:
    disposition, who = st.session_state.get(disposition_key), _who(context)
    if not disposition or not who:
        st.session_state[_OUTCOME] = _Outcome("hint", "Choose a disposition and give your name.")
        return
    concession, comment = (str(st.session_state.get(key) or "").strip() for key in text_keys)
    if disposition in ACCEPTS and context.settings.concessions:
        if not concession:
            st.session_state[_OUTCOME] = _Outcome("hint", f"*{disposition}* needs its concession or NCR number.")
            return
        comment = f"{concession}: {comment}" if comment else concession
    text = f"Recorded *{disposition}* for {_named(shown)}."
    _try(lambda: dispose(context.archive.root, who, shown, disposition, comment), text, shown[0].scene_id, done)


def _close(context: PageContext, review: Review, shown: Sequence[ShownFinding], done: Done) -> None:
    """What to do about open work: wait for the next scan, or close it with a reason."""
    work = [review.work().get((s.scene_id, feature)) for s in shown for feature in s.features]
    if not all(work) or not _is_open(context, shown):
        return
    asked = " or ".join(sorted({str(entry.disposition) for entry in work if entry}))
    st.warning(
        f"Open work: {asked} of {_named(shown)}. It is done when a later scan of the station passes.",
        icon=":material/construction:",
    )
    if not context.person.may_review:
        return
    key = _checksum(("close", shown))
    with st.popover(f"Close *{asked}* of {_named(shown)} …", icon=":material/task_alt:"), st.form(f"close-{key}"):
        st.text_input("Why is the work done, or not needed any more?", key=f"reason-{key}", max_chars=MAX_COMMENT)
        who = _who(context)
        st.markdown(f"Closes: **{plain(who) or 'give your name first'}**")
        st.form_submit_button(
            f"Close *{asked}* of {_named(shown)}",
            key=f"close-work-{key}",
            on_click=_record_close,
            args=(context, tuple(shown), asked, f"reason-{key}", done),
        )


def _is_open(context: PageContext, shown: Sequence[ShownFinding]) -> bool:
    states = {
        (scene_id, standing.feature): standing.state
        for scene_id in {s.scene_id for s in shown}
        for standing in context.archive.standings(scene_id)
    }
    return all(states.get((s.scene_id, s.feature)) == OPEN_WORK for s in shown)


def _record_close(
    context: PageContext, shown: tuple[ShownFinding, ...], asked: str, reason_key: str, done: Done
) -> None:
    who, reason = _who(context), str(st.session_state.get(reason_key) or "")
    if not who or not reason.strip():
        st.session_state[_OUTCOME] = _Outcome("hint", "Give your name, and the reason why the work is closed.")
        return
    text = f"Closed *{asked}* of {_named(shown)}."
    _try(lambda: close_work(context.archive.root, who, shown, reason), text, shown[0].scene_id, done)


def offer_sign_off(context: PageContext, scene: Any) -> None:
    """The sign-off of a scan, with the decisions that it would lock."""
    offer_sign_off_of(context, [scene], plain(f"{scene.aircraft_serial} {scene.panel} {scene.station}"))


def offer_sign_off_of(context: PageContext, scenes: Sequence[Any], place: str, meaning: str = "") -> None:
    """The sign-off of scans, all of them or none; nothing where they are signed off.

    Parameters
    ----------
    scenes : sequence of rows of the table scenes
    place : str
        What the button calls them.
    meaning : str
        What the signature says, kept with it.
    """
    review = context.archive.review()
    scenes = [scene for scene in scenes if scene.scene_id not in review.sign_offs()]
    if review.problem or not context.person.may_review or not scenes:
        return
    standings = {str(scene.scene_id): context.archive.standings(scene.scene_id) for scene in scenes}
    found = [standing for of_scene in standings.values() for standing in of_scene]
    left = any(standing.state in UNRESOLVED for standing in found)
    shown = [_shown_scene(review, scene, len(standings[str(scene.scene_id)])) for scene in scenes]
    key = _checksum(shown)
    with st.popover(f"Sign off {place} …", icon=":material/lock:", disabled=left, key=f"signing-{key}"):
        decided = {e.number: e for (scene_id, _), e in review.current().items() if scene_id in standings}
        taken = " · ".join(f"{plain(s.station)} {context.locale.time(s.captured_at)}" for s in scenes)
        st.markdown(f"Scanned {taken}, {_counted(list(decided.values()))}.")
        if meaning:
            st.markdown(f"Says: **{plain(meaning)}**")
        st.caption("Its dispositions can not be changed afterwards.")
        who = _who(context)
        st.markdown(f"Signs: **{plain(who) or 'give your name first'}**")
        st.button(
            f"Sign off {place}",
            type="primary",
            disabled=not who,
            key=f"sign-off-{key}",
            on_click=partial(_record_sign_off, context, shown, place, meaning),
        )
    if left:
        st.caption(f"It can be signed off when nothing waits and no work is open. Findings: {said(found)}.")


def _shown_scene(review: Review, scene: Any, decided: int) -> ShownScene:
    values = {
        "n_rivets": None if pd.isna(scene.n_rivets) else int(scene.n_rivets),
        "n_stations": None if pd.isna(scene.n_stations) else int(scene.n_stations),
        "panel_spec": str(scene.panel_spec),
        "software_version": str(scene.software_version),
        "n_decided": decided,
    }
    return ShownScene(str(scene.scene_id), str(scene.run_id), values, review.last_of_scene(str(scene.scene_id)))


def _counted(decided: Sequence[Entry]) -> str:
    counts = Counter(str(entry.disposition) for entry in decided)
    text = ", ".join(f"{name}: {count}" for name, count in sorted(counts.items()))
    return f"dispositions: {text}" if text else "nothing needed a disposition"


def _record_sign_off(context: PageContext, shown: Sequence[ShownScene], place: str, meaning: str) -> None:
    _try(
        lambda: sign_off_all(context.archive.root, _who(context), shown, meaning),
        f"Signed off {place}.",
        None,
        lambda: None,
    )


def _try(act: Callable[[], object], text: str, scene_id: str | None, done: Done) -> None:
    try:
        act()
    except OutdatedError as problem:
        refusal = f"**Not recorded**, nothing was changed. {plain(problem)}. What is there now is shown below."
        st.session_state[_OUTCOME] = _Outcome("refused", refusal)
    except FlushlineError as problem:
        st.session_state[_OUTCOME] = _Outcome("refused", f"**Not recorded.** {plain(problem)}")
    else:
        st.session_state[_OUTCOME] = _Outcome("done", text, scene_id)
        done()

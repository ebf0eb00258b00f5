"""Signing off: scans, or a panel with all of its scans, with role and meaning of the signature.

Streamlit hands a log-in no wish to ask for the password again: what its secrets say holds for every log-in. So whoever
logged in types their name once more where they sign.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from typing import Any

import pandas as pd
import streamlit as st

from dashboard.access import Person
from dashboard.deciding import attempt, checksum_of, hint, who_decides
from dashboard.findings import standings_words
from dashboard.frame import PageContext, plain
from dashboard.words import _
from storage.archive.decisions import sign_off_all
from storage.archive.work import UNRESOLVED
from storage.review import Entry, Review, ShownScene
from storage.review_details import SCAN_RELEASED, Confirmation, Signature


def offer_sign_off(context: PageContext, scene: Any) -> None:
    """The sign-off of a scan, with the decisions that it would lock."""
    place = plain(f"{scene.aircraft_serial} {scene.panel} {scene.station}")
    offer_sign_off_of(context, [scene], place, SCAN_RELEASED)


def offer_sign_off_of(context: PageContext, scenes: Sequence[Any], place: str, meaning: str) -> None:
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
    standings = context.archive.standings_of([str(scene.scene_id) for scene in scenes])
    found = [standing for of_scene in standings.values() for standing in of_scene]
    left = any(standing.state in UNRESOLVED for standing in found)
    shown = [_shown_scene(review, scene, len(standings[str(scene.scene_id)])) for scene in scenes]
    key = checksum_of(shown)
    with st.popover(_("Sign off {place} …", place=place), icon=":material/lock:", disabled=left, key=f"signing-{key}"):
        decided = {e.number: e for (scene_id, __), e in review.current().items() if scene_id in standings}
        taken = " · ".join(f"{plain(s.station)} {context.locale.time(s.captured_at)}" for s in scenes)
        st.markdown(_("Scanned {taken}, {decisions}.", taken=taken, decisions=_counted(list(decided.values()))))
        st.markdown(_("Says: **{meaning}**", meaning=plain(context.locale.reason(meaning))))
        st.caption(_("Its dispositions cannot be changed afterwards."))
        _signature_form(context, shown, place, meaning, key)
    if left:
        st.caption(
            _(
                "It can be signed off when nothing waits and no work is open. Findings: {found}.",
                found=standings_words(found),
            )
        )


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
    counts = Counter(_(str(entry.disposition)) for entry in decided)
    text = ", ".join(f"{name}: {count}" for name, count in sorted(counts.items()))
    return _("dispositions: {text}", text=text) if text else _("nothing needed a disposition")


def _signature_form(context: PageContext, shown: Sequence[ShownScene], place: str, meaning: str, key: str) -> None:
    """Who signs and as what; where people log in, the name is typed once more."""
    who, person = who_decides(context), context.person
    typed_key = f"typed-{key}"
    with st.form(f"form-{key}", border=False):
        named = plain(who) or _("give your name first")
        st.markdown(_("Signs: **{who}**, as {role}", who=named, role=plain(_(person.signs_as))))
        if person.verified:
            st.text_input(_("Type {name} to confirm that it is you", name=plain(who)), key=typed_key, max_chars=320)
        st.form_submit_button(
            _("Sign off {place}", place=place),
            type="primary",
            disabled=not who,
            key=f"sign-off-{key}",
            on_click=partial(_record_sign_off, context, shown, place, meaning, typed_key),
        )


def confirmed(person: Person, typed: str) -> Confirmation | None:
    """How sure it is who signs; None where somebody logged in and did not type their name.

    Parameters
    ----------
    typed : str
        What was typed to confirm it; read only where people log in.
    """
    if not person.verified:
        return "given name"
    return "log-in, name typed" if typed.strip().casefold() == person.name.casefold() else None


def _record_sign_off(
    context: PageContext, shown: Sequence[ShownScene], place: str, meaning: str, typed_key: str
) -> None:
    how = confirmed(context.person, str(st.session_state.get(typed_key) or ""))
    if how is None:
        hint(_("**Not signed.** Type {name} to confirm that it is you.", name=plain(context.person.name)))
        return
    signature = Signature(role=context.person.signs_as, meaning=meaning, confirmed=how)
    act = partial(sign_off_all, context.archive.root, who_decides(context), shown, signature=signature)
    attempt(context, act, _("Signed off {place}.", place=place), None, lambda: None)

"""A scan's overlay: the picture for the projector in the person's language, and buttons for its files."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import streamlit as st

from dashboard.data import Archive
from dashboard.frame import PageContext
from dashboard.reports import wording_of
from dashboard.words import ENGLISH, _, language
from metrology.errors import StoreError
from storage.archive.work import OPEN_WORK
from storage.wording import Wording, written_in

_KINDS = {".png": "image/png", ".svg": "image/svg+xml"}


def show_overlay(context: PageContext, row: Any) -> None:
    """Show a scan's overlay, and buttons for it."""
    path, scene_id = context.archive.file(row.overlay_path), str(row.scene_id)
    words = wording_of(context.locale, language())
    file = partial(_file, str(row.bundle_path), words.language, words.decimal, _archive=context.archive, _words=words)
    try:
        st.image(str(path) if words.language == ENGLISH else file(scene_id, ".png"), width="stretch")
    except OSError:  # what Pillow raises for a damaged picture
        raise StoreError(f"{path}: found no readable picture, expected the scene's overlay") from None
    with st.container(horizontal=True):
        _offer(_("Download for the projector (PNG)"), partial(file, scene_id, ".png"), f"{scene_id}_overlay.png")
        if path.with_suffix(".svg").is_file():
            _offer("SVG", partial(file, scene_id, ".svg"), f"{scene_id}_overlay.svg")
        drawings = [(_("With names"), "named", False)]
        if any(standing.state == OPEN_WORK for standing in context.archive.standings(scene_id)):
            drawings.append((_("Open work only"), "work", True))
        for label, what, work_alone in drawings:
            _offer(label, partial(_named, context.archive, words, scene_id, work_alone), f"{scene_id}_{what}.png")
    st.caption(
        _(
            "The picture's own words: {ok} meets the limits, {out} is slightly outside, {serious} seriously, "
            "{not_judged} was not judged. Values in mm: height of rivets; step | gap of seams. * nearer to a limit "
            "than its uncertainty, ? not measured.",
            ok=_("OK"),
            out=_("OUT"),
            serious=_("SERIOUS"),
            not_judged=_("NOT JUDGED"),
        )
    )


def _offer(label: str, made: Callable[[], bytes], name: str) -> None:
    """A button for a file that is made when it is asked for."""
    st.download_button(label, made, name, _KINDS[name[-4:]], on_click="ignore")


@st.cache_data(max_entries=6, show_spinner=False)
def _file(
    bundle: str, spoken: str, decimal: str, scene_id: str, suffix: str, _archive: Archive, _words: Wording
) -> bytes:
    from storage.report.redrawn import overlay_file

    with written_in(_words):
        return overlay_file(_archive.store, scene_id, suffix)


def _named(archive: Archive, words: Wording, scene_id: str, work_alone: bool) -> bytes:
    """The overlay with the panel's names as a PNG."""
    from storage.report.redrawn import encoded, redrawn_overlay

    with written_in(words):
        return encoded(redrawn_overlay(archive.store, scene_id, work_alone), ".png")

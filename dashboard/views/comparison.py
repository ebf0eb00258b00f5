"""Scans side by side, and how what they show differs, as the archive shows them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd
import streamlit as st

from dashboard.comparing import differences
from dashboard.figures.scene import SceneFeatures, scene_figure
from dashboard.frame import PageContext, go, plain
from dashboard.pictures import load_picture
from dashboard.scenes import load_features, load_scene_row
from dashboard.tables import show_table
from dashboard.words import _

MOST_COMPARED = 8
_HEIGHTS = {2: 330, 3: 240, 4: 200}
"""Of the pictures, by how many stand beside each other, px."""


def compare(context: PageContext, names: Sequence[str]) -> None:
    """Scans in the order of time, and each one's changes from the first."""
    if st.button(_("Back to the list"), icon=":material/arrow_back:"):
        go("archive")
    rows = []
    for name in names:
        row = load_scene_row(context.archive, name)
        if row is None:
            st.warning(_("There is no scan {name} in this store.", name=plain(name)))
            return
        rows.append(row)
    if len(rows) < 2:
        st.info(_("This is one scan; choose another one to compare it with."))
        return
    rows.sort(key=lambda row: (row.captured_at, row.scene_id))
    features = [load_features(context.archive, row) for row in rows]
    above = _pictures(context, rows, features)
    _caveats(rows)
    st.markdown(_("**On these scans**, the largest change first"))
    changes = differences(*features)
    show_table(changes, _columns(changes, len(rows)), context.locale, key="differences", height=260, above=above)


def _pictures(context: PageContext, rows: Sequence[Any], features: Sequence[SceneFeatures]) -> int:
    """The pictures, numbered; returns how much of the screen all but the table takes, px."""
    beside = min(len(rows), max(_HEIGHTS))
    height = _HEIGHTS[beside]
    numbered = list(enumerate(zip(rows, features, strict=True), 1))
    lines = [numbered[first : first + beside] for first in range(0, len(numbered), beside)]
    for line in lines:
        for column, (number, (row, found)) in zip(st.columns(beside), line, strict=False):
            with column:
                st.markdown(
                    f"**{number} · {plain(row.aircraft_serial)} · {plain(row.panel)} · {plain(row.station)}** · "
                    f"{context.locale.time(row.captured_at)}"
                )
                picture = load_picture(context.archive.file(row.preview_path))
                st.plotly_chart(
                    scene_figure(picture, found, None, context.locale, height=height, values=beside == 2),
                    key=f"picture-{number}-{row.scene_id}",
                )
    return 120 + len(lines) * (height + 58)


def _caveats(rows: Sequence[Any]) -> None:
    if len({(row.panel, row.station) for row in rows}) > 1:
        st.caption(_("These are different stations: rivets of the same name need not be the same rivet."))
    if any(row.registration == "not recognised" for row in rows):
        st.caption(_("On one of these scans the panel was not recognised: its names are its own."))


def _columns(changes: pd.DataFrame, n: int) -> dict[str, str]:
    """Values, verdicts and changes under their scans' numbers."""
    columns = {"feature_id": _("Feature"), "quantity": _("Quantity")}
    for number in range(1, n + 1):
        columns[f"value_mm_{number}"] = _("{number}, mm", number=number)
        columns[f"decision_{number}"] = _("Verdict {number}", number=number)
        if number > 1:
            columns[f"difference_mm_{number}"] = _("Change 1 → {number}, mm", number=number)
            columns[f"difference_u95_mm_{number}"] = _("± U95 of 1 → {number}", number=number)
    return {name: title for name, title in columns.items() if name in changes}

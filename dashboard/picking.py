"""Clicks on tables and charts, told by what was there when they were drawn.

Streamlit tells a click by the number of a row. By the time the page runs again that row may be another one: a scan was
stored, a filter changed. So a click is looked up in the names of the rows as the person saw them, before anything is
drawn anew.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import streamlit as st

Picked = Callable[[Any], None]


def clicked_row(key: str, names: Sequence[Any], picked: Picked, cells_only: bool = False) -> Callable[[], None]:
    """For a table's `on_select`: passes on the name of the row that was clicked or ticked.

    Parameters
    ----------
    names : sequence
        Of the rows, as drawn.
    cells_only : bool
        Whether ticks mean something else.
    """

    def act() -> None:
        selection = _selection(key)
        rows = [cell[0] for cell in selection.get("cells") or ()]
        if not rows and not cells_only:
            rows = list(selection.get("rows") or ())
        if rows and rows[0] < len(names):
            picked(names[rows[0]])

    return act


def clickable_chart(figure: Any, key: str, picked: Picked, config: Mapping[str, Any]) -> None:
    """A chart whose points carry a name as `customdata`, which is passed on where one is clicked."""

    def act() -> None:
        carried = [point["customdata"] for point in _selection(key).get("points") or () if point.get("customdata")]
        if carried:
            first = carried[0]
            picked(first[0] if isinstance(first, (list, tuple)) and len(first) == 1 else first)

    st.plotly_chart(figure, key=key, on_select=act, selection_mode="points", config=dict(config))


def _selection(key: str) -> Mapping[str, Any]:
    state = st.session_state.get(key)
    return state["selection"] if state else {}

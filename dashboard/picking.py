"""Clicks on tables and charts, understood by what was there when they were drawn.

Streamlit names the row of a click by number. By the time the page runs again that row may be another one: a scan was
stored, a filter changed. So a click is looked up in the names of the rows as the person saw them, before anything is
drawn anew.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from typing import Any

import streamlit as st

from dashboard.room import room

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
        rows = _selected_rows(key, cells_only)
        if rows and rows[0] < len(names):
            picked(names[rows[0]])

    return act


def fresh_key(key: str, names: Sequence[Any], at: Any) -> str:
    """A key with which a table begins anew once something else is looked at than was clicked in it.

    Else a second click on that row would do nothing: the browser reports only what changes.

    Parameters
    ----------
    names : sequence
        Of the rows.
    at : Any
        The name of what is looked at; None where that has no meaning.
    """
    key = f"{key}-{hash(tuple(names))}"  # other rows begin without a selection
    turn = f"{key}-turn"
    rows = _selected_rows(f"{key}-{st.session_state.get(turn, 0)}")
    if at is not None and rows and rows[0] < len(names) and names[rows[0]] != at:
        st.session_state[turn] = st.session_state.get(turn, 0) + 1
    return f"{key}-{st.session_state.get(turn, 0)}"


def clickable_chart(figure: Any, key: str, picked: Picked, config: Mapping[str, Any], above: int = 0) -> None:
    """A chart whose points carry a name as `customdata`, which is passed on where one is clicked.

    Parameters
    ----------
    above : int
        Pixels of the screen that other things need, where the chart may take the rest, up to twice its own height.
    """

    def act() -> None:
        carried = [point["customdata"] for point in _selection(key).get("points") or () if point.get("customdata")]
        if carried:
            first = carried[0]
            picked(first[0] if isinstance(first, (list, tuple)) and len(first) == 1 else first)

    height = int(figure.layout.height)
    with room(key, height, 2 * height, above) if above else nullcontext():
        st.plotly_chart(
            figure, key=key, on_select=act, selection_mode="points", config=dict(config),
            height="stretch" if above else "content",
        )  # fmt: skip


def _selected_rows(key: str, cells_only: bool = False) -> list[int]:
    selection = _selection(key)
    rows = [cell[0] for cell in selection.get("cells") or ()]
    return rows if rows or cells_only else list(selection.get("rows") or ())


def _selection(key: str) -> Mapping[str, Any]:
    state = st.session_state.get(key)
    return state["selection"] if state else {}

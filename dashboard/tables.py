"""Tables whose numbers and times are written as the person is used to, and still sort as numbers and times."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from typing import Any, Literal

import pandas as pd
import streamlit as st
from pandas.io.formats.style import Styler

from dashboard.findings import feature_words
from dashboard.locale import NOTHING, Locale
from dashboard.palette import decision_words, quantity_words
from dashboard.picking import Picked, clicked_row, fresh_key
from dashboard.room import room
from dashboard.words import N_, _
from metrology.kinds import KINDS

_SIGNED = (
    "value_mm",
    "before_mm",
    "difference_mm",
    "margin",
    "deviation_mm",
    *(quantity.column for kind in KINDS for quantity in kind.quantities if quantity.signed),
)


_REASON_PX, _WIDE_REASON_PX, _VERDICT_PX, _FEATURE_PX = 200, 540, 145, 118
_LETTER_PX, _MOST_FEATURE_PX = 6.6, 150
_ANY_HEIGHT = 10_000


def show_table(
    rows: pd.DataFrame,
    columns: Mapping[str, str],
    locale: Locale,
    key: str,
    height: int = 400,
    names: Sequence[Any] = (),
    picked: Picked | None = None,
    at: Any = None,
    above: int = 0,
) -> None:
    """Show columns of a frame under their headings.

    Parameters
    ----------
    columns : mapping of str to str
        Column to heading, in order; columns that the frame lacks are left out.
    names : sequence, optional
        Of the rows, where they can be picked.
    picked : callable, optional
        Gets the name of a row that is clicked.
    at : optional
        The name of what is looked at.
    above : int
        Pixels of the screen that other things need, where the table takes the rest of a screen that is high enough.
    """
    styled, config = styled_table(rows, columns, locale, _WIDE_REASON_PX if above else _REASON_PX)
    options: dict[str, Any] = {}
    if picked:
        key = fresh_key(key, names, at)
        options = {
            "on_select": clicked_row(key, names, picked),
            "selection_mode": ["single-row", "single-cell"],
        }
    height = fitting(height, len(rows))
    with room(key, height, fitting(_ANY_HEIGHT, len(rows)), above) if above else nullcontext():
        st.dataframe(
            styled,
            hide_index=True,
            height="stretch" if above else height,
            column_config=config,
            key=key,
            placeholder=NOTHING,
            **options,
        )


def styled_table(
    rows: pd.DataFrame, columns: Mapping[str, str], locale: Locale, reason_px: int = _REASON_PX
) -> tuple[Any, dict[str, Any]]:
    """Columns of a frame under their headings, written as the person is used to, and how to lay them out."""
    present = {name: heading for name, heading in columns.items() if name in rows.columns}
    shown = rows[list(present)].rename(columns=present).reset_index(drop=True)
    formats = {heading: _writer(name, rows[name], locale) for name, heading in present.items()}
    for heading, write in formats.items():
        # Words are the cell itself: what is copied out of the table, or read aloud, says them, too.
        if write is not None and _is_text(shown[heading]):
            shown[heading] = [None if empty else write(value) for value, empty in _cells(shown[heading])]
    styled = _in_words(shown, {h: f for h, f in formats.items() if f is not None and not _is_text(shown[h])})
    config = {
        heading: st.column_config.Column(width=width, help=_(_HELP[name]) if name in _HELP else None)
        for name, heading in present.items()
        if (width := _width(name, reason_px, shown[heading])) != "small" or name in _HELP
    }
    return styled, config


def _in_words(rows: pd.DataFrame, writers: Mapping[str, Callable[[object], str]]) -> Styler:
    """A frame, numbered from 0, with each of its cells in words, and no style.

    pandas prepares a page of HTML from all that a cell may be given, of which Streamlit takes the words alone: for 500
    rows that is half of what a list costs. (Streamlit knows a Styler by its name, so it cannot be a class of ours.)
    """

    def words_of(column: int) -> list[dict[str, str]]:
        values = rows.iloc[:, column]
        # A cell that is left out is shown as it is: words need no words.
        write = writers.get(str(rows.columns[column]), None if _is_text(values) else str)
        return [
            {"id": f"row{row}_col{column}", "display_value": NOTHING if empty or write is None else write(value)}
            for row, (value, empty) in enumerate(_cells(values))
            if empty or write is not None
        ]

    def translated(*_options: bool) -> dict[str, Any]:
        return {"body": [words_of(column) for column in range(len(rows.columns))]}

    styler = rows.style
    styler._translate = translated
    return styler


def _cells(values: pd.Series) -> Iterator[tuple[Any, bool]]:
    """Each value, and whether there is none."""
    return zip(values.tolist(), values.isna().tolist(), strict=True)  # a column's own iterator takes ten times as long


def _is_text(values: pd.Series) -> bool:
    return bool(pd.api.types.is_string_dtype(values.dtype) or values.dtype == object)


def _width(name: str, reason_px: int, cells: pd.Series) -> int | Literal["small"]:
    """Of a column, px: reasons have what is left, and a verdict has room for its words where they have room."""
    if name == "reason":
        return reason_px
    if name == "feature_id" and reason_px != _WIDE_REASON_PX:
        longest = max((len(str(cell)) for cell in cells), default=0)
        return max(_FEATURE_PX, min(_MOST_FEATURE_PX, round(_LETTER_PX * longest) + 20))
    return _VERDICT_PX if name == "decision" and reason_px == _WIDE_REASON_PX else "small"


_WORDS = ("state", "disposition", "rig_verdict", "status", "what", "kind", "change", "verdict")
"""Columns of words that have a translation."""
_HELP = {
    "value_mm": N_("Height of a rivet head, + proud of the skin; step of a seam, side B above side A"),
    "u95_mm": N_("Uncertainty: in 95 of 100 cases the true value lies within ± this"),
    "margin": N_("Distance to the nearest limit, mm (tilt: °): negative beyond it"),
    "waiting": N_("Findings that nobody decided, and those whose rework, repair or re-scan is not done"),
    "open_work": N_("Of those waiting: rework, repair or re-scan was decided and is not done yet"),
    "worst_mm": N_("Largest |height| or |step| among what does not simply pass"),
}


def fitting(height: int, rows: int) -> int:
    """No taller than the rows need."""
    return min(height, 38 + 35 * max(1, rows))


def _writer(name: str, values: pd.Series, locale: Locale) -> Callable[[object], str] | None:
    if name.startswith("decision"):
        return decision_words
    if name == "quantity":
        return lambda value: quantity_words(str(value))
    if name in ("reason", "why"):
        return locale.reason
    if name in ("feature_id", "feature"):
        return lambda value: feature_words(str(value), locale)
    if name in _WORDS:
        return lambda value: _(str(value))
    if isinstance(values.dtype, pd.DatetimeTZDtype):
        return locale.time
    if pd.api.types.is_integer_dtype(values.dtype):
        return locale.whole
    if pd.api.types.is_float_dtype(values.dtype):
        return partial(locale.number, digits=_digits(name), sign=name.rstrip("0123456789").removesuffix("_") in _SIGNED)
    return None


_PLACES = ("s_mm", "from_mm", "to_mm", "length_mm")
"""Of which a tenth of a millimetre says enough."""


def _digits(name: str) -> int:
    if name.startswith("seconds") or name.endswith("_deg"):
        return 2
    if name.endswith(("_px", "_fraction")):
        return 3
    return 1 if name in _PLACES else 0 if name.startswith("n_") else 3

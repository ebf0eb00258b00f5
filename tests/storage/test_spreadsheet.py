"""Cells of CSV files: spreadsheets take none of them for a formula, and numbers stay numbers."""

from __future__ import annotations

import pytest

from storage.spreadsheet import harmless


@pytest.mark.parametrize(
    "text", ["=1+1", "+cmd", "-cmd|' /C calc'!A0", "@SUM(1)", "\t=1", "\r=1", "\n=1", "－1+1", "--1"]
)
def test_text_that_begins_like_a_formula_is_guarded(text: str) -> None:
    assert harmless(text) == f"'{text}"


@pytest.mark.parametrize("cell", [-0.012, -3, "-0.012", "+1,5", "-1e-3", "R01", "a=b", "", None, "0.1 - 0.2", True])
def test_everything_else_stays_as_it_is(cell: object) -> None:
    assert harmless(cell) is cell

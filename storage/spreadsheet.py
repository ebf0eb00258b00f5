"""CSV that people open in a spreadsheet: cells that it cannot take for formulas, text that it reads as UTF-8."""

from __future__ import annotations

import re

ENCODING = "utf-8-sig"
"""Of CSV files: without the byte-order mark spreadsheets take them for the computer's old code page."""

# The wide forms are taken for formulas in East Asian settings.
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")
_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:[.,][0-9]*)?|[.,][0-9]+)(?:[eE][+-]?[0-9]+)?")


def harmless(cell: object) -> object:
    """A cell as every CSV has it: text that a spreadsheet would run as a formula gets an apostrophe before it.

    Numbers stay numbers, also those that come as text.
    """
    if not isinstance(cell, str) or not cell.startswith(_FORMULA) or _NUMBER.fullmatch(cell):
        return cell
    return f"'{cell}"

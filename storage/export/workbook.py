"""Workbooks (XLSX): cells of their own type, so that numbers are numbers in every language's spreadsheet."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrology.errors import UsageError

if TYPE_CHECKING:
    from xlsxwriter.format import Format
    from xlsxwriter.worksheet import Worksheet

MOST_ROWS = 1_048_575  # of a sheet, below its heads
_MOST_CHARACTERS = 32_767  # of a cell
_MOST_WHOLE = 2**53  # a greater whole number would lose digits
_DIGITS = {"mm": "0.0000", "deg": "0.000", "px": "0.00", "°": "0.000", "s": "0.00"}
_TIME = "yyyy-mm-dd hh:mm:ss"


@dataclass(frozen=True)
class SheetColumn:
    """A column of a sheet: its head, its unit ("" where it has none), and what it means."""

    head: str
    unit: str = ""
    meaning: str = ""


@dataclass(frozen=True)
class Sheet:
    """A sheet: lines above the table, heads, rows."""

    name: str
    columns: Sequence[SheetColumn]
    rows: Iterable[Sequence[object]]
    above: Sequence[Sequence[object]] = ()


def write_workbook(path: Path, sheets: Sequence[Sheet], created: datetime) -> None:
    """Write a workbook; every table has a filter, and heads that stay in sight.

    Parameters
    ----------
    created : datetime
        What the file gives as its time: of the data, so that the same data give the same file.
    """
    import xlsxwriter

    options = {"strings_to_formulas": False, "strings_to_urls": False, "strings_to_numbers": False}
    with xlsxwriter.Workbook(str(path), options) as book:
        book.set_properties({"created": created.astimezone(UTC).replace(tzinfo=None)})
        bold, time = book.add_format({"bold": True}), book.add_format({"num_format": _TIME})
        numbers = {unit: book.add_format({"num_format": digits}) for unit, digits in _DIGITS.items()}
        for sheet in sheets:
            _write_sheet(book.add_worksheet(sheet.name), sheet, bold, time, numbers)


def _write_sheet(page: Worksheet, sheet: Sheet, bold: Format, time: Format, numbers: dict[str, Format]) -> None:
    for line, cells in enumerate(sheet.above):
        for place, cell in enumerate(cells):
            _write_cell(page, line, place, cell, time if isinstance(cell, datetime) else (None if place else bold))
    first = len(sheet.above)
    for place, column in enumerate(sheet.columns):
        page.write_string(first, place, column.head, bold)
        page.set_column(place, place, min(40, max(10, len(column.head) + 2)))
    looks = [numbers.get(column.unit) for column in sheet.columns]
    line = first
    for line, row in enumerate(sheet.rows, first + 1):
        if line - first > MOST_ROWS:
            raise UsageError(
                f"{sheet.name}: found more than {MOST_ROWS} rows, expected no more in a workbook; use Parquet"
            )
        for place, cell in enumerate(row):
            if cell is not None:
                _write_cell(page, line, place, cell, time if isinstance(cell, datetime) else looks[place])
    page.freeze_panes(first + 1, 0)
    page.autofilter(first, 0, max(line, first), max(0, len(sheet.columns) - 1))


def _write_cell(page: Worksheet, line: int, place: int, cell: object, look: Format | None) -> None:
    value = cell_value(cell)
    kind = type(value)
    if kind is str:
        if value:
            page.write_string(line, place, value)
    elif kind is float or kind is int:
        page.write_number(line, place, value, look)
    elif kind is bool:
        page.write_boolean(line, place, value)
    elif value is not None:
        page.write_datetime(line, place, value, look)


def cell_value(value: Any) -> Any:
    """A value as a spreadsheet has it: times in UTC without a zone, no number that is not finite, lists as text."""
    kind = type(value)
    if kind is str:
        return value if len(value) <= _MOST_CHARACTERS else f"{value[: _MOST_CHARACTERS - 1]}…"
    if kind is float:
        return value if math.isfinite(value) else None
    if value is None or kind is bool:
        return value
    if kind is int:
        return value if abs(value) <= _MOST_WHOLE else str(value)
    if isinstance(value, datetime):
        return value.astimezone(UTC).replace(tzinfo=None) if value.tzinfo else value
    if isinstance(value, date):
        return value
    if isinstance(value, Decimal):
        return cell_value(int(value) if value == value.to_integral_value() else float(value))
    return cell_value("; ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value))

"""CSV whose numbers are numbers where it is opened: with points and commas, or with commas and semicolons."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path

from storage.documents import utc_text
from storage.export.formats import Decimal
from storage.export.workbook import cell_value
from storage.spreadsheet import ENCODING, harmless


def write_delimited(path: Path, heads: Sequence[str], rows: Iterable[Sequence[object]], decimal: Decimal) -> None:
    """Write rows under a head line; what was not measured is an empty cell, times are ISO 8601 in UTC.

    Parameters
    ----------
    decimal : "point" or "comma"
        Between a number's whole part and the rest; with a comma cells are parted by semicolons.
    """
    with path.open("w", encoding=ENCODING, newline="") as file:
        writer = csv.writer(file, delimiter=";" if decimal == "comma" else ",")
        writer.writerow([harmless(head) for head in heads])
        writer.writerows([_cell(cell, decimal) for cell in row] for row in rows)


def _cell(cell: object, decimal: Decimal) -> object:
    kind = type(cell)
    if cell is None or kind is int:
        return cell
    if kind is str:
        return harmless(cell)
    if isinstance(cell, datetime):
        return utc_text(cell) if cell.tzinfo else cell.isoformat()
    if isinstance(cell, (list, tuple, dict)):
        return json.dumps(cell, ensure_ascii=False, default=str)
    value = cell_value(cell)
    return repr(value).replace(".", ",") if decimal == "comma" and isinstance(value, float) else value

"""Rows of a report as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from storage.documents import utc_text
from storage.spreadsheet import harmless


def rows_csv(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> str:
    """CSV (RFC 4180) with a head line; what was not measured is an empty cell, times are ISO 8601 in UTC."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow([harmless(column) for column in columns])
    for row in rows:
        writer.writerow([_cell(row[column]) for column in columns])
    return text.getvalue()


def _cell(value: object) -> object:
    if isinstance(value, datetime):
        return utc_text(value)
    return "" if value is None else harmless(value)

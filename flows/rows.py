"""Rows of a query as text: a table for people, CSV, or JSON objects."""

from __future__ import annotations

import codecs
import csv
import io
import json
import math
from collections import Counter
from collections.abc import Iterator
from datetime import UTC, date, datetime, time
from decimal import Decimal
from typing import IO, TYPE_CHECKING, Any, Literal

from metrology.errors import StoreError
from storage.archive.statements import check_one_statement, query_problem
from storage.spreadsheet import harmless

if TYPE_CHECKING:
    import duckdb

RowFormat = Literal["table", "csv", "json"]
_CHUNK = 10_000
_TABLE_ROWS = 1000


def run_query(connection: duckdb.DuckDBPyConnection, sql: str) -> duckdb.DuckDBPyConnection:
    """Run a query; its rows are still to be fetched."""
    import duckdb

    try:
        check_one_statement(connection, sql)
        return connection.execute(sql)
    except duckdb.Error as problem:
        raise StoreError(f"query: {query_problem(problem)}") from None


def write_rows(
    result: duckdb.DuckDBPyConnection, row_format: RowFormat, output: IO[bytes], to_file: bool = False
) -> None:
    """Write the rows of a query as they come.

    Parameters
    ----------
    to_file : bool
        Whether people will open what is written: CSV then begins with a byte-order mark, which programs that read it
        from a pipe would take for a part of the first name.
    """
    import duckdb

    try:
        names = [column[0] for column in result.description or ()]
        writer = {"table": _write_table, "csv": _write_csv, "json": _write_json}[row_format]
        if to_file and row_format == "csv":
            output.write(codecs.BOM_UTF8)
        writer(names, _rows(result), output)
    except duckdb.Error as problem:
        raise StoreError(f"query: {query_problem(problem)}") from None


def _rows(result: duckdb.DuckDBPyConnection) -> Iterator[tuple[Any, ...]]:
    while chunk := result.fetchmany(_CHUNK):
        yield from chunk


def plain(value: Any) -> Any:
    """A value as JSON has it: times in ISO 8601 (UTC with a Z), what is not a finite number as null."""
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat().replace("+00:00", "Z") if value.tzinfo else value.isoformat()
    if isinstance(value, (date, time)):
        return value.isoformat()
    if isinstance(value, Decimal):
        return int(value) if value == value.to_integral_value() else float(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(inner) for inner in value]
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)


def _write_json(names: list[str], rows: Iterator[tuple[Any, ...]], output: IO[bytes]) -> None:
    twice = sorted(name for name, times in Counter(names).items() if times > 1)
    if twice:
        raise StoreError(f"query: found several columns {twice[0]!r}, expected names of their own (… AS name) for JSON")
    output.write(b"[")
    for index, row in enumerate(rows):
        document = {name: plain(value) for name, value in zip(names, row, strict=True)}
        output.write((",\n" if index else "\n").encode() + json.dumps(document, ensure_ascii=False).encode())
    output.write(b"\n]\n")


def _write_csv(names: list[str], rows: Iterator[tuple[Any, ...]], output: IO[bytes]) -> None:
    text = io.TextIOWrapper(output, encoding="utf-8", newline="", write_through=True)
    writer = csv.writer(text)
    writer.writerow([harmless(name) for name in names])
    for row in rows:
        cells = [plain(value) for value in row]
        writer.writerow(
            [json.dumps(c, ensure_ascii=False) if isinstance(c, (dict, list)) else harmless(c) for c in cells]
        )
    text.detach()


def _write_table(names: list[str], rows: Iterator[tuple[Any, ...]], output: IO[bytes]) -> None:
    cells: list[list[str]] = []
    numeric, more = [True] * len(names), 0
    for row in rows:
        if len(cells) == _TABLE_ROWS:
            more += 1
            continue
        cells.append([_cell(value) for value in row])
        numeric = [n and (v is None or isinstance(v, (int, float, Decimal))) for n, v in zip(numeric, row, strict=True)]
    widths = [max(map(len, column)) for column in zip(names, *cells, strict=True)]
    lines = ["  ".join(name.ljust(width) for name, width in zip(names, widths, strict=True)).rstrip()]
    lines.append("  ".join("─" * width for width in widths))
    for row_cells in cells:
        aligned = [
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(row_cells, widths, numeric, strict=True)
        ]
        lines.append("  ".join(aligned).rstrip())
    if more:
        lines.append(f"… and {more} more; --format csv writes them all")
    lines.append(f"{len(cells) + more} row{'' if len(cells) + more == 1 else 's'}")
    output.write(("\n".join(lines) + "\n").encode())


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.6g}" if math.isfinite(value) else str(value)
    shown = plain(value)
    return json.dumps(shown, ensure_ascii=False) if isinstance(shown, (dict, list)) else str(shown)

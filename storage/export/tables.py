"""The tables themselves, and the rows of a query: workbook, CSV, Parquet. A column is mapped by its declaration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from metrology.kinds import KINDS
from storage.archive.schema import OF_KIND, SCENES, Table
from storage.export.delimited import write_delimited
from storage.export.formats import Place
from storage.export.subject import Subject
from storage.export.traceability import traceability_sheet
from storage.export.workbook import Sheet, SheetColumn, write_workbook

_UNITS = ("mm", "deg", "px")
_EPOCH = datetime(2000, 1, 1, tzinfo=UTC)


def write_xlsx(subject: Subject, place: Place) -> list[Path]:
    """One workbook with a sheet for each table, one with what they rest on, and one with what the columns mean."""
    path = place.file(".xlsx")
    sheets = [
        Sheet(table.name, _sheet_columns(table), [[row.get(c.name) for c in table.columns] for row in rows])
        for table, rows in _tables(subject)
    ]
    sheets.append(traceability_sheet(subject, place.store))
    write_workbook(path, [*sheets, _meanings(sheets)], max(scene.row["captured_at"] for scene in subject.scenes))
    return [path]


def write_csv(subject: Subject, place: Place) -> list[Path]:
    """One CSV for each table."""
    written = []
    for table, rows in _tables(subject):
        names = [column.name for column in table.columns]
        path = place.file(f"-{table.name}.csv")
        write_delimited(path, names, ([row.get(name) for name in names] for row in rows), place.decimal)
        written.append(path)
    return written


def write_parquet(subject: Subject, place: Place) -> list[Path]:
    """One Parquet file for each table."""
    written = []
    for table, rows in _tables(subject):
        path = place.file(f"-{table.name}.parquet")
        pq.write_table(pa.Table.from_pylist([dict(row) for row in rows], table.arrow_schema), path)
        written.append(path)
    return written


def query_xlsx(rows: pa.Table, place: Place) -> list[Path]:
    """The rows of a query as a workbook."""
    path = place.file(".xlsx")
    columns = [SheetColumn(name, unit_of(name)) for name in rows.column_names]
    write_workbook(path, [Sheet("query", columns, _plain_rows(rows))], _EPOCH)
    return [path]


def query_csv(rows: pa.Table, place: Place) -> list[Path]:
    """The rows of a query as CSV."""
    path = place.file(".csv")
    write_delimited(path, rows.column_names, _plain_rows(rows), place.decimal)
    return [path]


def query_parquet(rows: pa.Table, place: Place) -> list[Path]:
    """The rows of a query as Parquet."""
    path = place.file(".parquet")
    pq.write_table(rows, path)
    return [path]


def unit_of(column: str) -> str:
    """The unit that a column's name ends in; "" where it has none."""
    unit = column.rpartition("_")[2]
    return unit if unit in _UNITS or column.startswith("seconds_") else ""


def _tables(subject: Subject) -> Iterator[tuple[Table, Sequence[Any]]]:
    """Every table with the subject's rows of it: scenes, and then the kinds of features."""
    yield SCENES, [scene.row for scene in subject.scenes]
    for kind in KINDS:
        yield OF_KIND[kind.name], [row for scene in subject.scenes for row in scene.features[kind.name]]


def _sheet_columns(table: Table) -> list[SheetColumn]:
    return [SheetColumn(column.name, unit_of(column.name), column.comment) for column in table.columns]


def _meanings(sheets: Sequence[Sheet]) -> Sheet:
    rows = [(sheet.name, column.head, column.unit, column.meaning) for sheet in sheets for column in sheet.columns]
    return Sheet("columns", [SheetColumn(head) for head in ("table", "column", "unit", "meaning")], rows)


def _plain_rows(rows: pa.Table) -> Iterator[Sequence[object]]:
    """Rows of Python values; columns may have the same name."""
    for batch in rows.to_batches(10_000):
        yield from zip(*(column.to_pylist() for column in batch.columns), strict=True)

"""Rows of the archive: as mappings, and as the results that they were stored from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar

from metrology.results import Feature

if TYPE_CHECKING:
    import duckdb

Row = TypeVar("Row", bound=Feature)


def named_rows(
    connection: duckdb.DuckDBPyConnection, sql: str, parameters: Sequence[object] = ()
) -> list[dict[str, Any]]:
    """The rows that a query gives, each by the names of its columns."""
    result = connection.execute(sql, list(parameters))
    names = [column[0] for column in result.description or ()]
    return [dict(zip(names, row, strict=True)) for row in result.fetchall()]


def result_of(kind: type[Row], row: Mapping[str, Any]) -> Row:
    """A feature from its row; what is NaN or lacks in an older table is None."""
    return kind(**{f.name: _given(row.get(f.name)) for f in fields(kind)})


def _given(value: Any) -> Any:
    return None if isinstance(value, float) and value != value else value

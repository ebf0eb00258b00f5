"""Rows of the archive's tables as the results that they were stored from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar

from metrology.kinds import KINDS
from metrology.results import Feature

if TYPE_CHECKING:
    import duckdb

    from storage.archive.store import Store

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


def features_of(store: Store, scenes: Sequence[str]) -> dict[str, dict[str, list[Any]]]:
    """Each scan's features by kind, as its current run has them, in the order of their ids."""
    found: dict[str, dict[str, list[Any]]] = {scene: {kind.name: [] for kind in KINDS} for scene in scenes}
    asked = ", ".join("?" * len(scenes))
    for kind in KINDS:
        for row in store.query(f"FROM {kind.table} WHERE scene_id IN ({asked}) ORDER BY ALL", scenes).to_pylist():
            found[row["scene_id"]][kind.name].append(result_of(kind.row_type, row))
    return found


def _given(value: Any) -> Any:
    return None if isinstance(value, float) and value != value else value

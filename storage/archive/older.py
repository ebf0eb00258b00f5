"""An index of another version that may not be changed, read with this version's columns: what it lacks is NULL."""

from __future__ import annotations

import duckdb

from metrology.errors import StoreError
from storage.archive import bookkeeping, schema, views
from storage.archive.schema import Table


def cover(connection: duckdb.DuckDBPyConnection) -> None:
    """Let the names of this version's tables and views lead to all their columns, in this connection alone."""
    try:
        [(database,)] = connection.execute("SELECT current_database()").fetchall()
        held = {table.name: {column.name for column in table.columns} for table in bookkeeping.structure(connection)}
        for table in schema.TABLES:
            _create(connection, table.name, _query(table, held.get(table.name), f'"{database}".main.{table.name}'))
        for view in views.VIEWS:
            _create(connection, view.name, view.query)
    except duckdb.Error as problem:
        raise StoreError(
            f"archive: found {str(problem).splitlines()[0]}, expected the tables of this version; 'flushline archive "
            "rebuild' makes them where the store can be written"
        ) from None


def _query(table: Table, held: set[str] | None, place: str) -> str:
    """The rows of a table with all columns of this version; none where the index has no such table."""
    lacking = [
        f"NULL::{column.sql_type} AS {column.name}" for column in table.columns if column.name not in (held or ())
    ]
    if held is None:
        return f"SELECT {', '.join(lacking)} WHERE false"
    return f"SELECT {', '.join(['*', *lacking])} FROM {place}"


def _create(connection: duckdb.DuckDBPyConnection, name: str, query: str) -> None:
    connection.execute(f"CREATE OR REPLACE TEMP VIEW {name} AS {query}")

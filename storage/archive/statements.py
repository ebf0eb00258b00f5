"""SQL that people ask: one statement, and what DuckDB says against it in one line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrology.errors import StoreError

if TYPE_CHECKING:
    import duckdb


def query_problem(problem: duckdb.Error) -> str:
    """What DuckDB says of a query, in one line."""
    text = " ".join(str(problem).split())
    if "attached in read-only mode" in text:
        return "found a statement that writes to the read-only archive, expected a SELECT"
    return text


def check_one_statement(connection: duckdb.DuckDBPyConnection, sql: str) -> None:
    """Refuse SQL of several statements, of which only the last one's rows would be seen, and of none."""
    found = len(connection.extract_statements(sql))
    if not found:
        raise StoreError("query: found no statement, expected a SELECT")
    if found > 1:
        raise StoreError(f"query: found {found} statements, expected a SELECT alone: ask one after the other")

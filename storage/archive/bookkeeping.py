"""What an index says about itself, in its schema `bookkeeping`: which versions' tables it has, and digests of its runs.

An index has the tables, columns and views of every version that ever wrote into it. A version adds what it misses and
takes nothing away, so versions can share a store and what one of them stored is never lost to the others.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version as installed_version

import duckdb

from metrology.errors import StoreError
from storage.archive import schema, views
from storage.archive.schema import Column, Table

VERSIONS = Table(
    "bookkeeping.versions",
    "One row per set of tables and views that this index has",
    (
        Column("schema_hash", "VARCHAR", "names the tables and views of a version"),
        Column("version", "VARCHAR", "version of Flushline that has them"),
    ),
)
VIEWS_KEPT = Table(
    "bookkeeping.views",
    "One row per view, in the order in which they can be made",
    (
        Column("name", "VARCHAR", "name of the view"),
        Column("create_sql", "VARCHAR", "how it is made"),
        Column("position", "INTEGER", "place in the order"),
    ),
)
COLUMNS = Table(
    "bookkeeping.columns",
    "One row per column of every table",
    (
        Column("table_name", "VARCHAR", "name of the table"),
        Column("column_name", "VARCHAR", "name of the column"),
        Column(
            "addition",
            "INTEGER",
            "0 for a column that its table was made with, then one number for all that were added together",
        ),
    ),
)
RUNS = Table(
    "bookkeeping.runs",
    "One row per run whose rows are in this index",
    (
        Column("scene_id", "VARCHAR", "the scene"),
        Column("run_id", "VARCHAR", "the run"),
        Column("digest", "HUGEINT", "of the run's rows in all tables when they came in"),
    ),
)
HEADS = (schema.SCENES.name, schema.PANELS.name)
"""Tables with one row for each run that is shown."""
Additions = Mapping[str, Sequence[Sequence[str]]]
"""Columns by table, those that came together in one list."""


def own_schema() -> str:
    """Names the tables and views of this version."""
    return schema.schema_hash(*(view.create_sql for view in views.VIEWS))


def own_version() -> str:
    """This version of Flushline."""
    return installed_version("flushline")


def is_known(connection: duckdb.DuckDBPyConnection) -> bool:
    """Whether an index has this version's tables and views."""
    try:
        found = connection.execute("SELECT 1 FROM bookkeeping.versions WHERE schema_hash = ?", [own_schema()])
    except duckdb.CatalogException:
        return False
    return bool(found.fetchall())


def structure(connection: duckdb.DuckDBPyConnection) -> tuple[Table, ...]:
    """The tables of an index, whichever version made them."""
    rows = connection.execute(
        "SELECT t.table_name, t.comment, c.column_name, c.data_type, c.comment FROM duckdb_tables() t "
        "JOIN duckdb_columns() c USING (database_oid, schema_oid, table_oid) "
        "WHERE t.schema_name = 'main' AND NOT t.internal AND NOT t.temporary ORDER BY t.table_oid, c.column_index"
    ).fetchall()
    found: dict[tuple[str, str], list[Column]] = {}
    for table, comment, column, sql_type, meaning in rows:
        found.setdefault((table, comment or ""), []).append(Column(column, sql_type, meaning or ""))
    return tuple(Table(name, comment, tuple(columns)) for (name, comment), columns in found.items())


def bring_up_to_date(connection: duckdb.DuckDBPyConnection) -> bool:
    """Give an index this version's tables, columns and views beside those it has; False where it had them."""
    if is_known(connection):
        return False
    connection.execute("BEGIN")
    adopted = not _has_bookkeeping(connection)
    if adopted:
        _make_bookkeeping(connection)
    _add_tables(connection, schema.TABLES)
    _make_views(connection)
    _note_version(connection)
    if adopted:  # an index that was made before indexes kept digests
        digests = digests_sql(additions(connection), lambda table: table)
        connection.execute(
            f"INSERT INTO {RUNS.name} SELECT scene_id, run_id, digest FROM scenes JOIN ({digests}) USING (scene_id)"
        )
    connection.execute("COMMIT")
    return True


def start(connection: duckdb.DuckDBPyConnection, former: duckdb.DuckDBPyConnection | None = None) -> None:
    """Make the tables and views of a new index: this version's, and what a former one has of others."""
    connection.execute("BEGIN")
    _make_bookkeeping(connection)
    others: Sequence[Table] = ()
    if former and _has_bookkeeping(former):
        noted = {(table, name) for table, groups in additions(former).items() for group in groups for name in group}
        others = tuple(
            replace(table, columns=tuple(column for column in table.columns if (table.name, column.name) in noted))
            for table in structure(former)
        )
        for table in (VERSIONS, VIEWS_KEPT):
            for row in former.execute(f"FROM {table.name}").fetchall():
                connection.execute(f"INSERT INTO {table.name} VALUES ({', '.join('?' * len(row))})", row)
    tables: Sequence[Table] = schema.TABLES
    if _is_older_than(connection):  # a newer version may have changed a column's type
        tables, others = others, tables
    _add_tables(connection, merged(tables, others))
    if not is_known(connection):
        _make_views(connection)
        _note_version(connection)
    else:
        for (create_sql,) in connection.execute(
            f"SELECT create_sql FROM {VIEWS_KEPT.name} ORDER BY position"
        ).fetchall():
            connection.execute(create_sql)
    connection.execute("COMMIT")


def merged(tables: Sequence[Table], others: Sequence[Table]) -> tuple[Table, ...]:
    """Tables with the columns that only the others have, and the tables that only the others have."""
    found = {table.name: table for table in tables}
    for other in others:
        table = found.get(other.name, Table(other.name, other.comment, ()))
        names = {column.name for column in table.columns}
        more = tuple(column for column in other.columns if column.name not in names)
        found[other.name] = replace(table, columns=table.columns + more)
    return tuple(found.values())


def additions(connection: duckdb.DuckDBPyConnection) -> dict[str, list[list[str]]]:
    """The columns of every table of an index, those that came together in one list."""
    try:
        rows = connection.execute("FROM bookkeeping.columns ORDER BY table_name, addition, column_name").fetchall()
    except duckdb.CatalogException:  # made before indexes kept books
        return {table.name: [sorted(column.name for column in table.columns)] for table in structure(connection)}
    found: dict[str, dict[int, list[str]]] = {}
    for table, column, addition in rows:
        found.setdefault(table, {}).setdefault(addition, []).append(column)
    return {table: list(by_number.values()) for table, by_number in found.items()}


def digests_sql(columns: Additions, source: Callable[[str], str]) -> str:
    """SELECT scene_id and digest of each scene's rows in all tables.

    A digest does not depend on the order of rows, nor on columns that were added later and hold nothing.

    Parameters
    ----------
    source : callable
        Where the rows of a table are to be found.
    """
    parts = [
        f"SELECT scene_id, {row_hash(table, groups)} AS h FROM {source(table)}" for table, groups in columns.items()
    ]
    return f"SELECT scene_id, sum(h)::HUGEINT AS digest FROM ({' UNION ALL '.join(parts)}) GROUP BY scene_id"


def row_hash(table: str, groups: Sequence[Sequence[str]]) -> str:
    """Of each row of a table; what holds nothing in all columns that were added together does not change it."""
    first, *later = groups
    terms = [f"hash({', '.join(first)}, '{table}')"]
    for names in later:
        nothing = " AND ".join(f"{name} IS NULL" for name in names)
        terms.append(f"if({nothing}, 0::UBIGINT, hash({', '.join(names)}, '{names[0]}'))")
    folded = terms[0]
    for term in terms[1:]:
        folded = f"xor({folded}, {term})"
    return folded


def row_digests(connection: duckdb.DuckDBPyConnection, columns: Additions | None = None) -> dict[str, int]:
    """Digests of the rows of an index as they are now, by scene; of these columns, as another index has them."""
    sql = digests_sql(columns or additions(connection), lambda table: table)
    return dict(connection.execute(sql).fetchall())


def kept_digests(connection: duckdb.DuckDBPyConnection) -> dict[str, int] | None:
    """Digests of the rows of an index as they came in, by scene; None where it keeps none."""
    if not _has_bookkeeping(connection):
        return None
    return dict(connection.execute(f"SELECT scene_id, digest FROM {RUNS.name}").fetchall())


def heads(connection: duckdb.DuckDBPyConnection) -> list[str]:
    """The tables with one row for each run that an index has; one of an older version has no panels."""
    held = additions(connection)  # DuckDB's own list takes it longer: it looks into every table
    return [table for table in HEADS if table in held]


def shown_runs(connection: duckdb.DuckDBPyConnection, scenes: Sequence[str] | None = None) -> dict[str, str]:
    """The run that an index shows of each scene and assembled panel, or of some."""
    parts = [
        f"SELECT scene_id, run_id FROM {table} WHERE $1 IS NULL OR scene_id IN (SELECT unnest($1))"
        for table in heads(connection)
    ]
    return dict(connection.execute(" UNION ALL ".join(parts), [scenes]).fetchall())


def imitate(connection: duckdb.DuckDBPyConnection, other: duckdb.DuckDBPyConnection) -> None:
    """Make empty tables as another index has them, whose digests come out as there."""
    connection.execute("CREATE SCHEMA bookkeeping")
    for table in (COLUMNS, RUNS, *structure(other)):
        connection.execute(table.plain_sql)
    for name, groups in additions(other).items():
        for number, group in enumerate(groups):
            _note_columns(connection, name, group, number)


def make_kept_views(connection: duckdb.DuckDBPyConnection, other: duckdb.DuckDBPyConnection) -> dict[str, str]:
    """Make the views that another index says it has; returns how, by name."""
    if not _has_bookkeeping(other):
        return {}
    kept = dict(other.execute(f"SELECT name, create_sql FROM {VIEWS_KEPT.name} ORDER BY position").fetchall())
    for create_sql in kept.values():
        connection.execute(create_sql)
    return kept


def is_only_own(connection: duckdb.DuckDBPyConnection) -> bool:
    """Whether no other version than this one brought its tables and views into an index."""
    return is_known(connection) and connection.execute(f"SELECT count(*) FROM {VERSIONS.name}").fetchall() == [(1,)]


def newest_version(connection: duckdb.DuckDBPyConnection) -> str:
    """The newest version that wrote into an index; empty where it does not say."""
    if not _has_bookkeeping(connection):
        return ""
    rows = connection.execute("SELECT version FROM bookkeeping.versions").fetchall()
    return max((str(version) for (version,) in rows), key=_order, default="")


def is_older(version: str, other: str) -> bool:
    """Whether a version came before another one."""
    return _order(version) < _order(other)


def _is_older_than(connection: duckdb.DuckDBPyConnection) -> bool:
    return is_older(own_version(), newest_version(connection))


def _order(version: str) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", version)]


def _has_bookkeeping(connection: duckdb.DuckDBPyConnection) -> bool:
    found = connection.execute(
        "SELECT 1 FROM duckdb_tables() WHERE schema_name = 'bookkeeping' AND table_name = 'runs'"
    )
    return bool(found.fetchall())


def _add_tables(connection: duckdb.DuckDBPyConnection, tables: Sequence[Table]) -> None:
    there = {table.name: {column.name: column.sql_type for column in table.columns} for table in structure(connection)}
    full_names = _full_names(connection, {column.sql_type for table in tables for column in table.columns})
    for table in tables:
        held = there.get(table.name)
        if held is None:
            connection.execute(table.create_sql)
            _note_columns(connection, table.name, [column.name for column in table.columns], 0)
            continue
        for column in table.columns:
            if column.name in held:
                _refuse_other_type(connection, table, column, held[column.name], full_names[column.sql_type])
        added = [column for column in table.columns if column.name not in held]
        for column in added:
            connection.execute(
                f"ALTER TABLE {table.name} ADD COLUMN {column.create_sql}; {column.comment_sql(table.name)}"
            )
        [(last,)] = connection.execute(
            "SELECT max(addition) FROM bookkeeping.columns WHERE table_name = ?", [table.name]
        ).fetchall()
        _note_columns(connection, table.name, [column.name for column in added], last + 1)


def _full_names(connection: duckdb.DuckDBPyConnection, sql_types: Collection[str]) -> dict[str, str]:
    """Types as an index lists them, by the names that tables are made with."""
    columns = ", ".join(f"typeof(NULL::{sql_type})" for sql_type in sql_types)
    return dict(zip(sql_types, connection.execute(f"SELECT {columns}").fetchall()[0], strict=True))


def _refuse_other_type(
    connection: duckdb.DuckDBPyConnection, table: Table, column: Column, found: str, expected: str
) -> None:
    if found != expected:
        raise StoreError(
            f"index: found {table.name}.{column.name} as {found}, as version {newest_version(connection) or '0.1.0'} "
            f"has it, expected {expected}; the newer one of the two versions makes the index again by "
            "'flushline archive rebuild'"
        )


def _note_columns(connection: duckdb.DuckDBPyConnection, table: str, names: Sequence[str], addition: int) -> None:
    connection.execute("INSERT INTO bookkeeping.columns SELECT $1, unnest($2), $3", [table, list(names), addition])


def _make_bookkeeping(connection: duckdb.DuckDBPyConnection) -> None:
    held = structure(connection)
    connection.execute("CREATE SCHEMA bookkeeping")
    for table in (VERSIONS, VIEWS_KEPT, COLUMNS, RUNS):
        connection.execute(table.create_sql)
    for table in held:
        _note_columns(connection, table.name, [column.name for column in table.columns], 0)


def _note_version(connection: duckdb.DuckDBPyConnection) -> None:
    connection.execute(f"INSERT INTO {VERSIONS.name} VALUES (?, ?)", [own_schema(), own_version()])


def _make_views(connection: duckdb.DuckDBPyConnection) -> None:
    """Make all views anew, as their tables may have more columns now; those of an older version give way."""
    rows = connection.execute("SELECT name, create_sql FROM bookkeeping.views ORDER BY position").fetchall()
    kept: dict[str, str] = dict(rows)
    own = {view.name: view.create_sql for view in views.VIEWS}
    # What one view selects from another stands before it in the list that it comes from.
    kept = {**own, **kept, **own} if not _is_older_than(connection) else {**kept, **own, **kept}
    connection.execute("DELETE FROM bookkeeping.views")
    for position, (name, create_sql) in enumerate(kept.items()):
        connection.execute(create_sql)
        connection.execute("INSERT INTO bookkeeping.views VALUES (?, ?, ?)", [name, create_sql, position])

"""flushline query: SQL over the archive, read-only."""

from __future__ import annotations

import argparse
import contextlib
import sys
from pathlib import Path


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `query`."""
    parser = commands.add_parser(
        "query",
        parents=[common],
        help="ask the archive in SQL",
        description="Runs a SQL query (DuckDB) over the tables scenes, rivets, seam_stations and the views on them. "
        "'SHOW TABLES' lists them, 'SELECT column_name, comment FROM duckdb_columns()' says what the columns mean.",
    )
    parser.add_argument("sql", metavar="SQL")
    parser.add_argument("--store", type=Path, required=True, metavar="DIR")
    parser.add_argument("--format", choices=("table", "csv", "json", "parquet"), default="table")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write there instead of to the terminal")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the query and print its rows."""
    from flows.rows import write_rows
    from metrology.errors import UsageError
    from storage.archive.store import Store

    if options.format == "parquet" and options.out is None and sys.stdout.isatty():
        raise UsageError("query: found Parquet for a terminal, expected --out FILE or a pipe")
    store = Store(options.store)
    with contextlib.ExitStack() as stack:
        output = stack.enter_context(options.out.open("wb")) if options.out else sys.stdout.buffer
        if options.format == "parquet":
            import pyarrow.parquet as pq

            pq.write_table(store.query(options.sql), output)
        else:
            connection = stack.enter_context(contextlib.closing(store.connect()))
            write_rows(connection, options.sql, options.format, output)
    return 0

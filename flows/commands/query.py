"""flushline query: SQL over the archive, read-only."""

from __future__ import annotations

import argparse
import contextlib
import sys
from pathlib import Path
from typing import IO, Literal, get_args

Format = Literal["table", "csv", "json", "parquet"]
FORMATS: tuple[Format, ...] = get_args(Format)


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `query`."""
    parser = commands.add_parser(
        "query",
        parents=[common],
        help="ask the archive in SQL",
        description="Runs a SQL query (DuckDB) over the tables scenes, rivets, seam_stations and the views on them, "
        "and over decisions, dispositions, limits, marks, rigs and verifications. "
        "'SHOW TABLES' lists them, 'SELECT column_name, comment FROM duckdb_columns()' says what the columns mean.",
    )
    parser.add_argument("sql", metavar="SQL")
    parser.add_argument("--store", type=Path, required=True, metavar="DIR")
    parser.add_argument(
        "--format", choices=FORMATS, help="default: what the ending of --out says, or else a table for people"
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="write there instead of to the terminal")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the query and print its rows."""
    from flows.rows import run_query, write_rows
    from metrology.errors import UsageError
    from storage.archive.store import Store
    from storage.archive.tables_beside import register_tables

    row_format: Format = options.format or _format_of(options.out)
    if row_format == "parquet" and options.out is None and sys.stdout.isatty():
        raise UsageError("query: found Parquet for a terminal, expected --out FILE or a pipe")
    store = Store(options.store)
    # The output is opened only when there is an answer: a query that is refused leaves the file as it was.
    if row_format == "parquet":
        import pyarrow.parquet as pq

        table = store.query(options.sql)
        with _output(options.out) as output:
            pq.write_table(table, output)
        return 0
    with contextlib.closing(store.connect()) as connection:
        register_tables(connection, store.root, options.sql)
        result = run_query(connection, options.sql)
        with _output(options.out) as output:
            write_rows(result, row_format, output, to_file=options.out is not None)
    return 0


def _output(out: Path | None) -> contextlib.AbstractContextManager[IO[bytes]]:
    return out.open("wb") if out else contextlib.nullcontext(sys.stdout.buffer)


def _format_of(out: Path | None) -> Format:
    ending = out.suffix[1:].lower() if out else ""
    return next((known for known in FORMATS if known == ending), "table")

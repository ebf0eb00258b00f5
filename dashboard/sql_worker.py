"""Runs one query for the SQL page in a process of its own, which can be stopped whatever the query does.

Reads {"store", "sql", "rows", "bytes", "seconds", "scratch", "server"} as JSON from standard input, writes an Arrow
stream to standard output. The connection is the store's: read-only, no files, no extensions, settings locked. The
process itself may write in its scratch folder only, may not take more than its share of memory, disk and time, gives
way to the pages, and ends with the server that started it. Where the kernel cannot keep it from writing elsewhere,
DuckDB gives up the file system altogether, and what does not fit in memory is refused instead of sorted on disk.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
from pathlib import Path
from typing import Any

from dashboard.confinement import die_with, write_only_in

MEMORY_BYTES = 4 << 30
SPILL_BYTES = 1 << 30
TRUNCATED = b"truncated"
_FAILED = 3
_MOST_SAID = 2000
_TOO_LARGE = "the query needs more memory than it may take; narrow it or add a LIMIT"
_SHORTAGES = ("Out of Memory", "bad_alloc")  # what DuckDB says where memory or the scratch folder is full
_NO_FILES = "LocalFileSystem has been disabled"


def main() -> int:
    """Run the query."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_FSIZE, (SPILL_BYTES, SPILL_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    request = json.load(sys.stdin)
    die_with(int(request["server"]))
    scratch = Path(request["scratch"])
    spill = scratch if write_only_in(scratch) else None
    try:
        _run(request, spill)
    except MemoryError:
        print(_TOO_LARGE, file=sys.stderr)
        return _FAILED
    except Exception as problem:  # DuckDB's errors are the person's to read
        text = str(problem) or type(problem).__name__
        if any(said in text for said in _SHORTAGES):
            text = _TOO_LARGE
        elif _NO_FILES in text:
            text = f"the query reads or writes files, which it may not, or {_TOO_LARGE.removeprefix('the query ')}"
        print(text[:_MOST_SAID], file=sys.stderr)
        return _FAILED
    return 0


def _run(request: dict[str, Any], spill: Path | None) -> None:
    import duckdb
    import pyarrow as pa

    from metrology.errors import UsageError
    from storage.archive.statements import query_problem
    from storage.archive.store import Store
    from storage.archive.tables_beside import register_tables

    root, most_rows, most_bytes = Path(request["store"]), int(request["rows"]), int(request["bytes"])
    connection = Store(root).connect(spill)
    register_tables(connection, root, request["sql"])
    signal.setitimer(
        signal.ITIMER_REAL, float(request["seconds"])
    )  # the signal ends the process, whatever DuckDB is at
    os.nice(10)  # from here on: a short query is mostly starting, which a busy machine must not draw out
    try:
        rows = connection.sql(request["sql"])
    except duckdb.InvalidInputException as problem:
        raise UsageError(query_problem(problem)) from None
    if rows is None:
        raise UsageError("this statement returns no rows; only SELECT and the like make sense here")
    table = rows.limit(most_rows + 1).to_arrow_table()
    truncated = table.num_rows > most_rows
    table = table.slice(0, most_rows)
    if table.nbytes > most_bytes:
        raise UsageError(
            f"the result has {table.nbytes >> 20} MB, more than the {most_bytes >> 20} MB that a page takes"
        )
    table = table.replace_schema_metadata({TRUNCATED: b"1" if truncated else b"0"})
    with pa.ipc.new_stream(sys.stdout.buffer, table.schema) as stream:
        stream.write_table(table)


if __name__ == "__main__":
    sys.exit(main())

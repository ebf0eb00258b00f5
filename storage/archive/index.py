"""The working index: one DuckDB file with all scenes' rows, changed only under the store's lock.

It can be made again from the bundles at any time. DuckDB allows one writing process or many reading ones, so nobody
opens this file but the writer: readers get published copies (see `snapshot`).
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import duckdb

from metrology.errors import StoreError
from storage.archive.bundle import BundleModel, check_bundle
from storage.archive.bundles import Bundles
from storage.archive.layout import Layout
from storage.archive.schema import TABLES
from storage.archive.signed import by_preference, signed_runs
from storage.archive.views import VIEWS
from storage.review import ReviewLog

# The newest format that released command-line clients of DuckDB 1.4 and later all read.
STORAGE_FORMAT = "v1.4.0"
_RUNS_PER_INSERT = 500


@contextlib.contextmanager
def writing(layout: Layout) -> Iterator[duckdb.DuckDBPyConnection]:
    """The working index, to be changed under the store's lock; where it is missing it is made from the bundles."""
    if not layout.work.exists():
        rebuild(layout)
    with connected(layout.work) as connection:
        yield connection


def discard(path: Path) -> None:
    """Remove a DuckDB file and its log."""
    for file in (path, path.with_name(path.name + ".wal")):
        file.unlink(missing_ok=True)


def current_runs(layout: Layout) -> tuple[list[Path], list[str]]:
    """The run of each scene that is to be shown, and what is damaged.

    That is the one that was signed off, else the newest; a damaged one gives way to the next.
    """
    newest: dict[Path, Path] = {}
    problems = []
    signed = signed_runs(ReviewLog(layout.root).read())
    bundles = Bundles(layout)
    for run in by_preference(bundles.runs(), signed):
        if run.parent in newest:
            continue
        try:
            bundles.bring(run, tables_only=True)
            check_bundle(run, only_tables=True)
        except StoreError as problem:
            problems.append(str(problem))
        else:
            newest[run.parent] = run
    return sorted(newest.values()), problems


def replace_run(
    connection: duckdb.DuckDBPyConnection, run: Path, manifest: BundleModel, signed: Mapping[str, str]
) -> bool:
    """Put a run's rows in place of those of its scene, all tables in one transaction.

    An older run changes nothing, nor does another one than that on which the scene was signed off.

    Parameters
    ----------
    signed : mapping
        The run that each signed-off scene was signed off on.
    """
    held = connection.execute("SELECT run_id FROM scenes WHERE scene_id = ?", [manifest.scene_id]).fetchone()
    if held and (held[0] >= manifest.run_id or manifest.scene_id in signed):
        return False
    connection.execute("BEGIN")
    try:
        for table in TABLES:
            connection.execute(f"DELETE FROM {table.name} WHERE scene_id = ?", [manifest.scene_id])
        _insert(connection, [run])
        connection.execute("COMMIT")
    except BaseException:
        with contextlib.suppress(duckdb.Error):
            connection.execute("ROLLBACK")
        raise
    return True


def rebuild(layout: Layout) -> list[str]:
    """Make the working index again from the bundles alone, under the store's lock; returns what is damaged."""
    runs, problems = current_runs(layout)
    partial = layout.work.with_suffix(".partial")
    discard(partial)
    try:
        with connected(partial) as connection:
            for made in (*TABLES, *VIEWS):
                connection.execute(made.create_sql)
            for start in range(0, len(runs), _RUNS_PER_INSERT):
                _insert(connection, runs[start : start + _RUNS_PER_INSERT])
        discard(layout.work)
        partial.rename(layout.work)
    finally:
        discard(partial)
    return problems


def fingerprint(connection: duckdb.DuckDBPyConnection) -> tuple[int, ...]:
    """Equal for two indexes that show the same runs with as many rows."""
    counts = [f"(SELECT count(*) FROM {table.name})" for table in TABLES]
    row = connection.execute(f"SELECT coalesce(sum(hash(scene_id, run_id)), 0), {', '.join(counts)} FROM scenes")
    return tuple(int(value) for value in row.fetchall()[0])


# The folders of a bundle are named by aircraft and panel, but not in Hive's way; every column is in the file.
_READ = "SELECT * FROM read_parquet(?, hive_partitioning = false, union_by_name = true)"


def _insert(connection: duckdb.DuckDBPyConnection, runs: Sequence[Path]) -> None:
    for table in TABLES:
        files = [str(run / f"{table.name}.parquet") for run in runs]
        connection.execute(f"INSERT INTO {table.name} BY NAME {_READ}", [files])


@contextlib.contextmanager
def connected(path: Path) -> Iterator[duckdb.DuckDBPyConnection]:
    """An index to be changed; what was changed is in the file itself in the end, not in a log beside it."""
    try:
        connection = duckdb.connect(str(path), config={"storage_compatibility_version": STORAGE_FORMAT})
    except duckdb.Error as problem:
        _refuse_full_disk(path, problem)
        raise StoreError(
            f"{path}: found a damaged index ({_first_line(problem)}), expected a DuckDB file; "
            "'flushline archive rebuild' makes it again"
        ) from None
    try:
        yield connection
        connection.execute("CHECKPOINT")
    except duckdb.Error as problem:
        _refuse_full_disk(path, problem)
        raise StoreError(f"{path}: found {_first_line(problem)}, expected the index to take the change") from problem
    finally:
        connection.close()


def _refuse_full_disk(path: Path, problem: duckdb.Error) -> None:
    """DuckDB says in words of its own what is an OSError elsewhere."""
    if os.strerror(errno.ENOSPC) in str(problem):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path)) from problem


def _first_line(problem: Exception) -> str:
    return str(problem).splitlines()[0]

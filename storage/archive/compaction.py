"""The tables as a few Parquet files, partitioned by aircraft, for engines other than DuckDB."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import duckdb

from metrology.errors import StoreError
from storage.archive import bookkeeping, generations
from storage.archive.bundles import Bundles
from storage.archive.files import disk_trouble, locked, make_folders, next_number, point_to, remove_database, sync
from storage.archive.layout import Layout
from storage.archive.loading import refuse_full_disk
from storage.archive.remote import Remote

_KEPT = 2


def compact(layout: Layout) -> Path | str:
    """Write the tables as Parquet; returns where.

    `parquet` in the store points to the newest; the one before stays for whoever reads it just now. Where the bundles
    lie on object storage, the files go there, too: into ``parquet/NAME``, which ``parquet/latest`` names.
    """
    with disk_trouble(layout.root, "parquet is as it was"), locked(layout.lock):
        place = Bundles(layout).target
        there = Remote(place) if place else None
        target = layout.index / f"parquet-{_number(layout, there):020d}"
        try:
            with _reading(layout) as connection:
                _write(connection, layout, target)
        except BaseException as problem:
            shutil.rmtree(target, ignore_errors=True)
            if isinstance(problem, duckdb.Error):
                refuse_full_disk(layout.index, problem)
            raise
        point_to(layout.parquet, target)
        for old in sorted(layout.index.glob("parquet-*"))[:-_KEPT]:
            shutil.rmtree(old)
        if there:
            _copy(target, there)
    return place or layout.parquet


def _number(layout: Layout, there: Remote | None) -> int:
    """Greater than that of everything compacted before, here and there."""
    names = there.folders("parquet") if there else []
    return max([next_number(layout.index, "parquet-*"), *(int(name) + 1 for name in names if name.isdecimal())])


@contextlib.contextmanager
def _reading(layout: Layout) -> Iterator[duckdb.DuckDBPyConnection]:
    """The published index, by a name of its own: under the one that readers use, DuckDB shares their settings."""
    last = generations.newest(layout)
    if last is None:
        raise StoreError(f"{layout.root}: found no archive.duckdb, expected a store that holds at least one scene")
    own = layout.index / ".compact.duckdb"
    remove_database(own)
    os.link(last, own)
    try:
        with contextlib.closing(duckdb.connect(str(own), read_only=True)) as connection:
            yield connection
    finally:
        remove_database(own)


def _write(connection: duckdb.DuckDBPyConnection, layout: Layout, target: Path) -> None:
    for table in bookkeeping.structure(connection):
        folder = target / table.name
        make_folders(folder, layout.root)
        place = str(folder).replace("'", "''")
        connection.execute(
            f"COPY (FROM {table.name} ORDER BY aircraft_serial, panel, captured_at) TO '{place}' "
            "(FORMAT parquet, COMPRESSION zstd, PARTITION_BY (aircraft_serial), WRITE_PARTITION_COLUMNS true)"
        )
    for path in target.rglob("*"):
        sync(path)


def _copy(source: Path, there: Remote) -> None:
    name = source.name.removeprefix("parquet-")
    for folder in sorted({path.parent for path in source.rglob("*.parquet")}):
        there.copy_files(sorted(folder.iterdir()), f"parquet/{name}/{folder.relative_to(source).as_posix()}")
    there.write("parquet/latest", name.encode())
    for old in there.folders("parquet")[:-_KEPT]:
        there.remove_folder(f"parquet/{old}")

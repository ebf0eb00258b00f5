"""The tables as a few Parquet files, partitioned by aircraft, for engines other than DuckDB."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import TYPE_CHECKING

from storage.archive import index
from storage.archive.bundles import Bundles
from storage.archive.files import disk_trouble, locked, make_folders, point_to, sync
from storage.archive.layout import Layout
from storage.archive.remote import Remote
from storage.archive.schema import TABLES

if TYPE_CHECKING:
    import duckdb

_KEPT = 2


def compact(layout: Layout) -> Path | str:
    """Write the tables as Parquet; returns where.

    `parquet` in the store points to the newest; the one before stays for whoever reads it just now. Where the bundles
    lie on object storage, the files go there, too: into ``parquet/NAME``, which ``parquet/latest`` names.
    """
    target = layout.index / f"parquet-{time.time_ns():020d}"
    with disk_trouble(layout.root, "parquet is as it was"), locked(layout.lock):
        try:
            with index.writing(layout) as connection:
                _write(connection, layout, target)
        except BaseException:
            shutil.rmtree(target, ignore_errors=True)
            raise
        point_to(layout.parquet, target)
        for old in sorted(layout.index.glob("parquet-*"))[:-_KEPT]:
            shutil.rmtree(old)
        if place := Bundles(layout).target:
            _copy(target, Remote(place))
            return place
    return layout.parquet


def _write(connection: duckdb.DuckDBPyConnection, layout: Layout, target: Path) -> None:
    for table in TABLES:
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

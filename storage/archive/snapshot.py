"""Published generations of the index: readers open an immutable copy, writers never disturb them.

Reconnecting to a replaced file while an old connection lives would return the old data (DuckDB keeps an instance per
path), therefore readers open the file that the link points to, not the link.
"""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import duckdb

from metrology.errors import StoreError
from storage.archive.files import copy_durably, locked, make_folders, point_to, protect
from storage.archive.layout import Layout

if TYPE_CHECKING:
    from storage.archive.recycle import News

KEPT_GENERATIONS = 3
_ATTEMPTS = 5
# Queries of people: no files, no extensions, no way to change that.
_CLOSED: dict[str, str | bool | int | float | list[str]] = {
    "enable_external_access": "false",
    "autoinstall_known_extensions": "false",
    "autoload_known_extensions": "false",
}
_SPILLING = {"memory_limit": "1GB", "max_temp_directory_size": "1GB"}
_closing = threading.Lock()


def publish(layout: Layout, news: News | None = None) -> None:
    """Publish the working index as it is; the caller holds the store's lock.

    Parameters
    ----------
    news : News, optional
        What the newest generation lacks, where that is known.
    """
    from storage.archive.recycle import discard, note, recycle

    make_folders(layout.generations, layout.root)
    target = layout.generations / f"archive-{time.time_ns():020d}.duckdb"
    generations = sorted(layout.generations.glob("archive-*.duckdb"))
    if not (news and len(generations) >= KEPT_GENERATIONS and recycle(layout, generations, news, target)):
        copy_durably(layout.work, target)
    if news:
        note(layout, target, news)
    # Whoever opens it for writing by mistake is refused instead of changing what others read.
    protect(target)
    point_to(layout.archive, target)
    for old in sorted(layout.generations.glob("archive-*.duckdb"))[:-KEPT_GENERATIONS]:
        discard(old)


def connect(layout: Layout, spill: Path | None = None) -> duckdb.DuckDBPyConnection:
    """A connection to the newest generation that can neither write nor reach other files; times are in UTC.

    Parameters
    ----------
    spill : Path, optional
        Folder for what does not fit in memory. DuckDB then keeps its way to the file system, which lets a query write
        beside the index: only for a process that the kernel keeps from writing elsewhere.
    """
    if not layout.archive.exists():
        raise StoreError(f"{layout.root}: found no archive.duckdb, expected a store that holds at least one scene")
    config = _CLOSED | (_SPILLING | {"temp_directory": str(spill)} if spill else {})
    for attempt in range(_ATTEMPTS):
        path = os.path.realpath(layout.archive)
        try:
            connection = duckdb.connect(path, read_only=True, config=config)
        except duckdb.Error as problem:
            # A generation may be removed between looking the link up and opening it.
            if attempt + 1 < _ATTEMPTS and (not Path(path).exists() or path != os.path.realpath(layout.archive)):
                continue
            if "Could not set lock" in str(problem) and os.access(layout.lock, os.W_OK):
                # Another program holds this generation open for writing: make one that nobody holds.
                with locked(layout.lock):
                    publish(layout)
                continue
            raise StoreError(f"{layout.archive}: found {_first_line(problem)}, expected a readable index") from None
        with _closing:  # connections to the same file in one process share its settings
            [(closed,)] = connection.execute("SELECT current_setting('lock_configuration')").fetchall()
            if not closed:
                connection.execute("SET GLOBAL TimeZone = 'UTC'")
                if spill is None:
                    connection.execute("SET disabled_filesystems = 'LocalFileSystem'")
                connection.execute("SET lock_configuration = true")
        return connection
    raise StoreError(
        f"{layout.archive}: found it replaced {_ATTEMPTS} times while opening it, expected a quieter store"
    )


def _first_line(problem: Exception) -> str:
    return str(problem).splitlines()[0]

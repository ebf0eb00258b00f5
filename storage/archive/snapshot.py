"""Reading the published index: readers open an immutable file, writers never disturb them.

Reconnecting to a replaced file while an old connection lives would return the old data (DuckDB keeps an instance per
path), therefore readers open the file that the link points to, not the link. DuckDB would replay a log that lies
beside a file; no generation has one, so a file with one is not opened.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path

import duckdb

from metrology.errors import StoreError
from storage.archive.files import companions, locked
from storage.archive.layout import Layout

_ATTEMPTS = 5
# Queries of people: no files, no extensions, no way to change that.
_CLOSED: dict[str, str | bool | int | float | list[str]] = {
    "enable_external_access": "false",
    "autoinstall_known_extensions": "false",
    "autoload_known_extensions": "false",
}
_SPILLING = {"memory_limit": "1GB", "max_temp_directory_size": "1GB"}
# The paths that DuckDB allows nevertheless are those of its own file and what lies beside it.
_NO_FILES = "SET disabled_filesystems = 'LocalFileSystem'"
_closing = threading.Lock()


def connect(layout: Layout, spill: Path | None = None, mend: bool = True) -> duckdb.DuckDBPyConnection:
    """A connection to the newest generation that can neither write nor reach other files; times are in UTC.

    A generation that is no longer of use is published anew, where the store can be written.

    Parameters
    ----------
    spill : Path, optional
        Folder for what does not fit in memory. DuckDB then keeps its way to the file system, which lets a query write
        beside the index: only for a process that the kernel keeps from writing elsewhere.
    mend : bool
        False for whoever holds the store's lock, as publishing anew takes it.
    """
    if not layout.archive.exists():
        lost = "; 'flushline archive rebuild' makes it again" if any(layout.bundles.glob("*/*/*/*")) else ""
        raise StoreError(
            f"{layout.root}: found no archive.duckdb, expected a store that holds at least one scene{lost}"
        )
    for attempt in range(_ATTEMPTS):
        path = Path(os.path.realpath(layout.archive))
        try:
            return open_generation(path, spill)
        except (duckdb.Error, LogBesideError) as problem:
            # A generation may be removed between looking the link up and opening it.
            if attempt + 1 < _ATTEMPTS and (not path.exists() or path != Path(os.path.realpath(layout.archive))):
                continue
            if mend and attempt + 1 < _ATTEMPTS and _is_spoilt(problem) and os.access(layout.lock, os.W_OK):
                _publish_anew(layout, path)
                continue
            mended = "" if "Could not set lock" in str(problem) else "; 'flushline archive rebuild' makes it again"
            raise StoreError(
                f"{layout.archive}: found {_first_line(problem)}, expected a readable index{mended}"
            ) from None
    raise StoreError(
        f"{layout.archive}: found it replaced {_ATTEMPTS} times while opening it, expected a quieter store"
    )


def make_usable(layout: Layout) -> None:
    """Publish anew what is published, where it is no longer of use; before the store's lock is taken."""
    if layout.archive.exists():
        connect(layout).close()


def open_generation(path: Path, spill: Path | None = None) -> duckdb.DuckDBPyConnection:
    """A generation, to be read only, in a connection that reaches nothing else; `spill` as for `connect`."""
    _refuse_log(path)
    config = _CLOSED | (_SPILLING | {"temp_directory": str(spill)} if spill else {})
    connection = duckdb.connect(str(path), read_only=True, config=config)
    try:
        _refuse_log(path)
    except LogBesideError:
        connection.close()
        raise
    with _closing:  # connections to the same file in one process share its settings
        [(closed,)] = connection.execute("SELECT current_setting('lock_configuration')").fetchall()
        if not closed:
            connection.execute("SET GLOBAL TimeZone = 'UTC'")
            if spill is None:
                connection.execute(_NO_FILES)
            connection.execute("SET lock_configuration = true")
    return connection


class LogBesideError(Exception):
    """A log lies beside a generation, put there by something else than Flushline."""


def _refuse_log(path: Path) -> None:
    if beside := [file for file in companions(path) if ".wal" in file.name]:
        raise LogBesideError(f"{beside[0].name} beside it, which would change what is read")


def _is_spoilt(problem: Exception) -> bool:
    """Whether a generation is no longer of use: open for writing in another program, or with a log beside it."""
    return isinstance(problem, LogBesideError) or "Could not set lock" in str(problem)


def _publish_anew(layout: Layout, spoilt: Path) -> None:
    """Publish what `spoilt` holds as a generation of its own, if nobody did meanwhile."""
    from storage.archive import generations

    with locked(layout.lock):
        if Path(os.path.realpath(layout.archive)) == spoilt:
            generations.publish(layout, [])


def _first_line(problem: Exception) -> str:
    return str(problem).splitlines()[0]

"""A new generation of a large index made from an old one that nobody reads any more.

Copying a gigabyte to publish one scene takes a second; bringing the generation before last up to date takes a few
transactions. Beside each generation lies the list of runs that it has more than the one before it; where a list is
missing, somebody still has the old file open, or the outcome differs from the working index in any way, the caller
copies.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from metrology.errors import StoreError
from storage.archive import index
from storage.archive.bundle import check_bundle
from storage.archive.layout import Layout
from storage.archive.signed import signed_runs
from storage.review import ReviewLog

WORTHWHILE_BYTES = 64 * 2**20
_SPARE = ".spare.duckdb"


@dataclass(frozen=True)
class News:
    """What the working index has more than the newest generation.

    Attributes
    ----------
    runs : tuple of Path
    fingerprint : tuple of int
        Of the working index with these runs.
    """

    runs: tuple[Path, ...]
    fingerprint: tuple[int, ...]


def recycle(layout: Layout, generations: Sequence[Path], news: News, target: Path) -> bool:
    """Make the oldest generation the newest, if that can be done; the caller holds the store's lock.

    Parameters
    ----------
    generations : sequence of Path
        Oldest first.
    target : Path
        The new generation.
    """
    missed = [_noted(layout, generation) for generation in generations[1:]]
    if layout.work.stat().st_size < WORTHWHILE_BYTES or any(runs is None for runs in missed):
        return False
    spare = layout.generations / _SPARE
    index.discard(spare)  # of a writer that was killed
    generations[0].rename(spare)  # from here on nobody can open it anew
    try:
        if not _is_closed(spare):
            return False
        spare.chmod(stat.S_IMODE(layout.work.stat().st_mode))
        if _replayed(layout, spare, [*(run for runs in missed for run in runs or ()), *news.runs]) != news.fingerprint:
            return False
        spare.rename(target)
        return True
    except (OSError, StoreError):
        return False
    finally:
        _note(generations[0]).unlink(missing_ok=True)
        index.discard(spare)


def note(layout: Layout, generation: Path, news: News) -> None:
    """Write down which runs a generation has more than the one before it."""
    _note(generation).write_text(json.dumps([layout.relative(run) for run in news.runs]))


def discard(generation: Path) -> None:
    """Remove a generation and its list."""
    _note(generation).unlink(missing_ok=True)
    generation.unlink()


def _note(generation: Path) -> Path:
    return generation.with_suffix(".json")


def _noted(layout: Layout, generation: Path) -> list[Path] | None:
    try:
        return [layout.root / str(run) for run in json.loads(_note(generation).read_text())]
    except (OSError, ValueError):
        return None


def _replayed(layout: Layout, spare: Path, runs: Sequence[Path]) -> tuple[int, ...]:
    """Bring an old generation up to date; returns its fingerprint then."""
    signed = signed_runs(ReviewLog(layout.root).read())
    with index.connected(spare) as connection:
        for run in runs:
            with contextlib.suppress(StoreError):  # damaged or pruned: the fingerprints tell whether that matters
                index.replace_run(connection, run, check_bundle(run, only_tables=True), signed)
        return index.fingerprint(connection)


def _is_closed(path: Path) -> bool:
    """Whether no process has a file open: only then does Linux grant a lease on it. Not known means no."""
    with _opened(path) as descriptor:
        try:
            fcntl.fcntl(descriptor, fcntl.F_SETLEASE, fcntl.F_WRLCK)
            fcntl.fcntl(descriptor, fcntl.F_SETLEASE, fcntl.F_UNLCK)
        except (OSError, AttributeError):
            return False
    return True


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int]:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)

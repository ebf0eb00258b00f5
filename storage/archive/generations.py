"""Generations of the index: whoever publishes makes the next one beside the last, and readers are led to it.

A generation never changes once it is published. The next one is made from the one before the last, brought up to date
with the runs that it lacks, as copying a gigabyte to publish one scene takes a second. That is done only if Linux
grants a lease on the file, which it does where no process has it open, and if the outcome is what the last generation
is. Otherwise the last one is copied. Generations are numbered, whatever the clock says.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import duckdb

from metrology.errors import StoreError
from storage.archive import bookkeeping, index
from storage.archive.files import (
    allow_writing,
    clone,
    make_folders,
    next_number,
    point_to,
    protect,
    remove_database,
    sync,
)
from storage.archive.layout import Layout

_NAMES = "archive-*.duckdb"
_SPARE = ".spare.duckdb"
# As long as it takes to copy this much, a generation takes to be brought up to date.
WORTHWHILE_BYTES = 64 * 2**20


@dataclass(frozen=True)
class Note:
    """What a generation has more than the one before it; lies beside it."""

    before: str
    """Name of the generation before."""
    runs: tuple[str, ...]
    """Runs that were taken up, by their paths in the store."""
    fingerprint: tuple[int, ...]
    """Of the generation."""


def publish(layout: Layout, runs: Sequence[Path]) -> dict[Path, str]:
    """Publish an index that has these runs, too; what cannot be taken up is left out and named.

    An index of other tables than this version's is brought up to date and catches up with all bundles first. The
    caller holds the store's lock.
    """
    make_folders(layout.generations, layout.root)
    last = newest(layout)
    with _spare(layout) as spare:
        with _copied(layout, last, spare) as connection:
            if bookkeeping.bring_up_to_date(connection) or not last:
                refused, note = index.catch_up(connection, layout), None
            else:
                refused, note = index.take(connection, layout, runs), _news(connection, layout, last, runs)
        _give_place(layout, spare, last, note)
    return refused


def change(layout: Layout, work: Callable[[duckdb.DuckDBPyConnection], None]) -> None:
    """Publish an index changed in another way; the caller holds the store's lock."""
    make_folders(layout.generations, layout.root)
    last = newest(layout)
    with _spare(layout) as spare:
        _copy(last, spare)
        with index.connected(spare) as connection:
            bookkeeping.bring_up_to_date(connection)
            work(connection)
        _give_place(layout, spare, last, None)


def replace(layout: Layout, made: Path) -> None:
    """Publish an index that was made apart; the caller holds the store's lock."""
    make_folders(layout.generations, layout.root)
    _give_place(layout, made, newest(layout), None)


def newest(layout: Layout) -> Path | None:
    """The published generation; where the link to it is lost, that of the greatest number."""
    linked = Path(os.path.realpath(layout.archive))
    if linked.is_file() and linked.parent == Path(os.path.realpath(layout.generations)):
        return layout.generations / linked.name
    return max(all_of(layout), default=None)


def all_of(layout: Layout) -> list[Path]:
    """Every generation that is there, the oldest first."""
    return sorted(layout.generations.glob(_NAMES))


def is_noted(generation: Path | None) -> bool:
    """Whether it is known what a generation has more than the one before."""
    return generation is not None and _read_note(generation) is not None


def keep_only(layout: Layout, *kept: Path | None) -> None:
    """Remove all other generations, if these are any; the caller holds the store's lock."""
    for old in all_of(layout) if any(kept) else ():
        if old not in kept:
            remove_database(old)
            _note(old).unlink(missing_ok=True)


def is_closed(path: Path) -> bool:
    """Whether no process has a file open: only then does Linux grant a lease on it. Not known means no."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.fcntl(descriptor, fcntl.F_SETLEASE, fcntl.F_WRLCK)
        fcntl.fcntl(descriptor, fcntl.F_SETLEASE, fcntl.F_UNLCK)
    except (OSError, AttributeError):
        return False
    finally:
        os.close(descriptor)
    return True


@contextlib.contextmanager
def _spare(layout: Layout) -> Iterator[Path]:
    """A file that becomes the next generation, or is removed."""
    spare = layout.generations / _SPARE
    remove_database(spare)  # of a writer that was killed
    try:
        yield spare
    finally:
        remove_database(spare)


def _give_place(layout: Layout, made: Path, last: Path | None, note: Note | None) -> None:
    """Make a file the newest generation, lead readers to it, and remove all but the one before."""
    target = layout.generations / f"archive-{next_number(layout.generations, _NAMES):020d}.duckdb"
    # Whoever opens it for writing by mistake is refused instead of changing what others read.
    protect(made)
    sync(made)
    if note:
        _note(target).write_text(json.dumps(note.__dict__))
    made.rename(target)
    sync(target.parent)
    point_to(layout.archive, target)
    if Path(os.path.realpath(layout.archive)) != Path(os.path.realpath(target)):
        raise StoreError(f"{layout.archive}: found it leading elsewhere, expected {target.name}")
    keep_only(layout, target, last)
    for other in layout.index.glob("work-*"):  # of versions that kept an index to work in: they make it again, whole
        other.unlink(missing_ok=True)


@contextlib.contextmanager
def _copied(layout: Layout, last: Path | None, spare: Path) -> Iterator[duckdb.DuckDBPyConnection]:
    """A file with what the last generation has, to be changed: the one before it brought up to date, or a copy."""
    with contextlib.ExitStack() as stack:
        connection = _recycled(layout, last, spare, stack) if last else None
        if not connection:
            keep_only(layout, last)  # room for the copy
            _copy(last, spare)
        yield connection or stack.enter_context(index.connected(spare))


def _copy(last: Path | None, spare: Path) -> None:
    """Make a file equal to the last generation, or to an index of no runs."""
    if last:
        clone(last, spare)
        allow_writing(spare)
    else:
        index.make_empty(spare)


def _recycled(layout: Layout, last: Path, spare: Path, stack: contextlib.ExitStack) -> duckdb.DuckDBPyConnection | None:
    """Make the generation before the last equal to it, as a file of its own, if that can be done.

    Parameters
    ----------
    stack : ExitStack
        Closes the connection that is returned.
    """
    note = _read_note(last)
    former = layout.generations / note.before if note else None
    if not (note and former and former.is_file()) or last.stat().st_size < WORTHWHILE_BYTES:
        return None
    former.rename(spare)  # from here on nobody can open it anew
    _note(former).unlink(missing_ok=True)
    with contextlib.suppress(OSError, StoreError), contextlib.ExitStack() as opened:
        if is_closed(spare):
            allow_writing(spare)
            connection = opened.enter_context(index.connected(spare))
            index.take(connection, layout, [layout.root / run for run in note.runs])
            if tuple(index.fingerprint(connection)) == note.fingerprint:
                stack.push(opened.pop_all())
                return connection
    remove_database(spare)
    return None


def _news(
    connection: duckdb.DuckDBPyConnection, layout: Layout, last: Path | None, runs: Sequence[Path]
) -> Note | None:
    """What to note of a generation in the making; None for one that is copied in no time."""
    if last is None or last.stat().st_size < WORTHWHILE_BYTES:
        return None
    return Note(last.name, tuple(layout.relative(run) for run in runs), tuple(index.fingerprint(connection)))


def _note(generation: Path) -> Path:
    return generation.with_suffix(".json")


def _read_note(generation: Path) -> Note | None:
    try:
        document = json.loads(_note(generation).read_text(encoding="utf-8"))
        note = Note(str(document["before"]), tuple(document["runs"]), tuple(document["fingerprint"]))
    except (OSError, ValueError, TypeError, KeyError):
        return None
    return note if Path(note.before).name == note.before else None

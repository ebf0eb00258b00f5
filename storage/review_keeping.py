"""Keeping the review log: adding entries under the store's lock, and telling a log that something else changed.

In this order, so that a kill at any moment leaves a sound chain: the head file announces the entries, the database
takes them in one transaction, what they sign off is marked beside the bundles, the head file says that they are there.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrology.errors import StoreError
from storage.archive.files import locked
from storage.archive.layout import Layout
from storage.documents import read_json
from storage.review_chain import chained, head_of, read_old_log, sound_part
from storage.review_entries import Entry, Review
from storage.review_file import read_lines
from storage.review_head import Head, HeadFile, KeptHead
from storage.review_marks import SignOffMarks

if TYPE_CHECKING:
    from sqlalchemy import Connection

    from storage.review_database import ReviewDatabase

Check = Callable[[Review], None]
"""Raises where what was decided so far forbids an entry."""
_UNTIL = "nothing more is written to it until that is cleared up"

_read_before: dict[str, Review] = {}
_reading = threading.Lock()


class Keeping:
    """Database, head file, marks and lock of a store's review log.

    Parameters
    ----------
    root : Path
        The store's folder.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self.folder = root / "reviews"
        self.old_log = self.folder / "log.jsonl"
        self._taken_over = self.folder / "log.jsonl.migrated"
        self._head_file = HeadFile(self.folder / "head.json")
        self.marks = SignOffMarks(root)

    @cached_property
    def url(self) -> str | None:
        """The database that the store names; None for SQLite in the store."""
        marker = Layout(self._root).marker
        found = read_json(marker, StoreError).get("reviews") if marker.exists() else None
        if found is not None and not str(found).startswith("postgresql"):
            raise StoreError(
                f"{marker}: found reviews {found!r}, expected a URL such as postgresql+psycopg://host/name"
            )
        return None if found is None else str(found)

    @property
    def place(self) -> str:
        """How messages name the database."""
        return self._database.place

    @property
    def database_file(self) -> Path | None:
        """The database's file; None where a server holds it."""
        return None if self.url else self.folder / "decisions.sqlite"

    @property
    def _untouched(self) -> bool:
        """Whether files hold the log and none is there: then the database's library need not be loaded to ask it."""
        files = (self._head_file.path, self.database_file, self.old_log, self._taken_over)
        return self.url is None and not any(path and path.exists() for path in files)

    @property
    def version(self) -> tuple[int, ...]:
        """Changes with every new entry, and where one of the files was changed."""
        found: list[int] = []
        for path in (self._head_file.path, self.database_file, self.old_log):
            with contextlib.suppress(OSError):
                if path:
                    status = path.stat()
                    found += (status.st_ino, status.st_size, status.st_mtime_ns)
        return tuple(found)

    def head(self) -> Head:
        """The last entry as it is known without the database."""
        old = self.only_old_log()
        return head_of(old.entries[-1] if old.entries else None) if old else self._head_file.read().head

    def read(self) -> Review:
        """Everything; what this process read before is not read again."""
        if old := self.only_old_log():
            return old
        try:
            with _reading, self.looking() as (connection, problem):
                return self._read_on(connection, problem) if connection is not None else Review((), problem)
        except StoreError as problem:
            return Review((), str(problem))

    def some(self, ask: Callable[[Connection], list[Entry]], belongs: Callable[[Entry], bool]) -> Review:
        """Entries that a query gives, or that belong to what it asks for."""
        if old := self.only_old_log():
            return Review(tuple(filter(belongs, old.entries)), old.problem)
        try:
            if self._untouched:
                return Review()
            with self.looking() as (connection, problem):
                return Review(tuple(ask(connection)) if connection is not None else (), problem)
        except StoreError as problem:
            return Review((), str(problem))

    def append(self, wanted: list[dict[str, Any]], scenes: Sequence[str], check: Check) -> list[Entry]:
        """Add entries where `check`, which is given what was decided about `scenes`, lets them in."""
        from storage import review_database

        with self._trouble(), self._lock():
            self._take_over()
            with self._database.transaction() as connection:
                head = self._head_to_follow(connection)
                check(Review(tuple(review_database.entries_of_scenes(connection, scenes))))
                entries = chained(wanted, head)
                self._head_file.write(head, following=head_of(entries[-1]))
                review_database.add(connection, entries)
            self._confirm(entries)
        return entries

    @contextlib.contextmanager
    def looking(self) -> Iterator[tuple[Connection | None, str | None]]:
        """The database to be read, and what is wrong with its end; no connection where there is nothing to read."""
        from storage import review_database

        with contextlib.ExitStack() as stack:
            connection, last, problem = None, None, None
            try:
                if self._database.is_there():
                    connection = stack.enter_context(self._database.transaction())
                    if review_database.has_table(connection):
                        last = review_database.last_entry(connection)
                    else:
                        connection = None
                problem = self._problem(last, self._head_file.read())
            except StoreError as found:
                connection, problem = None, str(found)
            yield connection, problem

    @cached_property
    def _database(self) -> ReviewDatabase:
        from storage.review_database import ReviewDatabase

        return ReviewDatabase(self.folder, self.url)

    def _read_on(self, connection: Connection, problem: str | None) -> Review:
        from storage import review_database

        place = self._database.place
        known = _read_before.get(place, Review())
        end = head_of(known.entries[-1] if known.entries else None)
        if end.number and review_database.checksum_of(connection, end.number) != end.checksum:
            known, end = Review(), Head()
        more, broken = sound_part(review_database.entries_after(connection, end.number), end, place)
        review = known.with_more(more) if more else known
        _read_before[place] = review
        problem = broken or problem
        return Review(review.entries, problem) if problem else review

    def _problem(self, last: Entry | None, kept: KeptHead) -> str | None:
        """What is wrong with the log's end, as can be seen without reading all of it."""
        place, found = self._database.place, head_of(last)
        if last and sound_part([last], Head(last.number - 1, last.previous), place, documents=True)[1]:
            return f"{place}: found entry {last.number} changed, expected it as written"
        if not kept.allows(found) or (not last and read_lines(self._taken_over)):
            end = f"entry {found.number} ({found.checksum[:12]}…) as the last one" if last else "no entry"
            wanted = f"entry {kept.head.number} ({kept.head.checksum[:12]}…)"
            return (
                f"{place}: found {end}, expected {wanted} as {self._head_file.path} says; "
                "something else than Flushline removed, changed or added entries"
            )
        if last and self.old_log.exists():
            return (
                f"{self.old_log}: found a log that an earlier version wrote beside the database, expected entries in "
                f"{place} alone; let no earlier version review in this store"
            )
        return None

    def _head_to_follow(self, connection: Connection) -> Head:
        """The head of a sound log, with what a crash left undone; the caller holds the lock."""
        from storage import review_database

        self._database.create(connection)
        review_database.hold(connection)
        kept, last = self._head_file.read(), review_database.last_entry(connection)
        if problem := self._problem(last, kept):
            raise StoreError(f"{problem}; {_UNTIL}")
        head = head_of(last)
        if head != kept.head:
            self._confirm(review_database.entries_after(connection, kept.head.number))
        return head

    def _confirm(self, entries: Sequence[Entry]) -> None:
        """Mark what entries of the database sign off, and say that they are there."""
        self.marks.add((entry.scene_id, entry.run_id) for entry in entries if entry.action == "sign-off")
        self._head_file.write(head_of(entries[-1]))

    def only_old_log(self) -> Review | None:
        """The log of an earlier version, where it is all there is and cannot be taken over."""
        if not self._is_to_be_taken_over():
            return None
        with contextlib.suppress(OSError, StoreError):
            with self._lock():
                self._take_over()
            return None
        return read_old_log(self.old_log)

    def _is_to_be_taken_over(self) -> bool:
        return self.old_log.exists() and not self._taken_over.exists() and not self._head_file.read().head.number

    def _take_over(self) -> None:
        """Bring an earlier version's log into the database, all of it or nothing; the caller holds the lock."""
        from storage import review_database

        if not self._is_to_be_taken_over():
            return
        review = read_old_log(self.old_log)
        if review.problem:
            raise StoreError(f"{review.problem}; {_UNTIL}")
        if review.entries:
            head = head_of(review.entries[-1])
            with self._database.transaction() as connection:
                self._database.create(connection)
                review_database.hold(connection)
                last = review_database.last_entry(connection)
                if last is None:
                    self._head_file.write(Head(), following=head)
                    review_database.add(connection, review.entries)
                elif head_of(last) != head:
                    raise StoreError(
                        f"{self.old_log}: found it beside a database of other entries, expected one of the two; "
                        f"{_UNTIL}"
                    )
            self.marks.add((entry.scene_id, entry.run_id) for entry in review.sign_offs().values())
        self.old_log.replace(self._taken_over)
        if review.entries:
            self._head_file.write(head)

    @contextlib.contextmanager
    def _lock(self) -> Iterator[None]:
        self.folder.mkdir(exist_ok=True)
        with locked(self.folder / ".lock"):
            self._database.make_file()
            yield

    @contextlib.contextmanager
    def _trouble(self) -> Iterator[None]:
        try:
            yield
        except OSError as problem:
            raise StoreError(
                f'{self.folder}: found "{problem.strerror}", expected a review log that can be written'
            ) from None

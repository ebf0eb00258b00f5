"""The database that holds the entries of a store's review log: SQLite in the store, or PostgreSQL for several machines.

SQLite needs no server; its file `reviews/decisions.sqlite` has no companions but a journal while it is written. The key
`reviews` in flushline-store.json names a PostgreSQL database instead.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from urllib.parse import quote

from sqlalchemy import Connection, Engine, create_engine, event, exc, insert, inspect, make_url, select, text
from sqlalchemy.pool import NullPool

from metrology.errors import StoreError, UsageError
from storage.archive.files import sync
from storage.review_entries import Entry
from storage.review_tables import DECISIONS, POSTGRESQL

_SECONDS_TO_WAIT = 60
_SCENES_PER_QUERY = 1000


def check_url(url: str) -> None:
    """Refuse a database that cannot be reached, that is no PostgreSQL, or whose password would lie in the store."""
    try:
        parts = make_url(url)
    except exc.ArgumentError:
        parts = None
    if parts is None or parts.get_backend_name() != POSTGRESQL:
        raise UsageError(f"--reviews: found {url!r}, expected a URL such as postgresql+psycopg://host/name")
    if parts.password is not None:
        raise UsageError("--reviews: found a password, expected none: give it by ~/.pgpass or PGPASSWORD")
    with ReviewDatabase(Path(), url).transaction():
        pass


class ReviewDatabase:
    """Where entries are kept.

    Parameters
    ----------
    folder : Path
        The store's folder `reviews`.
    url : str, optional
        Of a PostgreSQL database; SQLite in the folder without.
    """

    def __init__(self, folder: Path, url: str | None = None) -> None:
        self.file = None if url else folder.absolute() / "decisions.sqlite"
        self._url = url

    @property
    def place(self) -> str:
        """How messages name it; without a password."""
        return str(self.file) if self._url is None else make_url(self._url).render_as_string(hide_password=True)

    def is_there(self) -> bool:
        """Whether there is one; a server is taken to be."""
        return self.file is None or self.file.exists()

    def create(self, connection: Connection) -> None:
        """Make the table where there is none."""
        DECISIONS.metadata.create_all(connection)

    def make_file(self) -> None:
        """Make SQLite's file where there is none; as every file of a shared store it follows the umask."""
        if self.file and not self.file.exists():
            os.close(os.open(self.file, os.O_RDWR | os.O_CREAT, 0o666))
            sync(self.file.parent)

    @contextlib.contextmanager
    def transaction(self) -> Iterator[Connection]:
        """A transaction: all that is done in it is done, or nothing."""
        try:
            with _engine(self._url or str(self.file)).begin() as connection:
                yield connection
        except exc.SQLAlchemyError as problem:
            raise StoreError(self._said(problem)) from None
        except ModuleNotFoundError as problem:
            raise StoreError(
                f"{self.place}: found no package {problem.name!r}, expected it for PostgreSQL: pip install "
                "'flushline[postgres]'"
            ) from None

    def _said(self, problem: exc.SQLAlchemyError) -> str:
        cause = getattr(problem, "orig", None) or problem
        first = (str(cause).splitlines() or [""])[0].strip() or type(cause).__name__
        return f'{self.place}: found "{first}", expected a database of decisions that can be read and written'


@lru_cache(maxsize=8)
def _engine(address: str) -> Engine:
    """Connections are opened anew each time: they would not survive a fork, and opening one takes a millisecond."""
    if "://" in address:
        return create_engine(address, poolclass=NullPool, connect_args={"connect_timeout": 10})

    def connect() -> sqlite3.Connection:
        # Where it may not be written, SQLite opens it for reading.
        connection = sqlite3.connect(
            f"file:{quote(address)}?mode=rw", uri=True, timeout=_SECONDS_TO_WAIT, isolation_level=None
        )
        connection.execute("PRAGMA synchronous = EXTRA")
        return connection

    engine = create_engine("sqlite://", creator=connect, poolclass=NullPool)
    # Python's module would begin a transaction with the first change only, after what it depends on was read.
    event.listen(engine, "begin", lambda connection: connection.exec_driver_sql("BEGIN"))
    return engine


def has_table(connection: Connection) -> bool:
    """Whether somebody made the table."""
    return inspect(connection).has_table(DECISIONS.name)


def hold(connection: Connection) -> None:
    """Keep other writers waiting until the end of the transaction."""
    if connection.dialect.name == POSTGRESQL:
        connection.execute(text("LOCK TABLE decisions IN SHARE ROW EXCLUSIVE MODE"))


def last_entry(connection: Connection) -> Entry | None:
    """The last entry."""
    row = connection.execute(select(DECISIONS).order_by(DECISIONS.c.number.desc()).limit(1)).one_or_none()
    return Entry._make(row) if row else None


def checksum_of(connection: Connection, number: int) -> str | None:
    """The checksum of an entry; None where there is none of that number."""
    return connection.execute(select(DECISIONS.c.checksum).where(DECISIONS.c.number == number)).scalar_one_or_none()


def entries_after(connection: Connection, number: int) -> list[Entry]:
    """All entries after one."""
    chosen = select(DECISIONS).where(DECISIONS.c.number > number).order_by(DECISIONS.c.number)
    return [Entry._make(row) for row in connection.execute(chosen)]


def entries_of_scenes(connection: Connection, scenes: Sequence[str]) -> list[Entry]:
    """All entries about scenes and their features."""
    found: list[Entry] = []
    for start in range(0, len(scenes), _SCENES_PER_QUERY):
        part = list(scenes[start : start + _SCENES_PER_QUERY])
        rows = connection.execute(select(DECISIONS).where(DECISIONS.c.scene_id.in_(part)))
        found += [Entry._make(row) for row in rows]
    return sorted(found, key=lambda entry: entry.number)


def sign_off_entries(connection: Connection) -> list[Entry]:
    """All sign-offs."""
    chosen = select(DECISIONS).where(DECISIONS.c.action == "sign-off").order_by(DECISIONS.c.number)
    return [Entry._make(row) for row in connection.execute(chosen)]


def add(connection: Connection, entries: Sequence[Entry]) -> None:
    """Add entries at the end."""
    rows = [{"number": e.number, "document": e.document, "checksum": e.checksum} for e in entries]
    connection.execute(insert(DECISIONS), rows)

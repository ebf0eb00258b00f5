"""What is to be delivered, to whom: `deliveries.toml` of a store, and the record of what was, in deliveries.sqlite.

Each event is recorded for each target before anything is sent, and marked when the target has taken it. What is sent
and not yet marked when the power fails is sent again: at least once, and with the same id.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from metrology.errors import SpecError
from storage.documents import check_format, read_toml
from storage.export.events import Event
from storage.models import Identifier, StrictModel, UtcTime, validate

FORMAT = "flushline-deliveries/1"
CONFIGURATION, RECORD = "deliveries.toml", "deliveries.sqlite"
_FIRST_WAIT, _LONGEST_WAIT = timedelta(minutes=1), timedelta(hours=1)
_TABLE = """CREATE TABLE IF NOT EXISTS deliveries (
    number INTEGER PRIMARY KEY, target TEXT NOT NULL, event_id TEXT NOT NULL, type TEXT NOT NULL, body TEXT NOT NULL,
    state TEXT NOT NULL DEFAULT 'pending', tries INTEGER NOT NULL DEFAULT 0, first_try TEXT, next_try TEXT,
    problem TEXT, delivered_at TEXT, UNIQUE (target, event_id))"""
_RUNS = "CREATE TABLE IF NOT EXISTS runs (target TEXT NOT NULL, run TEXT NOT NULL, UNIQUE (target, run))"


class TargetModel(StrictModel):
    """A target: a web-hook, or a place for files.

    `since` is the moment from which on runs are told of. A web-hook's secret is in a file, as `whsec_` and base64. A
    place takes a panel in `formats` whenever its verdict is new.
    """

    name: Identifier
    since: UtcTime
    webhook: Annotated[str, Field(pattern=r"^https?://\S+$")] | None = None
    secret_file: Path | None = None
    place: Annotated[str, Field(min_length=1)] | None = None
    formats: tuple[str, ...] = ()
    events: tuple[Literal["scene.verdict", "panel.verdict", "rig.doubtful", "rig.due", "scan.quarantined"], ...] = ()
    give_up_hours: Annotated[float, Field(gt=0, le=24 * 365)] = 72.0

    @model_validator(mode="after")
    def _is_one_of_both(self) -> TargetModel:
        hook = self.webhook is not None and self.secret_file is not None and not (self.place or self.formats)
        place = self.place is not None and bool(self.formats) and not (self.webhook or self.secret_file or self.events)
        if not (hook or place):
            raise ValueError("found neither, expected webhook and secret_file, or place and formats")
        return self

    def takes(self, event_type: str) -> bool:
        """Whether the target is told of such events."""
        if self.place is not None:
            return event_type == "panel.verdict"
        return not self.events or event_type in self.events


class DeliveriesModel(StrictModel):
    """deliveries.toml."""

    format: Literal["flushline-deliveries/1"]
    targets: tuple[TargetModel, ...]

    @model_validator(mode="after")
    def _names_differ(self) -> DeliveriesModel:
        if len({target.name for target in self.targets}) < len(self.targets):
            raise ValueError("found a target's name twice, expected names of their own")
        return self


def load_targets(root: Path) -> tuple[TargetModel, ...]:
    """The targets of a store; none where it has no `deliveries.toml`."""
    path = root / CONFIGURATION
    if not path.exists():
        return ()
    document = read_toml(path, SpecError)
    check_format(document, FORMAT, path, SpecError)
    return validate(DeliveriesModel, document, path, SpecError).targets


@dataclass(frozen=True)
class Delivery:
    """An event that a target has not taken yet."""

    number: int
    event_id: str
    type: str
    body: str
    tries: int
    first_try: datetime | None


class Record:
    """What was delivered, what waits, and the dead letters of a store.

    Parameters
    ----------
    root : Path
        The store's folder.
    """

    def __init__(self, root: Path) -> None:
        self._path = root / RECORD

    @contextlib.contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        with contextlib.closing(sqlite3.connect(self._path, timeout=30)) as connection:
            connection.execute(_TABLE)
            connection.execute(_RUNS)
            with connection:
                yield connection

    def new_runs(self, target: str, runs: Iterable[str]) -> list[str]:
        """Those of the runs that the target was not told of yet."""
        with self._opened() as connection:
            known = {run for (run,) in connection.execute("SELECT run FROM runs WHERE target = ?", [target])}
        return [run for run in runs if run not in known]

    def add(self, target: str, events: Iterable[Event], runs: Iterable[str] = ()) -> None:
        """Record events, each once, together with the runs that they follow from."""
        rows = [(target, event.id, event.type, event.document) for event in events]
        with self._opened() as connection:
            connection.executemany(
                "INSERT OR IGNORE INTO deliveries (target, event_id, type, body) VALUES (?, ?, ?, ?)", rows
            )
            connection.executemany("INSERT OR IGNORE INTO runs VALUES (?, ?)", [(target, run) for run in runs])

    def due(self, target: str, now: datetime) -> list[Delivery]:
        """What waits for the target and may be tried now, oldest first."""
        with self._opened() as connection:
            rows = connection.execute(
                "SELECT number, event_id, type, body, tries, first_try FROM deliveries WHERE target = ? AND "
                "state = 'pending' AND (next_try IS NULL OR next_try <= ?) ORDER BY number",
                [target, _text(now)],
            ).fetchall()
        return [
            Delivery(number, event_id, type_, body, tries, datetime.fromisoformat(first) if first else None)
            for number, event_id, type_, body, tries, first in rows
        ]

    def taken(self, delivery: Delivery, now: datetime) -> None:
        """The target has it."""
        with self._opened() as connection:
            connection.execute(
                "UPDATE deliveries SET state = 'delivered', delivered_at = ?, problem = NULL WHERE number = ?",
                [_text(now), delivery.number],
            )

    def failed(self, delivery: Delivery, problem: str, now: datetime, give_up: timedelta) -> None:
        """The target did not take it: it waits, twice as long each time, and is a dead letter in the end."""
        first = delivery.first_try or now
        wait = min(_LONGEST_WAIT, _FIRST_WAIT * 2 ** min(delivery.tries, 10))
        state = "dead" if now - first >= give_up else "pending"
        with self._opened() as connection:
            connection.execute(
                "UPDATE deliveries SET state = ?, tries = tries + 1, first_try = ?, next_try = ?, problem = ? "
                "WHERE number = ?",
                [state, _text(first), _text(now + wait), problem, delivery.number],
            )

    def revive(self) -> int:
        """Let dead letters, and all that waits, be tried again now; returns how many were dead."""
        with self._opened() as connection:
            [(dead,)] = connection.execute("SELECT count(*) FROM deliveries WHERE state = 'dead'").fetchall()
            connection.execute(
                "UPDATE deliveries SET state = 'pending', first_try = NULL, next_try = NULL WHERE state <> 'delivered'"
            )
        return int(dead)

    def counts(self) -> dict[tuple[str, str], int]:
        """How many there are, by target and state."""
        with self._opened() as connection:
            rows = connection.execute("SELECT target, state, count(*) FROM deliveries GROUP BY target, state")
            return {(target, state): count for target, state, count in rows}

    def problems(self) -> list[tuple[str, str]]:
        """The last problem of each target with letters that wait or are dead."""
        with self._opened() as connection:
            rows = connection.execute(
                "SELECT target, problem FROM deliveries WHERE state <> 'delivered' AND problem IS NOT NULL "
                "GROUP BY target HAVING number = max(number)"
            )
            return [(target, problem) for target, problem in rows]


def _text(moment: datetime) -> str:
    """ISO 8601 of one length, so that text is ordered as time is."""
    return moment.astimezone(UTC).isoformat(timespec="microseconds")

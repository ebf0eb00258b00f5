"""Deliveries after a run: what is new in a store is told to web-hooks, and exported to folders and object storage."""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from flows.export import export_subject
from flows.inbox_job import Outcome
from metrology.errors import FlushlineError
from storage.archive.files import hold
from storage.archive.store import Store
from storage.export.deliveries import Delivery, Record, TargetModel, load_targets
from storage.export.events import Event, events_of, quarantined, rigs_due, runs_since
from storage.export.formats import format_named
from storage.export.subject import panel_subject
from storage.export.webhook import NotTaken, read_secret, send


@dataclass(frozen=True)
class Delivered:
    """What became of all deliveries of a store."""

    sent: int = 0
    waiting: int = 0
    dead: int = 0
    """sent, waiting, dead: taken just now; to be tried again; given up."""
    problems: tuple[str, ...] = ()
    """One line for each target that did not take something."""


def deliver(store: Store, outcomes: Iterable[Outcome] = (), now: Callable[[], datetime] | None = None) -> Delivered:
    """Record what is new for each target of the store, and send what is due; one process at a time does so.

    Parameters
    ----------
    outcomes : iterable of Outcome
        Of an inbox run, for the scans that were put aside.
    now : callable, optional
        The clock.
    """
    clock = now or (lambda: datetime.now(UTC))
    targets = load_targets(store.root)
    if not targets:
        return Delivered()
    record = Record(store.root)
    aside = [quarantined(str(o.folder), o.scene_id, o.text) for o in outcomes if o.state == "quarantined"]
    due = rigs_due(store, clock()) if any(target.takes("rig.due") for target in targets) else ()
    unasked = [*aside, *due]
    for target in targets:
        record.add(target.name, [event for event in unasked if target.takes(event.type)])
    descriptor = hold(store.layout.index)
    if descriptor is None:
        return Delivered(waiting=1, problems=("deliveries: found another process at them, which goes on with these",))
    try:
        sent = sum(_deliver_to(target, store, record, clock) for target in targets)
    finally:
        os.close(descriptor)
    counts = record.counts()
    left = {state: sum(n for (_, found), n in counts.items() if found == state) for state in ("pending", "dead")}
    return Delivered(sent, left["pending"], left["dead"], tuple(f"{name}: {said}" for name, said in record.problems()))


def _deliver_to(target: TargetModel, store: Store, record: Record, clock: Callable[[], datetime]) -> int:
    runs = runs_since(store, target.since)
    if new := record.new_runs(target.name, runs):
        events: list[Event] = [e for e in events_of(store, {run: runs[run] for run in new}) if target.takes(e.type)]
        record.add(target.name, events, new)
    sent = 0
    way = _to_webhook(target) if target.webhook else _to_place(target, store)
    for delivery in record.due(target.name, clock()):
        try:
            way(delivery, clock())
        except NotTaken as problem:
            record.failed(delivery, str(problem), clock(), timedelta(hours=target.give_up_hours))
            if not problem.its_fault:
                break  # it would take no other either; all wait for the next time
            continue
        record.taken(delivery, clock())
        sent += 1
    return sent


def _to_webhook(target: TargetModel) -> Callable[[Delivery, datetime], None]:
    secret = read_secret(target.secret_file) if target.secret_file else b""
    return lambda delivery, now: send(target.webhook or "", secret, delivery.event_id, delivery.body.encode(), now)


def _to_place(target: TargetModel, store: Store) -> Callable[[Delivery, datetime], None]:
    formats = [format_named(name) for name in target.formats]

    def put(delivery: Delivery, _: datetime) -> None:
        data = json.loads(delivery.body)["data"]
        try:
            subject = panel_subject(store, data["aircraft_serial"], data["panel"])
            export_subject(subject, formats, store, target.place or "", "point")
        except FlushlineError as problem:
            raise NotTaken(str(problem), its_fault=True) from None
        except OSError as problem:
            raise NotTaken(f"found {problem}, expected a place that can be written") from None

    return put


def deliver_after_run(store: Store, outcomes: Iterable[Outcome]) -> list[str]:
    """Deliver after an inbox run, whose result stands whatever becomes of it; returns what a person should know."""
    try:
        return list(deliver(store, outcomes).problems) if store.layout.marker.exists() else []
    except (FlushlineError, OSError, sqlite3.Error) as problem:
        return [f"deliveries: {problem}"]

"""Keeping an archive in order: check it, make its index again, prune it, and copy it elsewhere."""

from __future__ import annotations

import contextlib
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path

import duckdb

from metrology.errors import StoreError
from storage.archive import bookkeeping, generations, index, snapshot
from storage.archive.bundle import MANIFEST, check_bundle
from storage.archive.bundles import Bundles
from storage.archive.checking import Check, check, check_fast, incomplete
from storage.archive.files import disk_trouble, locked, remove_database
from storage.archive.layout import Layout
from storage.archive.loading import Loader
from storage.archive.remote import Remote
from storage.archive.signed import by_preference, signed_runs
from storage.archive.staging import REMOVED, remove_pruned
from storage.models import leads_inside
from storage.review import ReviewLog

__all__ = ["Check", "check", "check_fast", "export", "prune", "rebuild"]


def rebuild(layout: Layout) -> list[str]:
    """Make the index again from the bundles alone and publish it; returns what is damaged.

    It is made beside the published one, which others go on with; only catching up with what they stored meanwhile
    takes the store's lock.
    """
    made = layout.index / ".rebuild.duckdb"
    with contextlib.ExitStack() as held:
        held.enter_context(disk_trouble(layout.root, "the index is as it was"))
        layout.index.mkdir(exist_ok=True)  # a backup may have left hidden folders out
        held.enter_context(locked(layout.index / "rebuild-lock"))
        remove_database(made)
        with locked(layout.lock):
            generations.keep_only(layout, generations.newest(layout))  # makes room
        try:
            with index.connected(made) as connection:
                _start(layout, connection)
                refused = index.catch_up(connection, layout)
            with locked(layout.lock):
                with index.connected(made) as connection:
                    refused |= index.catch_up(connection, layout, _stored_meanwhile(layout, connection))
                    altered = _altered(layout, connection)
                generations.replace(layout, made)
        finally:
            remove_database(made)
    bundles = Bundles(layout)
    there = bundles.whatever_is_there()  # without what was pruned meanwhile
    return [text for run, text in sorted(refused.items()) if run in there] + altered + incomplete(bundles)


def _altered(layout: Layout, made: duckdb.DuckDBPyConnection) -> list[str]:
    """Runs that came in with other rows than the published index noted of them, one line each.

    A bundle that was altered together with its manifest agrees with itself. What the index noted is told by its digest.
    """
    published = generations.newest(layout)
    with contextlib.suppress(StoreError, duckdb.Error, snapshot.LogBesideError), contextlib.ExitStack() as stack:
        if published:
            former = stack.enter_context(contextlib.closing(snapshot.open_generation(published)))
            noted, then = bookkeeping.shown_runs(former), bookkeeping.kept_digests(former) or {}
            now = bookkeeping.row_digests(made, bookkeeping.additions(former))
            same = {scene for scene, run in bookkeeping.shown_runs(made).items() if noted.get(scene) == run}
            signed = signed_runs(layout.root)
            return [
                f"{layout.scene_folder(scene) / noted[scene]}: found other rows than the index noted when the run came "
                f"in, expected the same: bundle or index was altered, {_vouched(noted[scene], signed.get(scene))}"
                for scene in sorted(same & then.keys() & now.keys())
                if then[scene] != now[scene]
            ]
    return []


def _vouched(run: str, signed: str | None) -> str:
    """Whether a signature tells which of bundle and index is right."""
    if run == signed:
        return "and the run was signed off: 'flushline archive check' holds it against the review log"
    return "and nobody signed the run off, so nothing tells which; compare it with a backup"


def _start(layout: Layout, connection: duckdb.DuckDBPyConnection) -> None:
    """Make the tables of this version, and those that other versions gave the index so far."""
    with contextlib.ExitStack() as stack:
        former = None
        with contextlib.suppress(StoreError):  # lost or damaged: then there is nothing to be kept of it
            former = stack.enter_context(contextlib.closing(snapshot.connect(layout)))
        bookkeeping.start(connection, former)


def _stored_meanwhile(layout: Layout, connection: duckdb.DuckDBPyConnection) -> list[Path] | None:
    """All runs of the scenes that the published index shows otherwise; None where it cannot be read."""
    published = generations.newest(layout)
    with contextlib.suppress(StoreError, duckdb.Error, snapshot.LogBesideError), contextlib.ExitStack() as stack:
        if published:
            reading = stack.enter_context(contextlib.closing(snapshot.open_generation(published)))
            return index.stored_meanwhile(connection, layout, reading)
    return None


def prune(layout: Layout, keep: int = 1, older_than: timedelta | None = None) -> list[Path]:
    """Remove runs that newer ones have replaced; returns what was removed.

    The run that the bundles say is to be shown stays if it is sound; where it is damaged, its scene keeps all runs and
    is named in the end. A run that somebody signed off, or that the index shows, stays in any case.

    Parameters
    ----------
    keep : int
        Sound runs to keep of each scene, the shown one included.
    older_than : timedelta, optional
        Remove only runs stored longer ago than this.
    """
    if keep < 1:
        raise StoreError(f"prune: found {keep} runs to keep, expected at least 1")
    if problem := ReviewLog(layout.root).read().problem:
        raise StoreError(f"{problem}; nothing is removed until that is cleared up")
    signed, bundles = signed_runs(layout.root), Bundles(layout)
    shown = _shown(layout)  # before the lock, which mending the index takes
    removed, damaged = [], []
    with locked(layout.lock), duckdb.connect() as connection:
        bookkeeping.start(connection)
        rows = Loader(connection, layout)
        remove_pruned(layout)
        protected = {*signed.items(), *shown.items()}
        scenes: dict[str, list[Path]] = {}
        for run in sorted(bundles.whatever_is_there()):
            scenes.setdefault(run.parent.name, []).append(run)
        for runs in (runs for _, runs in sorted(scenes.items()) if len(runs) > 1):
            try:
                replaced = _replaced(bundles, rows, by_preference(runs, signed), keep)
            except StoreError as problem:
                damaged.append(str(problem))
                continue
            for run in replaced:
                if (run.parent.name, run.name) in protected or (older_than and _age(run) < older_than):
                    continue
                _remove(layout, bundles, run)
                removed.append(run)
    if damaged:
        more = f" (and {len(damaged) - 1} more scenes)" if len(damaged) > 1 else ""
        raise StoreError(f"{damaged[0]}; all runs of its scene are kept{more}; {len(removed)} others removed")
    return removed


def _replaced(bundles: Bundles, rows: Loader, preferred: list[Path], keep: int) -> list[Path]:
    """Runs of a scene older than the one to be shown, beyond those to be kept.

    Parameters
    ----------
    rows : Loader
        Looks at a run's rows.
    preferred : list of Path
        The scene's runs; the first has to be sound.
    """
    shown, *others = preferred
    older = [run for run in others if run.name < shown.name]
    if len(older) < keep:
        return []
    _check(bundles, rows, shown)
    kept = 1
    replaced = []
    for run in older:
        if kept < keep:
            with contextlib.suppress(StoreError):
                _check(bundles, rows, run)
                kept += 1
                continue
        replaced.append(run)
    return replaced


def _check(bundles: Bundles, rows: Loader, run: Path) -> None:
    """Refuse a run that could not be shown: of its files, and of its rows."""
    with bundles.as_stored(run) as folder:
        check_bundle(folder)
    bundles.bring(run, tables_only=True)
    outcome = rows.load({run: check_bundle(run, only_tables=True)}, keep=False)
    for problem in outcome.refused.values():
        raise StoreError(problem)


def _remove(layout: Layout, bundles: Bundles, run: Path) -> None:
    bundles.remove_there(run)
    if run.is_dir():
        # Out of the bundles in one step: a run that is being removed must not look like a damaged one.
        trash = layout.staging / f"{run.name}{REMOVED}"
        run.rename(trash)
        shutil.rmtree(trash)


def export(layout: Layout, target: str, aircraft: str | None = None, panel: str | None = None) -> tuple[int, int]:
    """Copy current bundles to another place; what is there already is not copied again.

    Parameters
    ----------
    target : str
        A folder, or a URI that pyarrow knows, such as ``s3://bucket/prefix``.
    aircraft, panel : str, optional
        Only theirs.

    Returns
    -------
    (int, int)
        Runs copied, and runs that were there already.
    """
    there, bundles = Remote(target), Bundles(layout)
    copied = present = 0
    for relative in _current_paths(layout, aircraft, panel):
        run = layout.root / relative
        bundles.bring_file(run / MANIFEST)
        if there.size(f"{relative}/{MANIFEST}") == (run / MANIFEST).stat().st_size:
            present += 1
            continue
        bundles.bring(run)
        check_bundle(run)
        there.put(run, relative)
        copied += 1
    return copied, present


def _current_paths(layout: Layout, aircraft: str | None, panel: str | None) -> list[str]:
    with contextlib.closing(snapshot.connect(layout)) as connection:
        parts = [
            f"SELECT bundle_path FROM {table} WHERE ($1 IS NULL OR aircraft_serial = $1) AND ($2 IS NULL OR panel = $2)"
            for table in bookkeeping.heads(connection)
        ]
        rows = connection.execute(f"{' UNION ALL '.join(parts)} ORDER BY 1", [aircraft, panel]).fetchall()
    paths = [str(path) for (path,) in rows]
    for path in paths:
        if not (leads_inside(path) and path.startswith(f"{layout.bundles.name}/")):
            raise StoreError(f"{layout.archive}: found path {path!r}, expected one of a bundle")
    return paths


def _shown(layout: Layout) -> dict[str, str]:
    """The run of each scene that the published index shows; empty where it cannot be read."""
    with contextlib.suppress(StoreError, duckdb.Error), contextlib.closing(snapshot.connect(layout)) as connection:
        return bookkeeping.shown_runs(connection)
    return {}


def _age(run: Path) -> timedelta:
    return datetime.now(UTC) - datetime.fromtimestamp((run / MANIFEST).stat().st_mtime, UTC)

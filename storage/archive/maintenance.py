"""Keeping an archive in order: check it, make its index again, prune it, and copy it elsewhere."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from metrology.errors import StoreError
from storage.archive import index, snapshot
from storage.archive.bundle import MANIFEST, check_bundle
from storage.archive.bundles import Bundles
from storage.archive.files import disk_trouble, locked
from storage.archive.layout import Layout
from storage.archive.remote import Remote
from storage.archive.schema import TABLES
from storage.archive.signed import by_preference, signed_runs
from storage.review import ReviewLog

_CHECKING_THREADS = 4
_REMOVED = ".removed"


@dataclass(frozen=True)
class Check:
    """What a check of an archive found.

    Attributes
    ----------
    runs : int
        Bundles looked at.
    problems : tuple of str
        One line each; empty where all is well.
    """

    runs: int
    problems: tuple[str, ...]


def check(layout: Layout, on_run: Callable[[], None] = lambda: None) -> Check:
    """Compare every bundle with its checksums, and the published index with the bundles."""
    bundles = Bundles(layout)
    runs = bundles.runs()
    damaged: dict[Path, str] = {}

    def look(run: Path) -> None:
        try:
            with bundles.as_stored(run) as folder:
                check_bundle(folder)
        except StoreError as problem:
            damaged[run] = str(problem)
        on_run()

    with ThreadPoolExecutor(_CHECKING_THREADS) as threads:
        for _ in threads.map(look, runs):
            pass
    problems = [damaged[run] for run in sorted(damaged)]
    problems += _without_manifest(layout)
    problems += _index_problems(bundles, [run for run in runs if run not in damaged])
    return Check(len(runs), tuple(problems))


def rebuild(layout: Layout) -> list[str]:
    """Make the index again from the bundles alone and publish it; returns what is damaged."""
    with disk_trouble(layout.root, "the index is as it was"), locked(layout.lock):
        problems = index.rebuild(layout)
        snapshot.publish(layout)
    return problems


def prune(layout: Layout, keep: int = 1, older_than: timedelta | None = None) -> list[Path]:
    """Remove runs that newer ones have replaced; returns what was removed.

    The run that the index shows stays, and so does one that somebody signed off.

    Parameters
    ----------
    keep : int
        Runs to keep of each scene, the shown one included.
    older_than : timedelta, optional
        Remove only runs stored longer ago than this.
    """
    if keep < 1:
        raise StoreError(f"prune: found {keep} runs to keep, expected at least 1")
    review = ReviewLog(layout.root).read()
    if review.problem:
        raise StoreError(f"{review.problem}; nothing is removed until that is cleared up")
    signed, bundles = signed_runs(review), Bundles(layout)
    removed = []
    with locked(layout.lock):
        for left in layout.staging.glob(f"*{_REMOVED}"):  # by a prune that was cut short
            shutil.rmtree(left)
        shown = _shown(layout)
        former: dict[str, list[Path]] = {}
        for run in sorted(bundles.whatever_is_there(), reverse=True):
            if run.name < shown.get(run.parent.name, ""):
                former.setdefault(run.parent.name, []).append(run)
        for scene_id in sorted(former):
            for run in former[scene_id][keep - 1 :]:
                if run.name == signed.get(scene_id) or (older_than and _age(run) < older_than):
                    continue
                bundles.remove_there(run)
                if run.is_dir():
                    # Out of the bundles in one step: a run that is being removed must not look like a damaged one.
                    trash = layout.staging / f"{run.name}{_REMOVED}"
                    run.rename(trash)
                    shutil.rmtree(trash)
                removed.append(run)
        for old in layout.index.glob("work-*"):
            if not old.name.startswith(layout.work.name):
                old.unlink()
    return removed


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
        rows = connection.execute(
            "SELECT bundle_path FROM scenes WHERE ($1 IS NULL OR aircraft_serial = $1) AND ($2 IS NULL OR panel = $2) "
            "ORDER BY bundle_path",
            [aircraft, panel],
        ).fetchall()
    return [str(path) for (path,) in rows]


def _shown(layout: Layout) -> dict[str, str]:
    """The run of each scene that the published index shows."""
    if not layout.archive.exists():
        return {}
    with contextlib.closing(snapshot.connect(layout)) as connection:
        return dict(connection.execute("SELECT scene_id, run_id FROM scenes").fetchall())


def _without_manifest(layout: Layout) -> Iterator[str]:
    for run in sorted(layout.bundles.glob("*/*/*/*")):
        if not (run / MANIFEST).is_file():
            yield f"{run}: found no {MANIFEST}, expected a complete run"


def _index_problems(bundles: Bundles, sound: list[Path]) -> Iterator[str]:
    """Where the published index says something else than the undamaged bundles."""
    layout = bundles.layout
    if not layout.archive.exists():
        if sound:
            yield f"{layout.archive}: found no index, expected one of {len(sound)} runs ('flushline archive rebuild')"
        return
    signed = signed_runs(ReviewLog(layout.root).read())
    newest = {run.parent.name: run for run in reversed(by_preference(sound, signed))}
    shown = _shown(layout)
    with contextlib.closing(snapshot.connect(layout)) as connection:
        counts = {
            table.name: dict(connection.execute(f"SELECT scene_id, count(*) FROM {table.name} GROUP BY ALL").fetchall())
            for table in TABLES
        }
    for scene_id in sorted(shown.keys() - newest.keys()):
        yield f"{layout.archive}: found scene {scene_id} without an undamaged run, expected its bundle"
    for scene_id, run in sorted(newest.items()):
        if shown.get(scene_id) != run.name:
            yield f"{layout.archive}: found run {shown.get(scene_id)} of {scene_id}, expected {run.name}"
            continue
        bundles.bring_file(run / MANIFEST)
        rows = json.loads((run / MANIFEST).read_text(encoding="utf-8"))["rows"]
        for table, expected in rows.items():
            if counts[table].get(scene_id, 0) != expected:
                found = counts[table].get(scene_id, 0)
                yield f"{layout.archive}: found {found} rows of {scene_id} in {table}, expected {expected}"


def _age(run: Path) -> timedelta:
    return datetime.now(UTC) - datetime.fromtimestamp((run / MANIFEST).stat().st_mtime, UTC)

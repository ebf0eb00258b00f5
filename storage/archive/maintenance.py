"""Keeping an archive in order: check it, make its index again, compact, prune, and copy it elsewhere."""

from __future__ import annotations

import contextlib
import json
import shutil
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from metrology.errors import StoreError
from storage.archive import index, snapshot
from storage.archive.bundle import MANIFEST, check_bundle
from storage.archive.files import disk_trouble, locked, make_folders, point_to, sync
from storage.archive.layout import Layout
from storage.archive.schema import TABLES
from storage.archive.signed import by_preference, signed_runs
from storage.review import ReviewLog

if TYPE_CHECKING:
    import duckdb
    from pyarrow.fs import FileSystem

_CHECKING_THREADS = 4
_KEPT_COMPACTIONS = 2
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
    runs = [manifest.parent for manifest in layout.runs()]
    damaged: dict[Path, str] = {}

    def look(run: Path) -> None:
        try:
            check_bundle(run)
        except StoreError as problem:
            damaged[run] = str(problem)
        on_run()

    with ThreadPoolExecutor(_CHECKING_THREADS) as threads:
        for _ in threads.map(look, runs):
            pass
    problems = [damaged[run] for run in sorted(damaged)]
    problems += _without_manifest(layout)
    problems += _index_problems(layout, [run for run in runs if run not in damaged])
    return Check(len(runs), tuple(problems))


def rebuild(layout: Layout) -> list[str]:
    """Make the index again from the bundles alone and publish it; returns what is damaged."""
    with disk_trouble(layout.root, "the index is as it was"), locked(layout.lock):
        problems = index.rebuild(layout)
        snapshot.publish(layout)
    return problems


def compact(layout: Layout) -> Path:
    """Write the tables as a few Parquet files, partitioned by aircraft, for engines other than DuckDB.

    `parquet` in the store points to the newest; the one before stays for whoever reads it just now.
    """
    target = layout.index / f"parquet-{time.time_ns():020d}"
    with disk_trouble(layout.root, "parquet is as it was"), locked(layout.lock):
        try:
            with index.writing(layout) as connection:
                _write_parquet(connection, layout, target)
        except BaseException:
            shutil.rmtree(target, ignore_errors=True)
            raise
        point_to(layout.parquet, target)
        for old in sorted(layout.index.glob("parquet-*"))[:-_KEPT_COMPACTIONS]:
            shutil.rmtree(old)
    return layout.parquet


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
    signed = signed_runs(review)
    removed = []
    with locked(layout.lock):
        for left in layout.staging.glob(f"*{_REMOVED}"):  # by a prune that was cut short
            shutil.rmtree(left)
        shown = _shown(layout)
        for scene in sorted(layout.bundles.glob("*/*/*")):
            former = sorted((run for run in scene.iterdir() if run.name < shown.get(scene.name, "")), reverse=True)
            for run in former[keep - 1 :]:
                if run.name == signed.get(scene.name) or (older_than and _age(run) < older_than):
                    continue
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
    from pyarrow import fs

    filesystem, base = _destination(target)
    local = fs.LocalFileSystem()
    copied = present = 0
    for relative in _current_paths(layout, aircraft, panel):
        source, destination = layout.root / relative, f"{base}/{relative}"
        manifest = f"{destination}/{MANIFEST}"
        size = (source / MANIFEST).stat().st_size
        if filesystem.get_file_info(manifest).size == size:
            present += 1
            continue
        check_bundle(source)
        filesystem.create_dir(destination, recursive=True)
        # The manifest comes last: a run with one is complete there, too.
        files = sorted(source.iterdir(), key=lambda path: (path.name == MANIFEST, path.name))
        for path in files:
            fs.copy_files(str(path), f"{destination}/{path.name}", local, filesystem)
        copied += 1
    return copied, present


def _destination(target: str) -> tuple[FileSystem, str]:
    from pyarrow import ArrowInvalid, fs

    if "://" not in target:
        return fs.LocalFileSystem(), str(Path(target).absolute())
    try:
        filesystem, base = fs.FileSystem.from_uri(target)
    except (ArrowInvalid, OSError) as problem:
        text = str(problem).splitlines()[0]
        raise StoreError(f"{target}: found {text}, expected a folder or a URI such as s3://bucket/prefix") from None
    return filesystem, base.rstrip("/")


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


def _write_parquet(connection: duckdb.DuckDBPyConnection, layout: Layout, target: Path) -> None:
    for table in TABLES:
        folder = target / table.name
        make_folders(folder, layout.root)
        connection.execute(
            f"COPY (FROM {table.name} ORDER BY aircraft_serial, panel, captured_at) TO '{_quoted(folder)}' "
            "(FORMAT parquet, COMPRESSION zstd, PARTITION_BY (aircraft_serial), WRITE_PARTITION_COLUMNS true)"
        )
    for path in target.rglob("*"):
        sync(path)


def _without_manifest(layout: Layout) -> Iterator[str]:
    for run in sorted(layout.bundles.glob("*/*/*/*")):
        if not (run / MANIFEST).is_file():
            yield f"{run}: found no {MANIFEST}, expected a complete run"


def _index_problems(layout: Layout, sound: list[Path]) -> Iterator[str]:
    """Where the published index says something else than the undamaged bundles."""
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
        rows = json.loads((run / MANIFEST).read_text(encoding="utf-8"))["rows"]
        for table, expected in rows.items():
            if counts[table].get(scene_id, 0) != expected:
                found = counts[table].get(scene_id, 0)
                yield f"{layout.archive}: found {found} rows of {scene_id} in {table}, expected {expected}"


def _age(run: Path) -> timedelta:
    return datetime.now(UTC) - datetime.fromtimestamp((run / MANIFEST).stat().st_mtime, UTC)


def _quoted(path: Path) -> str:
    return str(path).replace("'", "''")

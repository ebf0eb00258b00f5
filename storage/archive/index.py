"""What is done to an index: bring in runs, and catch up with all bundles.

An index is one DuckDB file with the rows of all scenes. It can be made again from the bundles at any time. Nobody
changes one that is published: the next generation is made beside it (see `generations`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path

import duckdb

from metrology.errors import StoreError
from storage.archive import bookkeeping
from storage.archive.bundle import BundleModel, check_bundle
from storage.archive.bundles import Bundles
from storage.archive.layout import Layout
from storage.archive.loading import Loader, Outcome, refuse_full_disk
from storage.archive.signed import by_preference, signed_runs
from storage.models import leads_inside

# The newest format that released command-line clients of DuckDB 1.4 and later all read.
STORAGE_FORMAT = "v1.4.0"
_RUNS_PER_LOAD = 500


def take(connection: duckdb.DuckDBPyConnection, layout: Layout, runs: Sequence[Path]) -> dict[Path, str]:
    """Put runs in place of those of their scenes; what cannot be taken is left out and named.

    An older run changes nothing, nor does another one than that on which the scene was signed off.
    """
    manifests: dict[Path, BundleModel] = {}
    refused = {}
    for run in runs:
        try:
            manifests[run] = check_bundle(run, only_tables=True)
        except StoreError as problem:
            refused[run] = str(problem)
    if not manifests:
        return refused
    scenes = sorted({manifest.scene_id for manifest in manifests.values()})
    held = bookkeeping.shown_runs(connection, scenes)
    signed = signed_runs(layout.root, sorted(held)) if held else {}
    loader = Loader(connection, layout, held)
    for run, manifest in sorted(manifests.items()):
        scene = manifest.scene_id
        if scene in held and (held[scene] >= manifest.run_id or scene in signed):
            continue
        outcome = loader.load({run: manifest})
        refused |= outcome.refused
        if outcome.loaded:
            held[scene] = manifest.run_id
    return refused


def catch_up(
    connection: duckdb.DuckDBPyConnection, layout: Layout, runs: Iterable[Path] | None = None
) -> dict[Path, str]:
    """Let an index show of each scene the run that is to be shown; what cannot be taken is left out and named.

    Parameters
    ----------
    runs : iterable of Path, optional
        All runs of the scenes to be looked at; by default of every scene.
    """
    held = bookkeeping.shown_runs(connection)
    return preferred(Loader(connection, layout, held), layout, held, runs=runs).refused


def stored_meanwhile(
    connection: duckdb.DuckDBPyConnection, layout: Layout, published: duckdb.DuckDBPyConnection
) -> list[Path]:
    """All runs of the scenes of which the published index shows another run than this one."""
    shown, held = bookkeeping.shown_runs(published), bookkeeping.shown_runs(connection)
    scenes = {layout.scene_folder(scene) for scene, run in shown.items() if held.get(scene) != run}
    bundles = Bundles(layout)
    return [run for scene in sorted(scenes) if leads_inside(layout.relative(scene)) for run in bundles.runs_of(scene)]


def preferred(
    loader: Loader, layout: Layout, held: Mapping[str, str], keep: bool = True, runs: Iterable[Path] | None = None
) -> Outcome:
    """Load of each scene the run that is to be shown.

    That is the run that was signed off, else the newest; one that cannot be taken gives way to the next.

    Parameters
    ----------
    held : mapping
        Runs that are there already, by scene.
    keep : bool
        False looks at the rows only.
    runs : iterable of Path, optional
        Those to choose from; by default all of the store.
    """
    bundles = Bundles(layout)
    waiting: dict[Path, list[Path]] = {}  # by scene, the preferred one last
    there = bundles.runs() if runs is None else runs
    for run in reversed(by_preference(there, signed_runs(layout.root))):
        waiting.setdefault(run.parent, []).append(run)
    outcome = Outcome()
    while waiting:
        batch: dict[Path, BundleModel] = {}
        for scene in list(islice(waiting, _RUNS_PER_LOAD)):
            run = waiting[scene].pop()
            is_held = held.get(scene.name) == run.name
            if is_held or not waiting[scene]:
                del waiting[scene]
            if is_held:
                continue
            try:
                bundles.bring(run, tables_only=True)
                batch[run] = check_bundle(run, only_tables=True)
            except (StoreError, FileNotFoundError) as problem:  # damaged, or pruned just now
                outcome.refused[run] = str(problem)
        loaded = loader.load(batch, keep)
        outcome.add(loaded)
        for run in loaded.loaded:
            waiting.pop(run.parent, None)
    return outcome


def fingerprint(connection: duckdb.DuckDBPyConnection) -> list[int]:
    """Equal for two indexes of the same tables that show the same runs with the same rows."""
    counts = [f"(SELECT count(*) FROM {table})" for table in bookkeeping.additions(connection)]
    [row] = connection.execute(
        f"SELECT coalesce(sum(hash(scene_id, run_id, digest)), 0), {', '.join(counts)} FROM {bookkeeping.RUNS.name}"
    ).fetchall()
    return [int(value) for value in row]


@contextlib.contextmanager
def connected(path: Path) -> Iterator[duckdb.DuckDBPyConnection]:
    """An index to be changed; what was changed is in the file itself in the end, not in a log beside it.

    Nobody relies on the file before it is complete, so whoever publishes it brings it onto the disk, once.
    """
    config: dict[str, str | bool | int | float | list[str]] = {
        "storage_compatibility_version": STORAGE_FORMAT,
        "fsync_mode": "NONE",
    }
    try:
        connection = duckdb.connect(str(path), config=config)
    except duckdb.Error as problem:
        refuse_full_disk(path, problem)
        raise StoreError(
            f"{path}: found a damaged index ({_first_line(problem)}), expected a DuckDB file; "
            "'flushline archive rebuild' makes it again"
        ) from None
    try:
        yield connection
        connection.execute("CHECKPOINT")
    except duckdb.Error as problem:
        refuse_full_disk(path, problem)
        raise StoreError(f"{path}: found {_first_line(problem)}, expected the index to take the change") from problem
    finally:
        connection.close()


def make_empty(path: Path) -> None:
    """Make an index of no runs.

    Writing down hundreds of columns and what they mean takes a fifth of a second, so a process does it once.
    """
    key = bookkeeping.own_schema(), bookkeeping.own_version()
    if key in _EMPTY:
        path.write_bytes(_EMPTY[key])
        return
    with connected(path) as connection:
        bookkeeping.start(connection)
    _EMPTY[key] = path.read_bytes()


_EMPTY: dict[tuple[str, str], bytes] = {}
"""Indexes of no runs, by what names their tables and their version."""


def _first_line(problem: Exception) -> str:
    return str(problem).splitlines()[0]

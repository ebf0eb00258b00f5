"""Runs on their way into the archive.

`.staging` has a folder RUN_ID for each, and beside it RUN_ID.json: the marker that says where the run will lie. A
writer holds its marker locked as long as it lives; the marker stays after success until the run is in the index.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from storage.archive import snapshot
from storage.archive.bundle import PATTERN
from storage.archive.bundles import Bundles
from storage.archive.files import hold, link_first, locked, make_folders, write_durably
from storage.archive.known import known_scene, refuse_rivals
from storage.archive.layout import Layout
from storage.archive.panels import PatternTaken
from storage.archive.run_ids import new_run_id
from storage.models import leads_inside

REMOVED = ".removed"
"""Ending of runs that are being pruned."""


@dataclass(frozen=True)
class StagedRun:
    """A run being written."""

    run_id: str
    folder: Path
    """Where its files are written."""
    final: Path
    """Where the folder will lie."""
    first_stored_at: datetime | None = None
    """When the scene's first run was stored; None where this is the first one."""


@contextlib.contextmanager
def staged_run(layout: Layout, scene: Path, pattern: Path, frames_digest: str | None = None) -> Iterator[StagedRun]:
    """An empty folder for a run of a scene; what is not settled in the end leaves no trace.

    A scene of which other frames are stored, or being stored, is refused.

    Parameters
    ----------
    scene : Path
        Folder of the scene's runs.
    pattern : Path
        Where the pattern of the scene's station is kept.
    frames_digest : str, optional
        Of the run's frames.
    """
    if Bundles(layout).target:  # what is known of a scene may be in the index alone
        snapshot.make_usable(layout)
    with locked(layout.lock):  # so that nobody sees the marker before it is locked
        known = known_scene(layout, scene)
        if known:
            known.refuse_other(scene.name, frames_digest, scene.name)
        refuse_rivals(layout, scene, frames_digest)
        run_id = new_run_id(layout, scene)
        run = StagedRun(run_id, layout.staging / run_id, scene / run_id, known.first_stored_at if known else None)
        marker = _marker(run.folder)
        document = {
            "run": layout.relative(run.final),
            "pattern": layout.relative(pattern),
            "frames_digest": frames_digest,
        }
        write_durably(marker, json.dumps(document).encode())
        descriptor = hold(marker)
        run.folder.mkdir()
    try:
        yield run
    except BaseException:
        if not run.final.exists():
            _remove(layout, run.folder, run.final, pattern)
        raise
    finally:
        if descriptor is not None:
            os.close(descriptor)


def settle(layout: Layout, run: StagedRun, pattern: Path) -> None:
    """Give a written run its place, and its station the pattern that the run enrols."""
    if (run.folder / PATTERN).exists():
        make_folders(pattern.parent, layout.root)
        if not link_first(run.folder / PATTERN, pattern):
            raise PatternTaken(f"{pattern}: found a pattern enrolled meanwhile, expected none")
    Bundles(layout).settle(run.folder, run.final)


def pending(layout: Layout) -> dict[Path, Path]:
    """Runs that have their place but are not in the index, by their markers; what dead writers left is removed.

    The caller holds the store's lock.
    """
    remove_pruned(layout)
    complete = {}
    for marker in sorted(layout.staging.glob("*.json")):
        run, pattern = _places(layout, marker)
        if run is not None and run.is_dir():
            complete[marker] = run
        elif (descriptor := hold(marker)) is not None:  # its writer is dead
            folder = marker.with_suffix("")
            if run is not None and Bundles(layout).arrived(run, folder):
                complete[marker] = run
            else:
                _remove(layout, folder, run, pattern)
            os.close(descriptor)
    return complete


def remove_pruned(layout: Layout) -> None:
    """Remove what a prune that was cut short had begun to; the caller holds the store's lock, as a prune does."""
    for left in layout.staging.glob(f"*{REMOVED}"):
        shutil.rmtree(left)


def _marker(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.json")


def _places(layout: Layout, marker: Path) -> tuple[Path | None, Path | None]:
    """Where a marker's run and pattern will lie; None for a marker that its writer did not finish."""
    try:
        document = json.loads(marker.read_text())
        run, pattern = str(document["run"]), str(document["pattern"])
    except (OSError, ValueError, KeyError, TypeError):
        return None, None
    if not (leads_inside(run) and leads_inside(pattern)):
        return None, None
    return layout.root / run, layout.root / pattern


def _remove(layout: Layout, folder: Path, run: Path | None, pattern: Path | None) -> None:
    """Remove a run that did not get its place, with the pattern that it had enrolled already."""
    if run:
        with contextlib.suppress(OSError):  # object storage that does not answer keeps a run without a manifest
            Bundles(layout).remove_there(run)
    own = folder / PATTERN
    if pattern and own.exists() and pattern.exists() and own.samefile(pattern):
        pattern.unlink()
    shutil.rmtree(folder, ignore_errors=True)
    _marker(folder).unlink(missing_ok=True)

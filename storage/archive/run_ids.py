"""Run ids: they sort in the order in which runs were begun in a store, whatever the clock says."""

from __future__ import annotations

import uuid
from datetime import UTC, datetime, timedelta
from pathlib import Path

from storage.archive.bundles import Bundles
from storage.archive.files import replacing
from storage.archive.layout import Layout

_FORMAT = "%Y%m%dT%H%M%S.%fZ"


def new_run_id(layout: Layout, scene_folder: Path) -> str:
    """A run id greater than every one before in the store; the caller holds the store's lock."""
    newest = max((_greatest(layout), *(run.name for run in scene_folder.glob("*"))))
    stamp = max(f"{datetime.now(UTC):{_FORMAT}}", _next(newest.partition("-")[0]))
    run_id = f"{stamp}-{uuid.uuid4().hex[:8]}"
    _note(layout, run_id)
    return run_id


def _greatest(layout: Layout) -> str:
    """The greatest run id that was ever given; where the note of it is lost, of the runs that are there."""
    try:
        return layout.newest_run.read_text(encoding="ascii").strip()
    except (OSError, ValueError):
        runs = Bundles(layout).whatever_is_there()
        return max((run.name for run in (*runs, *layout.staging.glob("*"))), default="")


def _next(stamp: str) -> str:
    """The stamp a microsecond after another one; the clock may have gone back behind it."""
    try:
        return f"{datetime.strptime(stamp, _FORMAT) + timedelta(microseconds=1):{_FORMAT}}" if stamp else ""
    except (ValueError, OverflowError):
        return f"{stamp}~"  # "~" sorts after everything a time is made of


def _note(layout: Layout, run_id: str) -> None:
    with replacing(layout.newest_run) as partial:
        partial.write_text(run_id, encoding="ascii")

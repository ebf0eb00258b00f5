"""Signing a scene off: on the run that the archive shows, and on no other."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from metrology.errors import UsageError
from storage.archive import snapshot
from storage.archive.files import locked
from storage.archive.layout import Layout
from storage.review import Entry, ReviewLog


def sign_off(root: Path, who: str, scene_id: str, run_id: str, comment: str, shown: Mapping[str, Any]) -> Entry:
    """Close a scene of a store; refused where a newer run has taken the place of `run_id` meanwhile."""
    with _shown(Layout(root), scene_id, run_id):
        return ReviewLog(root).sign_off(who, scene_id, run_id, comment, shown)


@contextlib.contextmanager
def _shown(layout: Layout, scene_id: str, run_id: str) -> Iterator[None]:
    """Hold the archive while it shows a scene's run."""
    if not layout.archive.exists():
        yield
        return
    with locked(layout.lock):
        with contextlib.closing(snapshot.connect(layout)) as connection:
            newest = connection.execute("SELECT run_id FROM scenes WHERE scene_id = ?", [scene_id]).fetchone()
        if newest and newest[0] > run_id:
            raise UsageError(
                f"{scene_id}: found that it was inspected again (run {newest[0]}), expected run {run_id}; "
                "look at the new result first"
            )
        yield

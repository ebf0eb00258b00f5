"""What the archive knows of a scene before another run of it is stored: which frames it has, and since when.

Two scans that were given the same key by mistake must not replace each other: the first one stored stays.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrology.errors import FlushlineError, SceneError
from storage.archive.bundle import MANIFEST, read_manifest
from storage.archive.bundles import Bundles
from storage.archive.files import hold
from storage.archive.layout import Layout
from storage.archive.rows import named_rows

if TYPE_CHECKING:
    import duckdb

# Of the table scenes.
_COLUMNS = ("scene_id", "run_id", "config_hash", "rig_hash", "frames_digest", "files_state", "first_stored_at")


@dataclass(frozen=True)
class KnownScene:
    """A scene that has a run, as its shown or newest run has it."""

    run_id: str
    config_hash: str
    rig_hash: str
    """config_hash, rig_hash: settings and limits, and rig, of that run."""
    frames_digest: str | None = None
    files_state: str | None = None
    """frames_digest, files_state: content and files of its frames; None for runs stored before these were kept."""
    first_stored_at: datetime | None = None
    """When a run of the scene was stored for the first time."""

    def refuse_other(self, scene_id: str, digest: str | None, place: object) -> None:
        """Refuse frames that differ from the scene's; `place` is where they lie."""
        if self.frames_digest and digest and digest != self.frames_digest:
            raise SceneError(
                f"{place}: found other frames than those stored as {scene_id} (run {self.run_id}), expected another "
                "captured_at or station for another scan; the stored result stays"
            )


def known_scenes(layout: Layout) -> dict[str, KnownScene]:
    """Every scene of the published index, by its id."""
    from storage.archive import snapshot

    if not layout.archive.exists():
        return {}
    with contextlib.closing(snapshot.connect(layout)) as connection:
        return _from_index(connection)


def known_scene(layout: Layout, scene: Path) -> KnownScene | None:
    """What is known of one scene, from its runs' manifests; None where it has no run.

    The caller may hold the store's lock, and then has called `snapshot.make_usable` before it took it.

    Parameters
    ----------
    scene : Path
        Folder of the scene's runs.
    """
    from storage.archive import snapshot

    runs = [known for manifest in sorted(scene.glob(f"*/{MANIFEST}")) for known in _from_manifest(manifest.parent)]
    if not runs and Bundles(layout).target and layout.archive.exists():
        with contextlib.closing(snapshot.connect(layout, mend=False)) as connection:
            return _from_index(connection, scene.name).get(scene.name)
    if not runs:
        return None
    newest = runs[-1]
    digest = next((run.frames_digest for run in reversed(runs) if run.frames_digest), None)
    first = min((run.first_stored_at for run in runs if run.first_stored_at), default=None)
    return replace(newest, frames_digest=digest, first_stored_at=first)


def refuse_rivals(layout: Layout, scene: Path, digest: str | None) -> None:
    """Refuse a scene of which another process is storing other frames just now; the caller holds the store's lock."""
    for marker in sorted(layout.staging.glob("*.json")):
        rival = _marked(marker)
        if layout.root / str(rival.get("run")) != scene / marker.stem:
            continue
        other = rival.get("frames_digest")
        if digest and other and other != digest and _is_held(marker):
            raise SceneError(
                f"{scene.name}: found that other frames of this name are being stored just now, expected another "
                "captured_at or station for another scan"
            )


def stored_at(run_id: str) -> datetime | None:
    """When a run was stored, as its id says."""
    try:
        return datetime.strptime(run_id[:22], "%Y%m%dT%H%M%S.%f").replace(tzinfo=UTC)
    except ValueError:
        return None


def _from_index(connection: duckdb.DuckDBPyConnection, scene_id: str | None = None) -> dict[str, KnownScene]:
    """All scenes of an index, or one."""
    # An index published by an older version lacks some of the columns.
    sql = f"SELECT COLUMNS('^({'|'.join(_COLUMNS)})$') FROM scenes WHERE $1 IS NULL OR scene_id = $1"
    rows = named_rows(connection, sql, [scene_id])
    return {row.pop("scene_id"): KnownScene(**row) for row in rows}


def _from_manifest(run: Path) -> Iterator[KnownScene]:
    with contextlib.suppress(FlushlineError):  # damaged: `archive check` names it
        manifest = read_manifest(run)
        yield KnownScene(
            manifest.run_id,
            manifest.config_hash,
            manifest.rig_hash,
            manifest.frames_digest,
            manifest.files_state,
            manifest.first_stored_at or stored_at(manifest.run_id),
        )


def _marked(marker: Path) -> dict[str, Any]:
    try:
        document = json.loads(marker.read_text())
    except (OSError, ValueError):
        return {}
    return document if isinstance(document, dict) else {}


def _is_held(marker: Path) -> bool:
    try:
        descriptor = hold(marker)
    except FileNotFoundError:
        return False
    if descriptor is None:
        return True
    os.close(descriptor)
    return False

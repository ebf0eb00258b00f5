"""What a report is made of, fetched from a store."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.errors import StoreError
from metrology.kinds import DEFECT, KINDS
from metrology.tolerance import PanelSpec
from storage.archive import Store
from storage.archive.bundle import FITS, sound_file
from storage.archive.decisions import same_place
from storage.archive.known_defects import Accepted, accepted_before
from storage.archive.rows import named_rows
from storage.archive.work import Standing, open_work, standings
from storage.evidence.chain import Link, scene_links, sign_off_link, sources
from storage.fits import StoredFits, read_fits
from storage.report.redrawn import overlay_file
from storage.review import Entry, ReviewLog

Row = Mapping[str, Any]


@dataclass(frozen=True)
class SceneRecord:
    """One inspected scene."""

    scene: Row
    """Its row of the table scenes."""
    of_kind: Mapping[str, tuple[Row, ...]]
    """Its rows of the tables of features, by the names of the kinds."""
    manifest: Mapping[str, Any]
    """Of its bundle: settings, versions, registration, limits."""
    preview: NDArray[np.uint8]
    """(h, w) uint8."""
    overlay_png: bytes
    limits: PanelSpec | None
    """As the scene was judged by; None where the manifest's copy cannot be read any more."""
    decisions: tuple[Entry, ...] = ()
    """What people decided about its features, and its sign-off."""
    standings: tuple[Standing, ...] = ()
    """How its findings stand."""
    review_head: str = ""
    """Number and checksum of the last entry of the review log."""
    chain: tuple[Link, ...] = ()
    """What its values rest on."""
    fits: StoredFits = field(default_factory=lambda: StoredFits(()))
    """What its close-ups draw; none of a version that kept none."""
    overlay_shown: bytes = b""
    """The overlay in the report's language; overlay_png is as it was stored."""

    @property
    def features(self) -> tuple[Row, ...]:
        """All its rows."""
        return tuple(row for rows in self.of_kind.values() for row in rows)

    @property
    def has_common_frame(self) -> bool:
        """Whether panel coordinates are those of a specification, and not of the scan that the station enrolled."""
        spec = self.manifest.get("panel_spec", {})
        return bool(spec.get("rivets") or spec.get("seams")) and spec.get("panel") == self.scene["panel"]


@dataclass(frozen=True)
class PanelRecord:
    """The newest scan of each station of a panel of an aircraft."""

    aircraft_serial: str
    panel: str
    scenes: tuple[SceneRecord, ...]
    earlier_work: tuple[Entry, ...] = ()
    """Dispositions of earlier scans whose work is still open."""

    @property
    def features(self) -> tuple[Row, ...]:
        """All rows of all scenes."""
        return tuple(feature for scene in self.scenes for feature in scene.features)


def scene_record(store: Store, scene_id: str) -> SceneRecord:
    """A scene's current run."""
    paths = store.paths(scene_id)
    found = {
        kind.name: _rows(
            store, f"SELECT * FROM {kind.table} WHERE scene_id = ? ORDER BY {', '.join(kind.id_columns)}", scene_id
        )
        for kind in KINDS
    }
    rests_on = sources(store, scene_id)
    preview = cv2.imdecode(np.frombuffer(sound_file(paths.preview).read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
    if preview is None:
        raise StoreError(
            f"{paths.preview}: found a damaged picture, expected a PNG; 'flushline archive check' says more"
        )
    with contextlib.closing(store.connect()) as connection:
        review = ReviewLog(store.root).of_scenes(same_place(connection, scene_id))
        decisions = tuple(entry for entry in review.entries if entry.scene_id == scene_id)
        how_they_stand = standings(connection, review, scene_id)
        accepted = accepted_before(connection, review, scene_id)
    found[DEFECT.name] = tuple(_with_reason(row, accepted.get(row["defect_id"])) for row in found[DEFECT.name])
    return SceneRecord(
        rests_on.scene, found, rests_on.manifest, np.asarray(preview, np.uint8), sound_file(paths.overlay).read_bytes(),
        rests_on.limits, decisions, how_they_stand, str(ReviewLog(store.root).head()),
        (*scene_links(rests_on), sign_off_link(rests_on)), _fits(paths.bundle / FITS),
        overlay_file(store, scene_id),
    )  # fmt: skip


def _fits(path: Path) -> StoredFits:
    """What close-ups draw; none of a version that kept none."""
    return read_fits(path) if path.exists() else StoredFits(())


def _with_reason(row: Row, accepted: Accepted | None) -> Row:
    """A defect with what is known of it from earlier scans."""
    said = [row["reason"], None if accepted is None else str(accepted)]
    return {**row, "reason": "; ".join(part for part in said if part) or None}


def panel_record(store: Store, aircraft_serial: str, panel: str) -> PanelRecord:
    """The newest scan of each station of a panel."""
    found = _rows(
        store,
        "SELECT scene_id FROM latest_scenes WHERE aircraft_serial = ? AND panel = ? ORDER BY station",
        aircraft_serial,
        panel,
    )
    if not found:
        raise StoreError(f"{store.root}: found no scene of {aircraft_serial} {panel}, expected at least one")
    newest = [row["scene_id"] for row in found]
    scenes = tuple(scene_record(store, scene_id) for scene_id in newest)
    return PanelRecord(aircraft_serial, panel, scenes, _earlier_work(store, aircraft_serial, panel, newest))


def _earlier_work(store: Store, aircraft_serial: str, panel: str, newest: list[str]) -> tuple[Entry, ...]:
    found = _rows(store, "SELECT scene_id FROM scenes WHERE aircraft_serial = ? AND panel = ?", aircraft_serial, panel)
    scenes = [row["scene_id"] for row in found]
    earlier = set(scenes) - set(newest)
    with contextlib.closing(store.connect()) as connection:
        work = open_work(connection, ReviewLog(store.root).of_scenes(scenes))
    return tuple(entry for (scene_id, _), entry in work.items() if scene_id in earlier)


def _rows(store: Store, sql: str, *values: str) -> tuple[Row, ...]:
    with contextlib.closing(store.connect()) as connection:
        return tuple(named_rows(connection, sql, values))

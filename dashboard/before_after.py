"""A feature before rework and on the newest scan of its station since, as the panel page shows both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dashboard.data import Archive
from dashboard.panel_changes import rework_of
from dashboard.panels import PanelView
from dashboard.same_place import named, same_names
from dashboard.scenes import load_features, load_scene_row, surroundings
from metrology.kinds import BY_NAME
from storage.review import Feature


@dataclass(frozen=True)
class Side:
    """A feature on one scan."""

    scene: Any
    """The row of `scenes`."""
    row: Any | None
    """The row of its kind's table; None where the scan does not have it."""
    picture: NDArray[np.uint8] | None
    """(h, w): the camera's picture around it; None where its place there is not known."""


@dataclass(frozen=True)
class BeforeAfter:
    """Work on a feature that was scanned again since."""

    disposition: str
    state: str
    """One of `storage.archive.panel_rework.STATES`."""
    before: Side
    after: Side

    @property
    def same_names(self) -> bool:
        """Whether a name means the same feature on both scans: the panel was recognised on each."""
        sides = (self.before, self.after)
        return all(same_names(side.scene, str(getattr(side.row, "feature_id", ""))) for side in sides)


def before_and_after(archive: Archive, view: PanelView, chosen: Feature) -> BeforeAfter | None:
    """The last work on a feature of the panel that a later scan of its station shows; None where there is none."""
    rows = rework_of(archive, view)
    rows = rows[(rows["feature_kind"] == chosen.kind) & (rows["panel_feature"] == chosen.id)]
    for work in rows.sort_values("decided_at", ascending=False, kind="stable").itertuples():
        before = load_scene_row(archive, str(work.scene_id))
        after = _newest(archive, before) if before is not None else None
        if before is not None and after is not None and after.captured_at > before.captured_at:
            sides = (_side(archive, scene, work) for scene in (before, after))
            return BeforeAfter(str(work.disposition), str(work.state), *sides)
    return None


def _newest(archive: Archive, scene: Any) -> Any | None:
    """The newest scan of a scan's station."""
    rows = archive.rows(
        "SELECT scene_id FROM latest_scenes WHERE aircraft_serial = ? AND panel = ? AND station = ?",
        [scene.aircraft_serial, scene.panel, scene.station],
    )
    return load_scene_row(archive, str(rows["scene_id"].iloc[0])) if len(rows) else None


def _side(archive: Archive, scene: Any, work: Any) -> Side:
    kind = BY_NAME[str(work.feature_kind)]
    row = named(kind, load_features(archive, scene, [kind])[kind.name], str(work.name), work.at_mm)
    return Side(scene, row, surroundings(archive, scene, row))

"""Defects that earlier scans of a station had: their places, and whether somebody has accepted them as they are."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from datetime import datetime
from math import hypot
from typing import TYPE_CHECKING

from metrology.defects.row import Defect
from metrology.kinds import DEFECT
from metrology.results import SceneKey
from storage.archive.layout import Layout
from storage.review import Review

if TYPE_CHECKING:
    import duckdb

_COLUMNS = ("defect_id", "kind", "length_mm", "x_panel_mm", "y_panel_mm", "z_panel_mm", "u_px", "v_px")
_ACCEPTED = "use as is"


@dataclass(frozen=True)
class Accepted:
    """A defect of a scan that was accepted on an earlier one."""

    defect_id: str
    who: str
    at: datetime
    """When it was accepted."""
    change_mm: float | None
    change_u95_mm: float | None
    """change_mm, change_u95_mm: of its depth since then; None where one of the two was not measured."""

    def __str__(self) -> str:
        since = "its depth was not measured both times"
        if self.change_mm is not None and self.change_u95_mm is not None:
            grown = "more than" if abs(self.change_mm) > self.change_u95_mm else "no more than"
            since = f"depth since then {self.change_mm:+.3f} ± {self.change_u95_mm:.3f} mm, {grown} its uncertainty"
        return f"known: accepted as it is on {self.at:%Y-%m-%d} by {self.who}; {since}"


def earlier_defects(layout: Layout, key: SceneKey) -> list[Defect]:
    """Those that the published scans of a station have in the panel's frame, the newest scan's first."""
    from storage.archive import snapshot

    if not layout.archive.exists():
        return []
    with contextlib.closing(snapshot.connect(layout)) as connection:
        if not _has_table(connection):
            return []
        found = connection.execute(
            f"SELECT {', '.join(_COLUMNS)} FROM defects WHERE aircraft_serial = ? AND panel = ? AND station = ? "
            "AND x_panel_mm IS NOT NULL ORDER BY captured_at DESC",
            [key.aircraft_serial, key.panel, key.station],
        ).fetchall()
    names = [dict(zip(_COLUMNS, row, strict=True)) for row in found]
    return [Defect(**row, x_mm=None, y_mm=None, z_mm=None) for row in names]


def accepted_before(connection: duckdb.DuckDBPyConnection, review: Review, scene_id: str) -> dict[str, Accepted]:
    """Defects of a scan that were accepted on an earlier scan of its station, the last acceptance of each."""
    if not _has_table(connection):
        return {}
    pairs = connection.execute(
        "SELECT e.scene_id, d.defect_id, d.depth_mm - e.depth_mm, d.depth_u95_mm, e.depth_u95_mm FROM defects d "
        "JOIN defects e USING (aircraft_serial, panel, station, defect_id) WHERE d.scene_id = ? "
        "AND e.captured_at < d.captured_at AND d.x_panel_mm IS NOT NULL AND e.x_panel_mm IS NOT NULL",
        [scene_id],
    ).fetchall()
    changes = {(scene, name): values for scene, name, *values in pairs}
    found: dict[str, Accepted] = {}
    for entry in sorted(review.current().values(), key=lambda entry: entry.number):
        feature = entry.feature
        if feature is None or feature.kind != DEFECT.name or (entry.scene_id, feature.id) not in changes:
            continue
        if entry.disposition != _ACCEPTED:
            found.pop(feature.id, None)
            continue
        change, u95, u95_then = changes[entry.scene_id, feature.id]
        both = None if change is None else hypot(u95, u95_then)
        found[feature.id] = Accepted(feature.id, entry.who, entry.at, change, both)
    return found


def _has_table(connection: duckdb.DuckDBPyConnection) -> bool:
    """An index of an older version has none."""
    found = connection.execute("SELECT 1 FROM duckdb_tables() WHERE table_name = 'defects'").fetchone()
    return found is not None

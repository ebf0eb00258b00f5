"""An inspected scene of the store as its panel's pattern."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from typing import Any

from metrology.errors import StoreError
from metrology.kinds import RIVET, SEAM_STATION, Kind
from metrology.panel import PanelLayout
from metrology.registration import enrol, enrolment_doubts
from metrology.registration.relabel import UNLISTED
from metrology.results import MISSING, Rivet, SceneKey, SeamStation
from storage.archive.rows import named_rows, result_of
from storage.archive.store import Store


def pattern_of(store: Store, scene_id: str) -> tuple[SceneKey, PanelLayout]:
    """The pattern that a scene would enrol: what was found in it, by the ids it has in the tables.

    What was in no pattern before gets the next free number.
    """
    rivets = _listed(_rows(store, RIVET, scene_id))
    stations: list[SeamStation] = _rows(store, SEAM_STATION, scene_id)
    with contextlib.closing(store.connect()) as connection:
        key = connection.execute(
            "SELECT aircraft_serial, panel, station, captured_at FROM scenes WHERE scene_id = ?", [scene_id]
        ).fetchone()
    cloud = store.load_cloud(scene_id)  # refuses a scene that the store does not hold
    if key is None or not (rivets or stations):
        raise StoreError(f"{scene_id}: found neither rivets nor seams in it, expected a scene that can be a pattern")
    scene = SceneKey(*key)
    layout = enrol(rivets, stations, cloud.points, scene.station).enrolled
    return scene, layout or PanelLayout()


def doubts_of(store: Store, scene_id: str) -> tuple[str, ...]:
    """Why nobody can vouch for what was found in an inspected scene; the store keeps the left camera's flags."""
    cloud = store.load_cloud(scene_id)
    with contextlib.closing(store.connect()) as connection:
        [(rig_verdict, registration)] = connection.execute(
            "SELECT rig_verdict, registration FROM scenes WHERE scene_id = ?", [scene_id]
        ).fetchall()
    doubts = enrolment_doubts({"left": cloud.flags}, rig_verdict)
    return doubts or (("its inspection found it unfit",) if registration == "not enrolled" else ())


def _rows(store: Store, kind: Kind, scene_id: str) -> list[Any]:
    """The rows of a scene that were found, not those that say that something is missing."""
    with contextlib.closing(store.connect()) as connection:
        found = f"scene_id = ? AND NOT starts_with(coalesce(reason, ''), '{MISSING}:')"
        rows = named_rows(connection, f"FROM {kind.table} WHERE {found} ORDER BY ALL", [scene_id])
        return [result_of(kind.row_type, row) for row in rows]


def _listed(rivets: Sequence[Rivet]) -> list[Rivet]:
    known = {rivet.rivet_id for rivet in rivets}
    free = (name for k in count(1) if (name := f"R{k:02d}") not in known)
    return [
        replace(rivet, rivet_id=next(free)) if UNLISTED in (rivet.reason or "") else rivet
        for rivet in sorted(rivets, key=lambda rivet: rivet.rivet_id)
    ]

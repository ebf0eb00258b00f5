"""One scene as the pages need it."""

from __future__ import annotations

from typing import Any

import numpy as np

from dashboard.data import Archive
from dashboard.figures.scene import SceneFeatures
from metrology.errors import FlushlineError
from metrology.tolerance import Limit
from storage.archive.schema import RIVETS, SCENES, SEAM_STATIONS, Table
from storage.archive.work import STATION_ID
from storage.review import Feature


def load_scene_row(archive: Archive, scene_id: str) -> Any | None:
    """The row of `scenes`; None where there is no such scene."""
    rows = archive.rows(f"SELECT {_names(SCENES)} FROM scenes WHERE scene_id = ?", [scene_id])
    return next(rows.itertuples(), None)


def load_features(archive: Archive, scene: Any) -> SceneFeatures:
    """Rivets and seam stations of a row of `scenes`."""
    # The time adds nothing but speed: rows lie about in its order, so most of a table need not be looked at.
    this, key = "captured_at = ? AND scene_id = ?", [scene.captured_at.to_pydatetime(), str(scene.scene_id)]
    rivets = archive.rows(f"SELECT {_names(RIVETS)} FROM rivets WHERE {this} ORDER BY rivet_id", key)
    stations = archive.rows(
        f"SELECT {_names(SEAM_STATIONS)}, {STATION_ID} AS feature_id FROM seam_stations WHERE {this} "
        "ORDER BY seam_id, s_mm",
        key,
    )
    # What is not finite is not a measurement.
    return SceneFeatures(*(rows.replace([np.inf, -np.inf], np.nan) for rows in (rivets, stations)))


def worst_feature(features: SceneFeatures) -> Feature | None:
    """What to look at first: the gravest finding, else the first rivet or station."""
    grave = {"fail": 0, "conditional fail": 1, "not measured": 2, "conditional pass": 3}
    candidates = [
        (grave.get(row.decision, 4), -_size(row.height_mean_mm), Feature("rivet", str(row.rivet_id)))
        for row in features.rivets.itertuples()
    ] + [
        (grave.get(row.decision, 4), -_size(row.step_mm), Feature("seam station", str(row.feature_id)))
        for row in features.stations.itertuples()
    ]
    return min(candidates, key=lambda entry: entry[:2])[2] if candidates else None


def find_feature(features: SceneFeatures, feature: Feature) -> Any | None:
    """The row that a feature names; None where the scene has none."""
    rows, name = (features.rivets, "rivet_id") if feature.kind == "rivet" else (features.stations, "feature_id")
    return next(rows[rows[name] == feature.id].itertuples(), None)


def seam_neighbours(features: SceneFeatures, station: Any, reach_mm: float = 12.0) -> np.ndarray:
    """(n, 3) midpoints of the seam's stations within `reach_mm` of one, in the order of s."""
    rows = features.stations
    near = (rows["seam_id"] == station.seam_id) & ((rows["s_mm"] - station.s_mm).abs() <= reach_mm)
    return rows[near].sort_values("s_mm")[["x_mm", "y_mm", "z_mm"]].to_numpy(float)


def limits_used(archive: Archive, bundle: object, zone: object) -> dict[str, Limit]:
    """The limits that a scene was judged by, by quantity, from its bundle's manifest; empty where it has none."""
    from metrology.errors import StoreError
    from storage.documents import read_json

    try:
        spec = read_json(archive.file(f"{bundle}/manifest.json"), StoreError).get("panel_spec") or {}
        zones = spec.get("zones") or {}
        chosen = zones.get(str(zone)) or zones.get("default") or {}
        return {name: Limit(**values) for name, values in chosen.items() if isinstance(values, dict)}
    except (FlushlineError, TypeError, AttributeError, ValueError):
        return {}


def _names(table: Table) -> str:
    """The table's columns, so that an index of another version is told at once."""
    return ", ".join(column.name for column in table.columns)


def _size(value: object) -> float:
    number = float(value) if isinstance(value, (int, float, np.number)) else float("nan")
    return abs(number) if np.isfinite(number) else 0.0

"""One scene as the pages need it."""

from __future__ import annotations

from typing import Any

import numpy as np

from dashboard.data import Archive
from dashboard.figures.scene import SceneFeatures
from metrology.requirements import Requirement, rivet_requirements, station_requirements
from metrology.results import Rivet, SeamStation
from metrology.verdicts import OPEN, gravity
from storage.archive.rows import result_of
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
    candidates = [
        (_grave(row.decision), -_size(row.height_mean_mm), Feature("rivet", str(row.rivet_id)))
        for row in features.rivets.itertuples()
    ] + [
        (_grave(row.decision), -_size(row.step_mm), Feature("seam station", str(row.feature_id)))
        for row in features.stations.itertuples()
    ]
    return min(candidates, key=lambda entry: entry[:2])[2] if candidates else None


def find_feature(features: SceneFeatures, feature: Feature) -> Any | None:
    """The row that a feature names; None where the scene has none."""
    rows, name = (features.rivets, "rivet_id") if feature.kind == "rivet" else (features.stations, "feature_id")
    return next(rows[rows[name] == feature.id].itertuples(), None)


def requirements(archive: Archive, bundle: object, chosen: Feature, row: Any) -> list[Requirement] | None:
    """What a feature's row must meet, by the specification that judged it; None where that cannot be read."""
    spec = archive.specification(bundle)
    if spec is None:
        return None
    if chosen.kind == "rivet":
        return rivet_requirements(result_of(Rivet, row._asdict()), spec)
    return station_requirements(result_of(SeamStation, row._asdict()), spec)


def _names(table: Table) -> str:
    """The table's columns, so that an index of another version is told at once."""
    return ", ".join(column.name for column in table.columns)


def _grave(decision: object) -> int:
    """Rank of what a person must look at; all the rest is alike."""
    return min(gravity(str(decision)), len(OPEN))


def _size(value: object) -> float:
    number = float(value) if isinstance(value, (int, float, np.number)) else float("nan")
    return abs(number) if np.isfinite(number) else 0.0

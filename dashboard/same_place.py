"""What other scans have at the place of a feature: other nights of its station, and other aircraft."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from dashboard.data import Archive
from dashboard.figures.scene import SceneFeatures
from dashboard.panels import InScan, name_at
from dashboard.scenes import load_features
from metrology.kinds import BY_NAME, Kind
from storage.archive.work import NEAR_MM
from storage.review import Feature

_PLACE = ["x_panel_mm", "y_panel_mm", "z_panel_mm"]


@dataclass(frozen=True)
class There:
    """What a scan has at the place of another one's feature."""

    features: SceneFeatures
    """All that the scan has of the feature's kind."""
    feature: Feature | None
    """Its name there; None where nothing is there."""
    by_name: bool
    """Whether the name alone tells that it is the same one: without a pattern no scan knows the panel's frame."""
    comparable: bool = True
    """Whether there is a way to tell: the names of a scan whose panel was not recognised are its own."""


def scans_of_place(archive: Archive, scene: Any, without: tuple[str, ...]) -> pd.DataFrame:
    """All scans of a scan's panel and station, of all aircraft, in the order of time.

    Columns: scene_id, aircraft_serial, captured_at.

    Parameters
    ----------
    without : tuple of str
        Patterns of serial numbers that are no aircraft; the scan's own stays.
    """
    others = "".join(" AND NOT aircraft_serial GLOB ?" for _ in without)
    return archive.rows(
        "SELECT scene_id, aircraft_serial, captured_at FROM scenes WHERE panel = ? AND station = ? "
        f"AND (aircraft_serial = ? OR (true{others})) ORDER BY captured_at, scene_id",
        [scene.panel, scene.station, scene.aircraft_serial, *without],
    )


def same_names(scene: Any, name: str) -> bool:
    """Whether a name of a scan means the same feature on others: not where its panel's pattern was not found on it."""
    return scene.registration != "not recognised" and not (name.startswith("X") and (scene.n_unlisted or 0) > 0)


def at_same_place(archive: Archive, found: InScan, scene: Any) -> There:
    """What a scan has where another one has a feature: by its place in the panel's frame, else by its name."""
    kind = BY_NAME[found.feature.kind]
    features = load_features(archive, scene, [kind])
    own, rows = found.features[kind.name], features[kind.name]
    row = own[own["feature_id"] == found.feature.id].iloc[0]
    at = row[_PLACE].to_numpy(float)
    if np.isfinite(at).all() and np.isfinite(rows[_PLACE].to_numpy(float)).any():
        name = name_at(rows, _PLACE, at)
        return There(features, Feature(kind.name, name) if name else None, by_name=False)
    column, *positions = kind.id_columns
    if not (same_names(found.scene, str(row[column])) and same_names(scene, str(row[column]))):
        return There(features, None, by_name=True, comparable=False)
    same = named(kind, rows, str(row[column]), float(row[positions[0]]) if positions else 0.0)
    return There(features, Feature(kind.name, str(same.feature_id)) if same is not None else None, by_name=True)


def named(kind: Kind, rows: pd.DataFrame, name: str, at_mm: float) -> Any | None:
    """The row of that name; of positions the nearest one, where it is near."""
    column, *positions = kind.id_columns
    rows = rows[rows[column] == name]
    if positions:
        distance = (rows[positions[0]] - at_mm).abs().sort_values()
        rows = rows.loc[distance[distance <= NEAR_MM].index]
    return next(rows.itertuples(), None)

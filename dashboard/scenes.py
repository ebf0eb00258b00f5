"""One scene as the pages need it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dashboard.data import Archive
from dashboard.figures.scene import SceneFeatures
from dashboard.pictures import around, load_picture
from metrology.kinds import BY_NAME, KINDS, Kind
from metrology.requirements import Requirement
from metrology.requirements import requirements as what_is_required
from metrology.tolerance import PanelSpec
from metrology.verdicts import OPEN, gravity
from storage.archive.rows import result_of
from storage.archive.schema import OF_KIND, SCENES, Table
from storage.review import Feature

_REACH = 90 / 1624
"""From a feature to the sides of the picture around it, of the whole picture's width."""
_LEAST_PX = 20.0


def load_scene_row(archive: Archive, scene_id: str) -> Any | None:
    """The row of `scenes`; None where there is no such scene."""
    return next(iter(load_scene_rows(archive, [scene_id])), None)


def load_scene_rows(archive: Archive, scene_ids: Sequence[str]) -> list[Any]:
    """The rows of `scenes` in this order; scenes that there are not are left out."""
    if not scene_ids:
        return []
    among = ", ".join("?" * len(scene_ids))
    rows = archive.rows(f"SELECT {_names(SCENES)} FROM scenes WHERE scene_id IN ({among})", scene_ids)
    found = {str(row.scene_id): row for row in rows.itertuples()}
    return [found[scene_id] for scene_id in scene_ids if scene_id in found]


def load_features(archive: Archive, scene: Any, kinds: Sequence[Kind] = KINDS) -> SceneFeatures:
    """What was found on a row of `scenes`."""
    # The time adds nothing but speed: rows lie about in its order, so most of a table need not be looked at.
    key = [scene.captured_at.to_pydatetime(), str(scene.scene_id)]
    found = {
        kind.name: archive.rows(
            f"SELECT {_names(OF_KIND[kind.name])}, {kind.id_sql} AS feature_id FROM {kind.table} "
            f"WHERE captured_at = ? AND scene_id = ? ORDER BY {', '.join(kind.id_columns)}",
            key,
        )
        for kind in kinds
    }
    # What is not finite is not a measurement.
    return {name: rows.replace([np.inf, -np.inf], np.nan) for name, rows in found.items()}


def worst_feature(features: SceneFeatures) -> Feature | None:
    """What to look at first: the gravest finding, else the first feature."""
    candidates = [
        (_grave(decision), -_size(value), kind.name, str(name))
        for kind in KINDS
        for decision, value, name in _columns(features[kind.name], "decision", kind.quantities[0].column, "feature_id")
    ]
    return Feature(*min(candidates, key=lambda entry: entry[:2])[2:]) if candidates else None


def _columns(rows: pd.DataFrame, *names: str) -> Iterator[tuple[Any, ...]]:
    """Values of a few columns, row by row: whole rows of a table take much longer."""
    return zip(*(rows[name] for name in names), strict=True)


def find_feature(features: SceneFeatures, feature: Feature) -> Any | None:
    """The row that a feature names, of a stretch its worst position's; None where the scene has none."""
    rows = features[feature.kind]
    if feature.is_stretch:
        found = rows[rows["stretch"] == feature.id].sort_values("beyond_mm", ascending=False, kind="stable")
    else:
        found = rows[rows["feature_id"] == feature.id]
    return next(found.itertuples(), None)


def surroundings(archive: Archive, scene: Any, row: Any) -> NDArray[np.uint8] | None:
    """The camera's picture (h, w) around what a feature's row measured; None where its place there is not known."""
    if row is None or pd.isna(row.u_px) or pd.isna(row.v_px):
        return None
    picture = load_picture(archive.file(scene.preview_path))
    return around(picture, float(row.u_px), float(row.v_px), max(_LEAST_PX, _REACH * picture.shape[1]))


def requirements(archive: Archive, bundle: object, chosen: Feature, row: Any) -> list[Requirement] | None:
    """What a feature's row must meet, by the specification that judged it; None where that cannot be read."""
    spec = archive.specification(bundle)
    return None if spec is None else required_by(chosen, row, spec)


def required_by(chosen: Feature, row: Any, spec: PanelSpec) -> list[Requirement]:
    """What a feature's row must meet by a specification."""
    kind = BY_NAME[chosen.kind]
    return what_is_required(kind, result_of(kind.row_type, row._asdict()), spec)


def _names(table: Table) -> str:
    """The table's columns, so that an index of another version is recognised at once."""
    return ", ".join(column.name for column in table.columns)


def _grave(decision: object) -> int:
    """Rank of what a person must look at; all the rest is alike."""
    return min(gravity(str(decision)), len(OPEN))


def _size(value: object) -> float:
    number = float(value) if isinstance(value, (int, float, np.number)) else float("nan")
    return abs(number) if np.isfinite(number) else 0.0

"""Point clouds as E57 (ASTM E2807): all scans in one file, in metres, each with its pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from metrology.panel import Placement
from storage.export.clouds import M_PER_MM, SceneCloud, scene_clouds
from storage.export.formats import Place
from storage.export.subject import Subject


def write(subject: Subject, place: Place) -> list[Path]:
    """One file; points are in the rig frame, and the pose takes them to the panel's frame where that is known."""
    from pye57 import E57

    path = place.file(".e57")
    file = E57(str(path), mode="w")
    try:
        for found in scene_clouds(subject, place.store):
            rotation, translation = _pose(found.scene.placement)
            file.write_scan_raw(_points(found), name=found.scene.scene_id, rotation=rotation, translation=translation)
    finally:
        file.close()
    return [path]


def _points(found: SceneCloud) -> dict[str, np.ndarray]:
    valid = found.valid
    row, column = np.nonzero(valid)
    x, y, z = (found.cloud.points[valid].astype(np.float64) * M_PER_MM).T
    return {
        **{f"cartesian{axis}": np.ascontiguousarray(values) for axis, values in zip("XYZ", (x, y, z), strict=True)},
        "intensity": found.texture[valid].astype(np.float32),
        "rowIndex": row.astype(np.int32),
        "columnIndex": column.astype(np.int32),
    }


def _pose(placement: Placement | None) -> tuple[np.ndarray, np.ndarray]:
    """Quaternion (w, x, y, z) and translation, m."""
    if placement is None:
        return np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    return Rotation.from_matrix(placement.R).as_quat(scalar_first=True), placement.t * M_PER_MM

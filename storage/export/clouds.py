"""Point clouds for other programs: LAS, PLY and PCD, one file a scan."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metrology.errors import StoreError
from storage.cloud import StoredCloud, read_cloud
from storage.export.formats import Place
from storage.export.subject import ExportedScene, Subject, stable_uuid
from storage.frames import read_preview

if TYPE_CHECKING:
    from storage.archive.store import Store

M_PER_MM = 1e-3
_LAS_STEP_M = 1e-6  # the archive rounds to 1 µm
_LAS_GREY = 257  # from 8 to 16 bits


@dataclass(frozen=True)
class SceneCloud:
    """A scene's cloud as it is in the store, with the grey that the left camera saw."""

    scene: ExportedScene
    cloud: StoredCloud
    """Rig frame."""
    texture: NDArray[np.uint8]
    """(h, w) uint8."""

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(h, w): where there is a point."""
        return np.isfinite(self.cloud.points[..., 2])

    @property
    def points(self) -> NDArray[np.float64]:
        """(h, w, 3) in mm: in the panel's frame where the scan was recognised in it, else in the rig's."""
        points = self.cloud.points.astype(np.float64)
        return points if self.scene.placement is None else self.scene.placement.to_panel(points)

    @property
    def frame(self) -> str:
        """The frame of `points`."""
        return "rig" if self.scene.placement is None else "panel"


def scene_clouds(subject: Subject, store: Store) -> Iterator[SceneCloud]:
    """The clouds of a subject's scenes, each read when it is asked for."""
    for scene in subject.scenes:
        texture = read_preview(store.file(scene.row["preview_path"]))
        cloud = read_cloud(store.file(scene.row["cloud_path"]))
        found = SceneCloud(scene, cloud, texture)
        if not found.valid.any():
            raise StoreError(f"{scene.scene_id}: found a cloud without points, expected some to export")
        yield found


def scan_file(subject: Subject, place: Place, scene: ExportedScene, ending: str) -> Path:
    """The file of one scan: with its station in its name where there are several."""
    return place.file(ending if len(subject.scenes) == 1 else f"~{scene.row['station']}{ending}")


def write_las(subject: Subject, place: Place) -> list[Path]:
    """LAS 1.4, metres, intensity, and σ of depth as the extra dimension `sigma_z_mm`."""
    import laspy

    written = []
    for found in scene_clouds(subject, place.store):
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.add_extra_dim(laspy.ExtraBytesParams("sigma_z_mm", np.float32, "standard deviation of depth"))
        header.scales, header.offsets = np.full(3, _LAS_STEP_M), np.zeros(3)
        header.creation_date = found.scene.row["captured_at"].date()
        header.uuid = stable_uuid("cloud", found.scene.scene_id, found.scene.row["run_id"])
        header.system_identifier, header.generating_software = found.frame, "Flushline"
        las, valid = laspy.LasData(header), found.valid
        las.x, las.y, las.z = (found.points[valid] * M_PER_MM).T
        las.intensity = found.texture[valid].astype(np.uint16) * _LAS_GREY
        las.sigma_z_mm = found.cloud.sigma_z[valid]
        written.append(scan_file(subject, place, found.scene, ".las"))
        las.write(str(written[-1]))
    return written


def write_ply(subject: Subject, place: Place) -> list[Path]:
    """PLY, millimetres, grey as colour."""
    return _with_open3d(subject, place, ".ply")


def write_pcd(subject: Subject, place: Place) -> list[Path]:
    """PCD, millimetres, grey as colour."""
    return _with_open3d(subject, place, ".pcd")


def _with_open3d(subject: Subject, place: Place, ending: str) -> list[Path]:
    from storage.point_cloud import write_point_cloud

    written = []
    for found in scene_clouds(subject, place.store):
        written.append(scan_file(subject, place, found.scene, ending))
        placed = replace(found.cloud, points=found.points.astype(np.float32))
        write_point_cloud(written[-1], placed, found.texture)
    return written

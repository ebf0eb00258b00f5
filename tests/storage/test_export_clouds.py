"""Exports of clouds and surfaces, read back by programs that are not ours, point by point."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import plyfile
import pye57
import pytest
import trimesh
from pypcd4 import PointCloud

from storage.archive import Store
from tests.support.exported import SHIFT, TURN, exported, publish_hostile


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return publish_hostile(tmp_path_factory.mktemp("clouds") / "store")


@pytest.fixture(scope="module")
def expected(store: Store) -> np.ndarray:
    """Points of the scan at S1 in the panel's frame, mm."""
    (scene_id,) = store.query("SELECT scene_id FROM scenes WHERE station = 'S1'").column(0).to_pylist()
    points = store.load_cloud(scene_id).points.astype(float)
    return points[np.isfinite(points[..., 2])] @ TURN.T + SHIFT


def test_e57_holds_every_scan_with_its_pose(store: Store, expected: np.ndarray, tmp_path: Path) -> None:
    subject, files = exported(store, tmp_path, "e57")
    file = pye57.E57(str(files[".e57"]))
    assert [file.get_header(i)["name"].value() for i in range(file.scan_count)] == [s.scene_id for s in subject.scenes]
    scan = file.read_scan(0, intensity=True, row_column=True, ignore_missing_fields=True)
    found = np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], axis=-1) * 1000
    np.testing.assert_allclose(found, expected, atol=2e-4)
    assert set(np.unique(scan["intensity"])) == {90.0}
    file.close()


def test_las_holds_points_grey_and_sigma(store: Store, expected: np.ndarray, tmp_path: Path) -> None:
    _, files = exported(store, tmp_path, "las")
    las = laspy.read(files["~S1.las"])
    np.testing.assert_allclose(las.xyz * 1000, expected, atol=6e-4)
    np.testing.assert_allclose(las.sigma_z_mm, 0.006, atol=1e-6)
    assert set(np.unique(las.intensity)) == {90 * 257}


def test_ply_and_pcd_hold_points_and_grey(store: Store, expected: np.ndarray, tmp_path: Path) -> None:
    _, files = exported(store, tmp_path, "ply", "pcd")
    vertex = plyfile.PlyData.read(str(files["~S1.ply"]))["vertex"]
    np.testing.assert_allclose(np.stack([vertex[axis] for axis in "xyz"], axis=-1), expected, atol=2e-4)
    assert set(np.unique(vertex["red"])) == {90}
    np.testing.assert_allclose(PointCloud.from_path(files["~S1.pcd"]).numpy(("x", "y", "z")), expected, atol=2e-4)


@pytest.mark.parametrize(("name", "mm"), [("glb", 1000.0), ("stl", 1.0)])
def test_surfaces_are_those_of_the_cloud_and_face_the_rig(
    store: Store, expected: np.ndarray, tmp_path: Path, name: str, mm: float
) -> None:
    _, files = exported(store, tmp_path, name)
    mesh = trimesh.load(files[f"~S1.{name}"], force="mesh")
    np.testing.assert_allclose(mesh.bounds * mm, [expected.min(axis=0), expected.max(axis=0)], atol=1e-3)
    assert (mesh.face_normals @ (TURN @ [0, 0, -1]) > 0.5).all()
    # A hole of 10 by 5 pixels in a corner: it takes the squares it touches, but half of the one at its own corner.
    assert len(mesh.faces) == 2 * (47 * 63 - 10 * 5) + 1

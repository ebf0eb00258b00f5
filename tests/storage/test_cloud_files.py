"""Clouds as scanners export them, and the folders that are made of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pye57
import pytest
from pypcd4 import PointCloud

from metrology.errors import FlushlineError, SceneError
from metrology.results import SceneKey
from storage.cloud_scene import write_cloud_scene
from storage.foreign_cloud import read_depth_map, read_foreign_cloud
from storage.rig import load_rig, save_rig
from storage.scene_folder import load_any_scene
from tests.support.cloud_files import write_ply
from tests.support.rivet_scan import rig_of

ROWS, COLUMNS = 5, 7


def grid() -> np.ndarray:
    v, u = np.mgrid[:ROWS, :COLUMNS].astype(float)
    points = np.stack([u, v, 100 + u * v], axis=-1)
    points[2, 3] = np.nan
    return points


GREY = np.arange(ROWS * COLUMNS, dtype=np.uint8).reshape(ROWS, COLUMNS)


def same(found: np.ndarray, scale: float = 1.0) -> None:
    np.testing.assert_allclose(found.reshape(ROWS, COLUMNS, 3) * scale, grid(), atol=1e-4)


@pytest.mark.parametrize("comments", [("width 7", "height 5"), ("num_cols: 7", "num_rows: 5")])
def test_a_ply_tells_its_grid_in_comments(comments: tuple[str, ...], tmp_path: Path) -> None:
    found = read_foreign_cloud(write_ply(tmp_path / "a.ply", grid(), GREY, comments))
    assert found.grid == (ROWS, COLUMNS)
    same(found.points)
    assert found.grey is not None
    np.testing.assert_array_equal(found.grey.reshape(GREY.shape), GREY)


def test_a_ply_without_comments_has_no_grid(tmp_path: Path) -> None:
    found = read_foreign_cloud(write_ply(tmp_path / "a.ply", grid()))
    assert found.grid is None
    assert found.grey is None


def test_a_pcd_has_its_grid(tmp_path: Path) -> None:
    rows = np.column_stack([grid().reshape(-1, 3), GREY.ravel()]).astype(np.float32)
    cloud = PointCloud.from_points(rows, ("x", "y", "z", "intensity"), (np.float32,) * 4)
    cloud.metadata.width, cloud.metadata.height = COLUMNS, ROWS
    cloud.save(tmp_path / "a.pcd")
    found = read_foreign_cloud(tmp_path / "a.pcd")
    assert found.grid == (ROWS, COLUMNS)
    same(found.points)


def test_an_e57_is_laid_out_by_rows_and_columns_in_metres(tmp_path: Path) -> None:
    v, u = np.nonzero(np.isfinite(grid()[..., 2]))
    turned = np.random.default_rng(0).permutation(len(v))  # files need not be in order
    v, u = v[turned], u[turned]
    file = pye57.E57(str(tmp_path / "a.e57"), mode="w")
    x, y, z = (grid()[v, u] / 1000).T
    columns = {"cartesianX": x, "cartesianY": y, "cartesianZ": z, "intensity": GREY[v, u].astype(np.float32)}
    file.write_scan_raw({k: np.ascontiguousarray(c) for k, c in columns.items()} | {"rowIndex": v.astype(np.int32), "columnIndex": u.astype(np.int32)})  # fmt: skip  # noqa: E501
    file.close()
    found = read_foreign_cloud(tmp_path / "a.e57")
    assert found.grid == (ROWS, COLUMNS)
    same(found.points, found.mm)


def test_an_npz_has_points_picture_and_sigma(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=grid(), rgb=np.repeat(GREY[..., None], 3, -1), sigma=np.full(GREY.shape, 0.01))
    found = read_foreign_cloud(tmp_path / "a.npz")
    same(found.points)
    assert found.grey is not None
    assert found.sigma is not None
    np.testing.assert_array_equal(found.grey.reshape(GREY.shape), GREY)
    assert set(found.sigma) == {0.01}


def test_a_depth_map_of_16_bit_has_gaps_where_it_is_zero(tmp_path: Path) -> None:
    import cv2

    depth = np.array([[0, 5000], [5001, 65535]], np.uint16)
    cv2.imwrite(str(tmp_path / "d.png"), depth)
    np.testing.assert_array_equal(read_depth_map(tmp_path / "d.png"), [[np.nan, 5000], [5001, 65535]])
    cv2.imwrite(str(tmp_path / "e.png"), depth.astype(np.uint8))
    with pytest.raises(SceneError, match="expected a depth map"):
        read_depth_map(tmp_path / "e.png")


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n", "no end_header in its first"),
        ("a.pcd", b"no cloud", "no DATA in its first"),
        ("a.e57", b"\0" * 99, "cannot be read"),
        ("a.npz", b"PK", "cannot be read"),
        ("a.stl", b"solid", "found the ending '.stl'"),
    ],
)
def test_what_is_no_cloud_is_one_line(name: str, content: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FlushlineError, match=said) as caught:
        read_foreign_cloud(tmp_path / name)
    assert "\n" not in str(caught.value)


@pytest.fixture
def scene(tmp_path: Path, key: SceneKey) -> Path:
    rig = replace(rig_of(), right=None, projector=None)
    points = np.full((480, 640, 3), 700, np.float32)
    write_cloud_scene(tmp_path / "scene", key, rig, np.full((480, 640), 90, np.uint8), points)
    return tmp_path / "scene"


def test_a_cloud_scene_is_read_as_it_was_written(scene: Path, key: SceneKey) -> None:
    loaded = load_any_scene(scene)
    assert loaded.key == key
    rig = loaded.own_rig()
    assert rig is not None
    assert rig.right is None
    loaded.check_fits(rig)
    with pytest.raises(SceneError, match=r"640×480 pixels, expected 320×240"):
        loaded.check_fits(replace(rig, left=replace(rig.left, width=320, height=240)))


def test_a_damaged_array_is_one_line(scene: Path) -> None:
    loaded = load_any_scene(scene)
    content = (scene / "points.npy").read_bytes()
    for damaged in (content[:-8], content[:50], b"", content[:100] + b"x" * 40):
        (scene / "points.npy").write_bytes(damaged)
        with pytest.raises(SceneError, match=r"points\.npy: found"):
            loaded.points()  # type: ignore[union-attr]
    np.save(scene / "points.npy", np.zeros((480, 640), np.float32))
    with pytest.raises(SceneError, match=r"of shape \(480, 640\), expected .*\(480, 640, 3\)"):
        loaded.points()  # type: ignore[union-attr]


def test_a_rig_of_one_camera_is_written_and_read(tmp_path: Path) -> None:
    for projector in (None, rig_of().projector):
        rig = replace(rig_of(), right=None, projector=projector)
        save_rig(rig, tmp_path / "rig.json")
        found = load_rig(tmp_path / "rig.json")
        assert found.right is None
        assert list(found.devices) == list(rig.devices)

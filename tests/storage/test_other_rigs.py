"""Calibrations of other programs: one rig written in each one's convention comes back the same."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from metrology.errors import RigError
from metrology.rig import Rig
from storage.opencv_rig import load_opencv_rig

WHEN = "2026-11-02T00:00:00Z"


@pytest.fixture(scope="session")
def cameras(rig: Rig) -> Rig:
    """The small rig with lenses, and cameras that need no more than five terms."""
    lens = np.array([-0.08, 0.05, 3e-4, -2e-4, 0.01])
    return replace(rig, left=replace(rig.left, distortion=lens), right=replace(rig.right, distortion=-0.5 * lens))


def matlab(rig: Rig) -> dict[str, Any]:
    def camera(device: Any) -> dict[str, Any]:
        K = device.K + np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
        k1, k2, p1, p2, k3 = device.distortion
        return {
            "IntrinsicMatrix": K.T,
            "RadialDistortion": np.array([k1, k2, k3]),
            "TangentialDistortion": np.array([p1, p2]),
            "ImageSize": np.array([device.height, device.width], float),
        }

    return {
        "CameraParameters1": camera(rig.left),
        "CameraParameters2": camera(rig.right),
        "RotationOfCamera2": rig.right.R.T,
        "TranslationOfCamera2": rig.right.t,
    }


def as_matlab_mat(rig: Rig, folder: Path) -> list[Path]:
    savemat(folder / "stereo.mat", {"stereoParams": matlab(rig)})
    return [folder / "stereo.mat"]


def as_matlab_json(rig: Rig, folder: Path) -> list[Path]:
    (folder / "stereo.json").write_text(json.dumps(matlab(rig), default=np.ndarray.tolist))
    return [folder / "stereo.json"]


def as_kalibr(rig: Rig, folder: Path) -> list[Path]:
    def camera(device: Any) -> dict[str, Any]:
        return {
            "camera_model": "pinhole",
            "intrinsics": [float(device.K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))],
            "distortion_model": "radtan",
            "distortion_coeffs": device.distortion[:4].tolist(),
            "resolution": [device.width, device.height],
        }

    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rig.right.R, rig.right.t / 1000
    chain = {"cam0": camera(rig.left), "cam1": camera(rig.right) | {"T_cn_cnm1": pose.tolist()}}
    (folder / "camchain.yaml").write_text(yaml.safe_dump(chain))
    return [folder / "camchain.yaml"]


def as_ros(rig: Rig, folder: Path) -> list[Path]:
    base = rig.right.centre / np.linalg.norm(rig.right.centre)
    across = np.cross([0.0, 0.0, 1.0], base)
    across /= np.linalg.norm(across)
    left = np.stack([base, across, np.cross(base, across)])
    paths = []
    for name, device, shift in (
        ("left", rig.left, 0.0),
        ("right", rig.right, -np.linalg.norm(rig.right.centre) / 1000),
    ):
        projection = np.array([[500, 0, 160, 500 * shift], [0, 500, 120, 0], [0, 0, 1, 0]], float)

        def matrix(value: Any) -> dict[str, Any]:
            value = np.atleast_2d(value)
            return {"rows": value.shape[0], "cols": value.shape[1], "data": [float(v) for v in value.ravel()]}

        document = {
            "image_width": device.width,
            "image_height": device.height,
            "camera_name": name,
            "camera_matrix": matrix(device.K),
            "distortion_model": "plumb_bob",
            "distortion_coefficients": matrix(device.distortion),
            "rectification_matrix": matrix(left @ device.R.T),
            "projection_matrix": matrix(projection),
        }
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(document))
        paths.append(folder / f"{name}.yaml")
    return paths


def as_colmap(rig: Rig, folder: Path) -> list[Path]:
    lines, images = [], []
    turn = Rotation.from_euler("xyz", [10, -20, 30], degrees=True).as_matrix()
    for number, device in enumerate((rig.left, rig.right), start=1):
        fx, fy, cx, cy = (device.K[i] for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
        terms = " ".join(f"{term:.12g}" for term in device.distortion8)
        lines.append(f"{number} FULL_OPENCV {device.width} {device.height} {fx} {fy} {cx + 0.5} {cy + 0.5} {terms}")
        x, y, z, w = Rotation.from_matrix(device.R @ turn).as_quat()
        shift = " ".join(f"{t:.12g}" for t in device.R @ np.array([5.0, 6.0, 7.0]) + device.t)
        images.append(f"{number} {w} {x} {y} {z} {shift} {number} {'lr'[number - 1]}.png\n")
    (folder / "cameras.txt").write_text("# cameras\n" + "\n".join(lines) + "\n")
    (folder / "images.txt").write_text("# images\n" + "\n".join(images) + "\n")
    return [folder]


def plain(names: dict[str, str]) -> Callable[[Rig, Path], list[Path]]:
    def write(rig: Rig, folder: Path) -> list[Path]:
        values = {
            "K1": rig.left.K, "D1": rig.left.distortion, "K2": rig.right.K, "D2": rig.right.distortion,
            "R": rig.right.R, "T": rig.right.t, "size": np.array([rig.left.width, rig.left.height]),
        }  # fmt: skip
        np.savez(folder / "rig.npz", **{names.get(key, key): value for key, value in values.items()})
        return [folder / "rig.npz"]

    return write


@pytest.mark.parametrize(
    ("write", "terms"),
    [
        (as_matlab_mat, 5),
        (as_matlab_json, 5),
        (as_kalibr, 4),
        (as_ros, 5),
        (as_colmap, 8),
        (plain({}), 5),
        (plain({"K1": "M1", "K2": "M2", "R": "Rlr", "T": "Tlr"}), 5),
        (plain({"K1": "Kl", "K2": "Kr", "D1": "Dl", "D2": "Dr"}), 5),
        (plain({"K1": "mtx_left", "K2": "mtx_right", "D1": "dist_left", "D2": "dist_right"}), 5),
        (plain({"K1": "cameraMatrix1", "K2": "cameraMatrix2", "D1": "distCoeffs1", "D2": "distCoeffs2"}), 5),
    ],
)
def test_each_program_s_rig_is_the_same(
    cameras: Rig, tmp_path: Path, write: Callable[[Rig, Path], list[Path]], terms: int
) -> None:
    found = load_opencv_rig(write(cameras, tmp_path), "other", WHEN)
    assert found.projector is None
    for name in ("left", "right"):
        one, other = found.devices[name], cameras.devices[name]
        assert (one.width, one.height) == (other.width, other.height)
        np.testing.assert_allclose(one.K, other.K, atol=1e-9)
        np.testing.assert_allclose(one.distortion8[:terms], other.distortion8[:terms], atol=1e-9)
        np.testing.assert_allclose(one.R, other.R, atol=1e-6)
        np.testing.assert_allclose(one.t, other.t, atol=1e-4)


def test_a_lens_that_is_no_pinhole_is_refused(cameras: Rig, tmp_path: Path) -> None:
    (path,) = as_kalibr(cameras, tmp_path)
    path.write_text(path.read_text().replace("radtan", "equidistant"))
    with pytest.raises(RigError, match="equidistant, expected pinhole with radtan"):
        load_opencv_rig([path], "other", WHEN)


def test_what_is_missing_is_named(cameras: Rig, tmp_path: Path) -> None:
    (path,) = as_matlab_json(cameras, tmp_path)
    document = json.loads(path.read_text())
    del document["CameraParameters2"]
    path.write_text(json.dumps(document))
    with pytest.raises(RigError, match=r"stereo.json: found no 'CameraParameters2'"):
        load_opencv_rig([path], "other", WHEN)

"""Calibrations in conventions that names tell: directions, places in the world, quaternions, parts of matrices."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from metrology.arrays import Array
from metrology.errors import RigError
from metrology.rig import Device, Rig
from storage.opencv_rig import load_opencv_rig
from tests.support.rendered_fringes import small_rig

RIG = small_rig()
LEFT, RIGHT = RIG.left, RIG.with_right()
TO_LEFT = Rotation.from_euler("xyz", [20, -15, 5], degrees=True).as_matrix(), np.array([30.0, -50.0, 640.0])
TO_RIGHT = RIGHT.R @ TO_LEFT[0], RIGHT.R @ TO_LEFT[1] + RIGHT.t


def four(R: Array, t: Array) -> Array:
    return np.vstack([np.column_stack([R, t]), [0, 0, 0, 1]])


def lens(device: Device) -> dict[str, Any]:
    return {"K": device.K, "dist": device.distortion}


CAMERAS = {"K1": LEFT.K, "D1": LEFT.distortion, "K2": RIGHT.K, "D2": RIGHT.distortion}
QUATERNION = Rotation.from_matrix(RIGHT.R).as_quat()
DOCUMENTS: dict[str, dict[str, Any]] = {
    "from right to left": CAMERAS
    | {"R_right_to_left": RIGHT.R.T, "T_right_to_left": -RIGHT.R.T @ RIGHT.t},
    "from left to right": CAMERAS | {"R_left_to_right": RIGHT.R, "T_left_to_right": RIGHT.t},
    "one matrix back": CAMERAS | {"T_r2l": np.linalg.inv(four(RIGHT.R, RIGHT.t))},
    "cameras in the world": {
        "left": lens(LEFT) | {"c2w": np.linalg.inv(four(*TO_LEFT))},
        "right": lens(RIGHT) | {"c2w": np.linalg.inv(four(*TO_RIGHT))},
    },
    "world to each camera": {
        "left": lens(LEFT) | {"extrinsic": four(*TO_LEFT)},
        "right": lens(RIGHT) | {"extrinsic": four(*TO_RIGHT)},
    },
    "cameras named as Kalibr's": {
        f"cam{k}": {
            "intrinsics": [device.K[0, 0], device.K[1, 1], *device.K[:2, 2]],
            "distortion_coeffs": device.distortion,
            "T_world_cam": np.linalg.inv(four(*place)),
        }
        for k, (device, place) in enumerate(((LEFT, TO_LEFT), (RIGHT, TO_RIGHT)))
    },
    "a quaternion, w last": CAMERAS | {"rotation": QUATERNION, "translation": RIGHT.t},
    "a quaternion, w first": CAMERAS | {"quaternion": np.roll(QUATERNION, 1), "T": RIGHT.t},
    "a quaternion's parts": CAMERAS
    | {
        "rotation": dict(zip("xyzw", QUATERNION, strict=True)),
        "translation": dict(zip("xyz", RIGHT.t, strict=True)),
    },
    "focal lengths and principal points": {
        f"{side}_camera": {
            "focal_length": np.diag(device.K)[:2], "principal_point": device.K[:2, 2], "distortion": device.distortion
        }
        for side, device in (("left", LEFT), ("right", RIGHT))
    } | {"relative_pose": {"rotation_matrix": RIGHT.R, "translation_vector": RIGHT.t}},
}  # fmt: skip


def same(found: Rig) -> None:
    for device, true in ((found.left, LEFT), (found.with_right(), RIGHT)):
        np.testing.assert_allclose(device.K, true.K, atol=1e-6)
        np.testing.assert_allclose(device.distortion[:4], true.distortion[:4], atol=1e-9)
        np.testing.assert_allclose(device.R, true.R, atol=1e-6)
        np.testing.assert_allclose(device.t, true.t, atol=1e-4)


def load(*paths: Path) -> Rig:
    return load_opencv_rig(paths, "rig", "2026-11-02T00:00:00Z", (LEFT.width, LEFT.height))


@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_convention_is_told_by_names(name: str, tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(DOCUMENTS[name], default=lambda array: array.tolist()))
    same(load(path))


@pytest.mark.parametrize("posed", [False, True])
def test_a_file_named_after_the_projector_is_the_projectors(posed: bool, tmp_path: Path) -> None:
    """Files of one device each, its place from the world by a rotation vector, and names that say no more."""
    turn, shift = TO_LEFT if posed else (np.eye(3), np.zeros(3))
    for name, device in (("camera", LEFT), ("projector", RIGHT)):
        R, t = device.R @ turn, device.R @ shift + device.t
        values = {
            "image_size": [device.width, device.height], "intrinsic": device.K, "distortion": device.distortion,
            "rotate": Rotation.from_matrix(R).as_rotvec(), "translate": t,
        }  # fmt: skip
        (tmp_path / f"{name}_calibration.json").write_text(json.dumps(values, default=lambda array: array.tolist()))
    found = load(tmp_path / "camera_calibration.json", tmp_path / "projector_calibration.json")
    assert found.right is None
    assert found.projector is not None
    np.testing.assert_allclose(found.projector.K, RIGHT.K, atol=1e-6)
    np.testing.assert_allclose(found.projector.R, RIGHT.R, atol=1e-6)
    np.testing.assert_allclose(found.projector.t, RIGHT.t, atol=1e-4)


def test_matrices_of_a_rectification_are_not_the_cameras(tmp_path: Path) -> None:
    """OpenCV's sample writes two files, and P1 and P2 into the one without camera matrices."""
    turns = cv2.stereoRectify(
        LEFT.K, LEFT.distortion, RIGHT.K, RIGHT.distortion, (LEFT.width, LEFT.height), RIGHT.R, RIGHT.t[:, None]
    )
    written = {
        "intrinsics.yml": dict(zip(("M1", "D1", "M2", "D2"), CAMERAS.values(), strict=True)),
        "extrinsics.yml": {"R": RIGHT.R, "T": RIGHT.t} | dict(zip(("R1", "R2", "P1", "P2", "Q"), turns, strict=False)),
    }
    for name, values in written.items():
        storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
        for key, value in values.items():
            storage.write(key, np.atleast_2d(value) if key[0] == "D" else np.ascontiguousarray(value))
        storage.release()
    same(load(tmp_path / "intrinsics.yml", tmp_path / "extrinsics.yml"))
    same(load(tmp_path / "extrinsics.yml", tmp_path / "intrinsics.yml"))


def test_arrays_as_python_prints_them_are_read(tmp_path: Path) -> None:
    path = tmp_path / "calibration.txt"
    with np.printoptions(precision=17, threshold=10**6):
        path.write_text("".join(f"{n} = {a!r}\n" for n, a in (CAMERAS | {"R": RIGHT.R, "T": RIGHT.t}).items()))
    same(load(path))


def test_a_quaternion_that_leaves_its_order_open_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    half_way = Rotation.from_euler("y", 100, degrees=True).as_quat().tolist()
    path.write_text(json.dumps(CAMERAS | {"quaternion": half_way, "T": RIGHT.t}, default=lambda array: array.tolist()))
    with pytest.raises(RigError, match="whether w comes first or last cannot be told"):
        load(path)

"""Calibrations as groups publish them beside their scans: the same two cameras in each."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from metrology.arrays import Array
from metrology.errors import RigError
from metrology.rig import Device, Rig
from storage.length_units import told_unit
from storage.opencv_rig import READ_OTHERWISE, load_opencv_rig
from tests.support.rendered_fringes import small_rig

RIG = small_rig()
LEFT, RIGHT = RIG.left, RIG.with_right()
SIZE = (LEFT.width, LEFT.height)
TURN = Rotation.from_euler("xyz", [160, -15, 40], degrees=True).as_matrix()
PLACES = (TURN, np.array([30.0, -50.0, 640.0])), (RIGHT.R @ TURN, RIGHT.R @ [30.0, -50.0, 640.0] + RIGHT.t)


def four(R: Array, t: Array) -> Array:
    return np.vstack([np.column_stack([R, t]), [0, 0, 0, 1]])


def rows(matrix: Array) -> str:
    return "\n".join(" ".join(f"{value:.12g}" for value in row) for row in np.atleast_2d(matrix))


def load(paths: list[Path], size: tuple[int, int] | None = None, unit: str | None = None) -> Rig:
    return load_opencv_rig(paths, "rig", "2026-11-02T00:00:00Z", size, unit)


def same(found: Rig, lens: bool = True) -> None:
    for device, true in ((found.left, LEFT), (found.with_right(), RIGHT)):
        assert (device.width, device.height) == SIZE
        np.testing.assert_allclose(device.K, true.K, atol=1e-4)
        np.testing.assert_allclose(device.lens, true.lens * lens, atol=1e-6)
        np.testing.assert_allclose(device.R, true.R, atol=1e-5)
        np.testing.assert_allclose(device.t, true.t, atol=1e-2)


def as_matlab_73(folder: Path) -> list[Path]:
    """save -v7.3: HDF5, columns first."""
    with h5py.File(folder / "calib.mat", "w") as file:
        for name, value in (("KK_left", LEFT.K), ("KK_right", RIGHT.K), ("kc_left", LEFT.distortion[:, None]),
                            ("kc_right", RIGHT.distortion[:, None]), ("R", RIGHT.R), ("T", RIGHT.t[:, None]),
                            ("imageSize", np.array([SIZE], float))):  # fmt: skip
            file.create_dataset(name, data=value.T).attrs["MATLAB_class"] = np.bytes_(b"double")
    return [folder / "calib.mat"]


def as_ost(folder: Path) -> list[Path]:
    """What ROS prints of a stereo calibration: headings over rows in sections."""
    text = ""
    turns = cv2.stereoRectify(
        LEFT.K, LEFT.distortion, RIGHT.K, RIGHT.distortion, SIZE, RIGHT.R, RIGHT.t[:, None] / 1000
    )
    for k, (name, device) in enumerate((("left", LEFT), ("right", RIGHT))):
        text += f"# oST version 5.0 parameters\n\n\n[image]\n\nwidth\n{SIZE[0]}\n\nheight\n{SIZE[1]}\n\n"
        text += (
            f"[narrow_stereo/{name}]\n\ncamera matrix\n{rows(device.K)}\n\ndistortion\n{rows(device.distortion)}\n\n"
        )
        text += f"rectification\n{rows(turns[k])}\n\nprojection\n{rows(turns[2 + k])}\n\n"
    (folder / "ost.txt").write_text(text)
    return [folder / "ost.txt"]


def as_metashape(folder: Path) -> list[Path]:
    """One XML per camera: cx and cy from the middle, p1 and p2 the other way round; the pose in a file of its own."""
    for name, device in (("left", LEFT), ("right", RIGHT)):
        (fx, _, cx), (_, fy, cy), _ = device.K
        k1, k2, p1, p2, k3 = device.distortion
        said = {
            "projection": "frame", "width": SIZE[0], "height": SIZE[1], "f": fy, "cx": cx + 0.5 - SIZE[0] / 2,
            "cy": cy + 0.5 - SIZE[1] / 2, "b1": fx - fy, "k1": k1, "k2": k2, "k3": k3, "p1": p2, "p2": p1,
        }  # fmt: skip
        inside = "".join(f"  <{key}>{value}</{key}>\n" for key, value in said.items())
        (folder / f"{name}.xml").write_text(f'<?xml version="1.0"?>\n<calibration>\n{inside}</calibration>\n')
    (folder / "pose.json").write_text(json.dumps({"R": RIGHT.R.tolist(), "T": RIGHT.t.tolist()}))
    return [folder / "left.xml", folder / "right.xml", folder / "pose.json"]


def as_mrcal(folder: Path) -> list[Path]:
    for name, device, (R, t) in (("cam-left", LEFT, PLACES[0]), ("cam-right", RIGHT, PLACES[1])):
        lens = [device.K[0, 0], device.K[1, 1], *device.K[:2, 2], *device.lens[:8]]
        pose = [*Rotation.from_matrix(R).as_rotvec(), *t]
        (folder / f"{name}.cameramodel").write_text(
            "# generated\n{\n    'lensmodel':  'LENSMODEL_OPENCV8',\n    # fx,fy,cx,cy,distortion0,...\n"
            f"    'intrinsics': {[float(v) for v in lens]},\n    'extrinsics': {[float(v) for v in pose]},\n"
            f"    'imagersize': [ {SIZE[0]}, {SIZE[1]} ],\n}}\n"
        )
    return [folder / "cam-left.cameramodel", folder / "cam-right.cameramodel"]


def as_realsense(folder: Path) -> list[Path]:
    def camera(device: Device) -> dict[str, Any]:
        return {"width": SIZE[0], "height": SIZE[1], "fx": device.K[0, 0], "fy": device.K[1, 1], "ppx": device.K[0, 2],
                "ppy": device.K[1, 2], "coeffs": device.distortion.tolist()}  # fmt: skip

    pose = {"rotation": RIGHT.R.T.ravel().tolist(), "translation": (RIGHT.t / 1000).tolist()}
    document = {"infra1": camera(LEFT), "infra2": camera(RIGHT), "extrinsics": pose}
    (folder / "intrinsics.json").write_text(json.dumps(document))
    return [folder / "intrinsics.json"]


def as_pairs_of_colmap(folder: Path) -> list[Path]:
    """Three poses of two cameras that are fixed to each other."""
    cameras = [
        f"{k} OPENCV {SIZE[0]} {SIZE[1]} {d.K[0, 0]} {d.K[1, 1]} {d.K[0, 2] + 0.5} {d.K[1, 2] + 0.5} "
        + " ".join(map(str, d.distortion[:4]))
        for k, d in ((1, LEFT), (2, RIGHT))
    ]
    (folder / "cameras.txt").write_text("\n".join(cameras))
    text, number = "", 0
    for pose in range(3):
        moved = four(Rotation.from_euler("xyz", [3 * pose, 5 * pose, 1], degrees=True).as_matrix(), np.ones(3) * pose)
        for camera, place in enumerate(PLACES, start=1):
            number += 1
            at = four(*place) @ moved
            x, y, z, w = Rotation.from_matrix(at[:3, :3]).as_quat()
            text += f"{number} {w} {x} {y} {z} {' '.join(map(str, at[:3, 3]))} {camera} {camera}/{pose:03d}.png\n\n"
    (folder / "images.txt").write_text(text)
    return [folder]


def as_headed_lines(folder: Path) -> list[Path]:
    text = "".join(
        f"{side} Camera Intrinsic:\n{rows(device.K)}\n{side} Camera Distortion:\n{rows(device.distortion)}\n"
        for side, device in (("Left", LEFT), ("Right", RIGHT))
    )
    text += f"Rotation between cameras:\n{rows(RIGHT.R)}\nTranslation between cameras:\n{rows(RIGHT.t)}\n"
    (folder / "Calibration.txt").write_text(text + f"Image size: {SIZE[0]} {SIZE[1]}\n")
    return [folder / "Calibration.txt"]


def as_single_numbers(folder: Path) -> list[Path]:
    said: dict[str, float] = {"image_Width": SIZE[0], "image_Height": SIZE[1]}
    for name, device in (("left", LEFT), ("right", RIGHT)):
        places = {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2)}
        said |= {f"{name}_{key}": device.K[place] for key, place in places.items()}
        said |= {f"{name}_{key}": v for key, v in zip(("k1", "k2", "p1", "p2", "k3"), device.distortion, strict=True)}
    said |= {f"r{i + 1}{j + 1}": RIGHT.R[i, j] for i in range(3) for j in range(3)}
    said |= dict(zip(("tx", "ty", "tz"), RIGHT.t, strict=True))
    (folder / "calib.txt").write_text("\n".join(f"{key}: {value}" for key, value in said.items()))
    return [folder / "calib.txt"]


def as_files_of_both(folder: Path) -> list[Path]:
    """One file per camera with R and t from the world as one matrix."""
    for name, device, place in (("cam_left", LEFT, PLACES[0]), ("cam_right", RIGHT, PLACES[1])):
        np.savez(folder / f"{name}.npz", K=device.K, dist=device.distortion, RT=four(*place)[:3], image_size=SIZE)
    return [folder / "cam_left.npz", folder / "cam_right.npz"]


def document(names: dict[str, str], pose: dict[str, Any]) -> Callable[[Path], list[Path]]:
    """Cameras as tables of these names, beside a pose."""

    def write(folder: Path) -> list[Path]:
        said: dict[str, Any] = {
            name: {"K": device.K, "dist": device.distortion} | pose.get(side, {})
            for (side, name), device in zip(names.items(), (LEFT, RIGHT), strict=True)
        }
        said |= {key: value for key, value in pose.items() if key not in names} | {"image_size": SIZE}
        (folder / "rig.json").write_text(json.dumps(said, default=lambda array: array.tolist()))
        return [folder / "rig.json"]

    return write


def of_world(name: str) -> dict[str, Any]:
    return {side: {name: four(*place)} for side, place in zip(("left", "right"), PLACES, strict=True)}


PLAIN = {"left": "left", "right": "right"}
WRITERS: dict[str, Callable[[Path], list[Path]]] = {
    "MATLAB 7.3": as_matlab_73,
    "ROS's ost.txt": as_ost,
    "Metashape": as_metashape,
    "mrcal": as_mrcal,
    "RealSense": as_realsense,
    "headings over rows": as_headed_lines,
    "single numbers": as_single_numbers,
    "two files with RT": as_files_of_both,
    "world to camera": document({"left": "cam0", "right": "cam1"}, of_world("w2c")),
    "T_cam_world": document(PLAIN, of_world("T_cam_world")),
    "worldToCamera": document(PLAIN, of_world("worldToCamera")),
    "master and slave": document(
        {"left": "master", "right": "slave"}, {"R_master_to_slave": RIGHT.R, "T_master_to_slave": RIGHT.t}
    ),
    "cameras A and B": document({"left": "camA", "right": "camB"}, {"R_AB": RIGHT.R, "t_AB": RIGHT.t}),
    "target before source": document({"left": "cam0", "right": "cam1"}, {"T_cam1_cam0": four(RIGHT.R, RIGHT.t)}),
    "numbered from 1": document(
        {"left": "cam1", "right": "cam2"}, {"R_cam1_to_cam2": RIGHT.R, "T_cam1_to_cam2": RIGHT.t}
    ),
    "and back": document({"left": "cam1", "right": "cam2"}, {"T_cam2_to_cam1": four(RIGHT.R.T, -RIGHT.R.T @ RIGHT.t)}),
    "target from source": document(PLAIN, {"T_right_from_left": four(RIGHT.R, RIGHT.t)}),
    "a frame between names": document({"left": "cam0", "right": "cam1"}, {"cam1_T_cam0": four(RIGHT.R, RIGHT.t)}),
    "words run together": document(PLAIN, {"RotationLeftToRight": RIGHT.R, "TranslationLeftToRight": RIGHT.t}),
    "nothing but a direction": document(PLAIN, {"left_to_right": four(RIGHT.R, RIGHT.t)}),
    "top and bottom": document({"left": "top", "right": "bottom"}, {"R": RIGHT.R, "T": RIGHT.t}),
    "main and sub": document({"left": "main", "right": "sub"}, {"R_rel": RIGHT.R, "t_rel": RIGHT.t}),
    "infrared": document({"left": "ir1", "right": "ir2"}, {"R_0_1": RIGHT.R, "T_0_1": RIGHT.t}),
    "R12": document(PLAIN, {"R12": RIGHT.R, "t12": RIGHT.t}),
    "a unit": document(PLAIN, {"R": RIGHT.R, "T": RIGHT.t / 1000, "units": "meters"}),
    "a unit in a name": document(PLAIN, {"R": RIGHT.R, "T_m": RIGHT.t / 1000}),
}  # fmt: skip


@pytest.mark.parametrize("name", WRITERS)
def test_the_cameras_are_the_same(name: str, tmp_path: Path) -> None:
    same(load(WRITERS[name](tmp_path)))


def test_pairs_of_images_tell_the_cameras(tmp_path: Path) -> None:
    found = load(as_pairs_of_colmap(tmp_path), unit="1.0")
    np.testing.assert_allclose(found.with_right().t, RIGHT.t, atol=1e-6)
    text = (tmp_path / "images.txt").read_text().replace("2/001.png", "2/009.png").splitlines()
    (tmp_path / "images.txt").write_text("\n".join(text))
    with pytest.raises(RigError, match="found 3 pairs of images whose cameras stand up to"):
        load([tmp_path], unit="1.0")


def rectified() -> tuple[Array, Array, Array]:
    turns = cv2.stereoRectify(LEFT.K, LEFT.distortion, RIGHT.K, RIGHT.distortion, SIZE, RIGHT.R, RIGHT.t[:, None])
    return turns[2], turns[3], turns[4]


def as_q(folder: Path) -> list[Path]:
    np.savez(folder / "stereo.npz", Q=rectified()[2])
    return [folder / "stereo.npz"]


def as_baseline(folder: Path) -> list[Path]:
    first, second, _ = rectified()
    said = {"fx": first[0, 0], "fy": first[1, 1], "cx": first[0, 2], "cy": first[1, 2]}
    (folder / "calib.json").write_text(json.dumps(said | {"baseline_mm": -second[0, 3] / second[0, 0]}))
    return [folder / "calib.json"]


def as_projections_of_ros(folder: Path) -> list[Path]:
    for name, matrix in zip(("left", "right"), rectified(), strict=False):
        matrix = matrix / np.array([1, 1, 1, 1000.0])
        data = {"rows": 3, "cols": 4, "data": matrix.ravel().tolist()}
        (folder / f"{name}.yaml").write_text(json.dumps({"camera_name": name, "projection_matrix": data}))
    return [folder / "left.yaml", folder / "right.yaml"]


@pytest.mark.parametrize("write", [as_q, as_baseline, as_projections_of_ros])
def test_a_rectified_pair_needs_little(write: Callable[[Path], list[Path]], tmp_path: Path) -> None:
    found, (first, second, _) = load(write(tmp_path), SIZE), rectified()
    np.testing.assert_allclose(found.left.K, first[:, :3], atol=1e-6)
    np.testing.assert_allclose(found.with_right().K, second[:, :3], atol=1e-6)
    np.testing.assert_allclose(found.with_right().t, [second[0, 3] / second[0, 0], 0, 0], atol=1e-6)
    assert not found.with_right().distortion.any()


def as_views(folder: Path) -> list[Path]:
    """Multi-view stereo's text: 4×4 from the world, 3×3, and a range of depths; no lens."""
    for k, (device, place) in enumerate(((LEFT, PLACES[0]), (RIGHT, PLACES[1]))):
        text = f"extrinsic\n{rows(four(*place))}\n\nintrinsic\n{rows(device.K)}\n\n425.0 2.5\n"
        (folder / f"{k:08d}_cam.txt").write_text(text)
    return [folder / f"{k:08d}_cam.txt" for k in range(2)]


def test_no_distortion_at_all_is_said(tmp_path: Path) -> None:
    found = load(as_views(tmp_path), SIZE)
    same(found, lens=False)
    assert found.extra[READ_OTHERWISE] == "the files tell no distortion: pictures are taken as undistorted"


@pytest.mark.parametrize("name", ["lens_L", "foo"])
def test_what_may_be_a_lens_is_asked_for(name: str, tmp_path: Path) -> None:
    values = {"K1": LEFT.K, "K2": RIGHT.K, "R": RIGHT.R, "T": RIGHT.t, name: LEFT.distortion}
    np.savez(tmp_path / "rig.npz", **values)
    with pytest.raises(RigError, match="found no D1, D2"):
        load([tmp_path / "rig.npz"], SIZE)


def test_a_pose_whose_direction_is_open_is_asked_for(tmp_path: Path) -> None:
    """T_cam0_cam1 leads, as it is read, from camera 1; or it is from 0 to 1."""
    write = document({"left": "cam0", "right": "cam1"}, {"T_cam0_cam1": four(RIGHT.R, RIGHT.t)})
    with pytest.raises(RigError, match="found no R, T"):
        load(write(tmp_path))


def test_a_right_camera_of_another_size_keeps_it(tmp_path: Path) -> None:
    """The size that is given for the left one, as the file has it too."""
    pose = {"left": {"image_size": SIZE}, "right": {"image_size": (300, 222)}, "R": RIGHT.R, "T": RIGHT.t}
    [path] = document(PLAIN, pose)(tmp_path)
    said = json.loads(path.read_text())
    del said["image_size"]
    path.write_text(json.dumps(said))
    right = load([path], SIZE).with_right()
    assert (right.width, right.height) == (300, 222)


def test_xml_with_entities_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text('<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>')
    with pytest.raises(RigError, match="XML with entities"):
        load([tmp_path / "a.xml"])


@pytest.mark.parametrize(
    ("said", "millimetres"),
    [
        ({"unit": "mm"}, 1.0),
        ({"units": "Meters"}, 1000.0),
        ({"translation_units": "centimetre"}, 10.0),
        ({"baseline_m": 0.1}, 1000.0),
        ({"unit": "px"}, None),
        ({"unit": "mm", "length_unit": "m"}, None),
        ({"K_m": 1}, None),
    ],
)
def test_units_as_files_say_them(said: dict[str, Any], millimetres: float | None) -> None:
    assert told_unit(said) == millimetres

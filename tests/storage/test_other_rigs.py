"""Calibrations of other programs: one rig written in each one's convention comes back the same."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from metrology.errors import RigError
from metrology.rig import Rig
from storage.opencv_rig import load_opencv_rig
from tests.support.calibration_bench import bench_rig

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
        terms = " ".join(f"{term:.12g}" for term in device.lens[:8])
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


def as_bouguet(rig: Rig, folder: Path) -> list[Path]:
    """A script that the MATLAB toolbox's results were printed into, with what it says of their uncertainty."""
    lines = ["% Stereo calibration parameters:"]
    for side, device in (("left", rig.left), ("right", rig.right)):
        K, terms = device.K, " ".join(f"{term:.15g}" for term in device.distortion)
        lines += [
            f"Focal Length:  fc_{side} = [ {K[0, 0]:.15g}   {K[1, 1]:.15g} ] ± [ 1.1   1.2 ]",
            f"cc_{side} = [ {K[0, 2]:.15g} {K[1, 2]:.15g} ]; % Principal point",
            f"alpha_c_{side} = [ 0.00000 ];\nkc_{side} = [ {terms} ];",
        ]
    vector = Rotation.from_matrix(rig.right.R).as_rotvec()
    lines += [f"om = [ {' '.join(f'{v:.15g}' for v in vector)} ];", f"T = [ {'; '.join(map(str, rig.right.t))} ];"]
    lines += [f"nx = {rig.left.width};", f"ny = {rig.left.height};"]
    (folder / "Calib_Results_stereo.m").write_text("\n".join(lines))
    return [folder / "Calib_Results_stereo.m"]


def as_hdf5(rig: Rig, folder: Path) -> list[Path]:
    with h5py.File(folder / "stereo_calib_data.h5", "w") as file:
        for name, value in (("M1", rig.left.K), ("d1", rig.left.distortion[None]), ("M2", rig.right.K),
                            ("d2", rig.right.distortion[None]), ("R", rig.right.R), ("t", rig.right.t[:, None]),
                            ("image_size", [rig.left.width, rig.left.height])):  # fmt: skip
            file[name] = value
    return [folder / "stereo_calib_data.h5"]


def as_euroc(rig: Rig, folder: Path) -> list[Path]:
    """One sensor.yaml in a folder of its own per camera, each placed on a body."""
    body = np.eye(4)
    body[:3, :3], body[:3, 3] = Rotation.from_euler("xyz", [80, 10, -5], degrees=True).as_matrix(), [0.1, 0.2, 0.3]
    for name, device in (("cam0", rig.left), ("cam1", rig.right)):
        placed = np.eye(4)
        placed[:3, :3], placed[:3, 3] = device.R, device.t / 1000
        document = {
            "sensor_type": "camera",
            "T_BS": {"cols": 4, "rows": 4, "data": (body @ np.linalg.inv(placed)).ravel().tolist()},
            "resolution": [device.width, device.height],
            "camera_model": "pinhole",
            "intrinsics": [float(device.K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))],
            "distortion_model": "radial-tangential",
            "distortion_coefficients": device.distortion[:4].tolist(),
        }
        (folder / name).mkdir()
        (folder / name / "sensor.yaml").write_text(yaml.safe_dump(document))
    return [folder / name / "sensor.yaml" for name in ("cam0", "cam1")]


def as_kitti(rig: Rig, folder: Path) -> list[Path]:
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.950000e-02"]
    for name, device in (("00", rig.left), ("01", rig.right)):
        for key, value in (("S", [device.width, device.height]), ("K", device.K), ("D", device.distortion),
                           ("R", device.R), ("T", device.t / 1000), ("R_rect", np.eye(3))):  # fmt: skip
            lines.append(f"{key}_{name}: {' '.join(f'{v:.15e}' for v in np.ravel(value))}")
    (folder / "calib_cam_to_cam.txt").write_text("\n".join(lines))
    return [folder / "calib_cam_to_cam.txt"]


def as_orb_slam(rig: Rig, folder: Path) -> list[Path]:
    """OpenCV's YAML with nothing but the rectification of both cameras, in metres."""
    lines = ["%YAML:1.0", 'Camera.type: "PinHole"']
    for path, side in zip(as_ros(rig, folder), ("LEFT", "RIGHT"), strict=True):
        document = yaml.safe_load(path.read_text())
        lines += [f"{side}.height: {document['image_height']}", f"{side}.width: {document['image_width']}"]
        for key, name in (("D", "distortion_coefficients"), ("K", "camera_matrix"), ("R", "rectification_matrix"),
                          ("P", "projection_matrix")):  # fmt: skip
            value = document[name]
            lines += [f"{side}.{key}: !!opencv-matrix", f"   rows: {value['rows']}", f"   cols: {value['cols']}",
                      "   dt: d", f"   data: {value['data']}"]  # fmt: skip
    (folder / "stereo.yaml").write_text("\n".join(lines) + "\n")
    return [folder / "stereo.yaml"]


def as_camera_info(rig: Rig, folder: Path) -> list[Path]:
    """Messages as ROS prints them: lists in a row."""
    paths = []
    for path in as_ros(rig, folder):
        document = yaml.safe_load(path.read_text())
        names = {"K": "camera_matrix", "D": "distortion_coefficients", "R": "rectification_matrix",
                 "P": "projection_matrix"}  # fmt: skip
        message = {key: document[name]["data"] for key, name in names.items()}
        message |= {"width": document["image_width"], "height": document["image_height"]}
        message["distortion_model"] = "plumb_bob"
        paths.append(folder / f"{path.stem}_info.json")
        paths[-1].write_text(json.dumps(message))
    return paths


def as_nested(rig: Rig, folder: Path) -> list[Path]:
    """Cameras as tables of single numbers, the pose as one matrix."""

    def camera(device: Any) -> dict[str, Any]:
        names = ("k1", "k2", "p1", "p2", "k3")
        places = {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2)}
        intrinsics = {name: float(device.K[place]) for name, place in places.items()}
        terms = dict(zip(names, device.distortion.tolist(), strict=True))
        return {"intrinsics": intrinsics, "distortion": terms, "width": device.width, "height": device.height}

    pose = np.column_stack([rig.right.R, rig.right.t])
    document = {"left_camera": camera(rig.left), "right_camera": camera(rig.right), "extrinsics": pose.tolist()}
    (folder / "rig.json").write_text(json.dumps(document))
    return [folder / "rig.json"]


def as_file_storage_per_camera(rig: Rig, folder: Path) -> list[Path]:
    """OpenCV's calibration sample run for each camera, and a file of what lies between them."""
    paths = []
    for name, device in (("left", rig.left), ("right", rig.right)):
        storage = cv2.FileStorage(str(folder / f"{name}.xml"), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", device.width)
        storage.write("image_height", device.height)
        storage.write("board_width", 9)
        storage.write("camera_matrix", device.K)
        storage.write("distortion_coefficients", device.distortion[:, None])
        storage.release()
        paths.append(folder / f"{name}.xml")
    storage = cv2.FileStorage(str(folder / "between.yml"), cv2.FILE_STORAGE_WRITE)
    for name, value in (("R", rig.right.R), ("T", rig.right.t[:, None]), ("R1", np.eye(3)), ("R2", rig.right.R.T)):
        storage.write(name, value)
    storage.release()
    return [*paths, folder / "between.yml"]


def as_matrix_files(ending: str) -> Callable[[Rig, Path], list[Path]]:
    """Every matrix in a file of its own, in one folder, beside a text of what the image's size is."""

    def write(rig: Rig, folder: Path) -> list[Path]:
        for name, value in (("K_left", rig.left.K), ("dist_left", rig.left.distortion[None]), ("R", rig.right.R),
                            ("K_right", rig.right.K), ("dist_right", rig.right.distortion[None]),
                            ("T", rig.right.t[:, None]), ("image_size", np.array([[64.0, 48.0]]))):  # fmt: skip
            if ending == "npy":
                np.save(folder / f"{name}.npy", value)
            else:
                np.savetxt(folder / f"{name}.{ending}", value, delimiter="," if ending == "csv" else " ")
        return [folder]

    return write


def rows_of(matrix: NDArray) -> str:
    return "\n".join(" ".join(f"{value:.15g}" for value in row) for row in np.atleast_2d(matrix))


def as_headed_text(rig: Rig, folder: Path) -> list[Path]:
    parts = [(f"{side} camera {what}", getattr(device, name)) for side, device in (("Left", rig.left),
             ("Right", rig.right)) for what, name in (("intrinsics", "K"), ("distortion", "distortion"))]  # fmt: skip
    parts += [("Rotation matrix", rig.right.R), ("Translation vector", rig.right.t[:, None])]
    parts += [("Image size", np.array([rig.left.width, rig.left.height]))]
    (folder / "calibration.txt").write_text("\n\n".join(f"{name}:\n{rows_of(value)}" for name, value in parts))
    return [folder / "calibration.txt"]


def as_ini(rig: Rig, folder: Path) -> list[Path]:
    lines = []
    for name, device in (("left_camera", rig.left), ("right_camera", rig.right)):
        lines += [f"[{name}]", *(f"{key}={device.K[place]!r}" for key, place in
                                 (("fx", (0, 0)), ("fy", (1, 1)), ("cx", (0, 2)), ("cy", (1, 2))))]  # fmt: skip
        lines += [
            f"{key}={value!r}" for key, value in zip(("k1", "k2", "p1", "p2", "k3"), device.distortion, strict=True)
        ]
        lines += [f"width={device.width}", f"height={device.height}"]
    lines += ["[extrinsics]", f"R = {rows_of(rig.right.R.reshape(1, 9))}", f"T = {rows_of(rig.right.t)}"]
    (folder / "stereo.ini").write_text("\n".join(line.replace("np.float64(", "").replace(")", "") for line in lines))
    return [folder / "stereo.ini"]


def as_toml(rig: Rig, folder: Path) -> list[Path]:
    """Aniposelib: cameras numbered from 0, each posed to one place by a rotation vector."""
    turn, text = Rotation.from_euler("xyz", [5, -8, 3], degrees=True).as_matrix(), ""
    for name, device in (("cam_0", rig.left), ("cam_1", rig.right)):
        vector, shift = Rotation.from_matrix(device.R @ turn).as_rotvec(), device.R @ [1.0, 2.0, 3.0] + device.t
        text += f"[{name}]\nname = '{name}'\nsize = [{device.width}, {device.height}]\nmatrix = {device.K.tolist()}\n"
        text += f"distortions = {device.distortion.tolist()}\nrotation = {vector.tolist()}\n"
        text += f"translation = {shift.tolist()}\n\n"
    (folder / "calibration.toml").write_text(text + "[metadata]\nerror = 0.3\n")
    return [folder / "calibration.toml"]


def as_mc_calib(rig: Rig, folder: Path) -> list[Path]:
    storage = cv2.FileStorage(str(folder / "calibrated_cameras_data.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("nb_camera", 2)
    for number, device in enumerate((rig.left, rig.right)):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = device.R, device.t
        storage.startWriteStruct(f"camera_{number}", cv2.FileNode_MAP)
        for name, value in (("camera_matrix", device.K), ("distortion_vector", device.distortion[None]),
                            ("distortion_type", 0), ("camera_group", 0), ("img_width", device.width),
                            ("img_height", device.height), ("camera_pose_matrix", np.linalg.inv(pose))):  # fmt: skip
            storage.write(name, value)
        storage.endWriteStruct()
    storage.release()
    return [folder / "calibrated_cameras_data.yml"]


def as_loose_matlab(rig: Rig, folder: Path) -> list[Path]:
    """stereoParams taken apart, one variable for each property."""
    nested, document = matlab(rig), {}
    for number in "12":
        document |= {f"{name}{number}": value for name, value in nested.pop(f"CameraParameters{number}").items()}
    savemat(folder / "calibration.mat", nested | document)
    return [folder / "calibration.mat"]


def as_list_of_cameras(rig: Rig, folder: Path) -> list[Path]:
    cameras = [{"name": name, "K": device.K.tolist(), "dist": device.distortion.tolist(), "R": device.R.tolist(),
                "t": device.t.tolist(), "width": device.width, "height": device.height}
               for name, device in rig.cameras.items()]  # fmt: skip
    (folder / "rig.json").write_text(json.dumps({"cameras": cameras}))
    return [folder / "rig.json"]


def as_tables(rig: Rig, folder: Path) -> list[Path]:
    sides = {name: {"camera_matrix": device.K.tolist(), "dist_coeff": [device.distortion.tolist()]}
             for name, device in rig.cameras.items()}  # fmt: skip
    pose = {"stereo": {"R": rig.right.R.tolist(), "T": rig.right.t.tolist()}}
    (folder / "rig.json").write_text(json.dumps({**sides, **pose, "image_size": [rig.left.width, rig.left.height]}))
    return [folder / "rig.json"]


def as_files_posed_to_a_board(rig: Rig, folder: Path) -> list[Path]:
    """One file per camera with K, D and its own pose to a board: two poses, neither of them between the cameras."""
    turn, paths = Rotation.from_euler("xyz", [5, -8, 3], degrees=True).as_matrix(), []
    for name, device in rig.cameras.items():
        paths.append(folder / f"{name}.npz")
        np.savez(paths[-1], K=device.K, dist=device.distortion, rvec=Rotation.from_matrix(device.R @ turn).as_rotvec(),
                 tvec=device.R @ [1.0, 2.0, 3.0] + device.t, image_size=[device.width, device.height])  # fmt: skip
    return paths


def as_files_numbered_from_1(rig: Rig, folder: Path) -> list[Path]:
    """cam1 and cam2, the right one first on the command line, and what lies between them."""
    paths = [folder / f"cam{number}.npz" for number in (2, 1)]
    for path, device in zip(paths, (rig.right, rig.left), strict=True):
        np.savez(path, K=device.K, dist=device.distortion, image_size=[device.width, device.height])
    np.savez(folder / "stereo.npz", R=rig.right.R, T=rig.right.t)
    return [*paths, folder / "stereo.npz"]


def as_posed_to_a_board(rig: Rig, folder: Path) -> list[Path]:
    turn, values = Rotation.from_euler("xyz", [5, -8, 3], degrees=True).as_matrix(), {}
    for number, device in enumerate(rig.cameras.values(), start=1):
        values |= {f"K{number}": device.K, f"D{number}": device.distortion, f"R{number}": device.R @ turn,
                   f"T{number}": device.R @ [1.0, 2.0, 3.0] + device.t}  # fmt: skip
    np.savez(folder / "rig.npz", image_size=[rig.left.width, rig.left.height], **values)
    return [folder / "rig.npz"]


def as_pickled(name: str, protocol: int) -> Callable[[Rig, Path], list[Path]]:
    """One dictionary, as np.save and pickle write it."""

    def write(rig: Rig, folder: Path) -> list[Path]:
        values = {"image_size": (rig.left.width, rig.left.height), "R": rig.right.R, "t": rig.right.t[:, None]}
        for number, device in enumerate(rig.cameras.values()):
            values |= {f"K{number}": device.K, f"d{number}": device.distortion[None]}
        if name.endswith(".npy"):
            np.save(folder / name, np.array(values, dtype=object), allow_pickle=True)
        else:
            (folder / name).write_bytes(pickle.dumps(values, protocol=protocol))
        return [folder / name]

    return write


class Call:
    """What a pickle of this runs when it is read."""

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return (Path.touch, (Path("run"),))  # type: ignore[return-value]


@pytest.mark.parametrize("name", ["calib.pkl", "calib.npy", "calib.npz"])
def test_nothing_in_a_pickle_is_run(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    held = np.array({"K1": Call()}, dtype=object)
    if name.endswith("pkl"):
        (tmp_path / name).write_bytes(pickle.dumps(held))
    elif name.endswith("npy"):
        np.save(tmp_path / name, held, allow_pickle=True)
    else:
        np.savez(tmp_path / name, calib=held)
    with pytest.raises(RigError, match=r"found a file that cannot be read \(pathlib\.\w*Path"):
        load_opencv_rig([tmp_path / name], "other", WHEN)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("write", "terms"),
    [
        (as_matlab_mat, 5),
        (as_pickled("calib.npy", 5), 5),
        (as_pickled("calib.pickle", 2), 5),
        (as_pickled("calib.pkl", 5), 5),
        (as_matlab_json, 5),
        (as_kalibr, 4),
        (as_ros, 5),
        (as_colmap, 8),
        (as_bouguet, 5),
        (as_hdf5, 5),
        (as_euroc, 4),
        (as_kitti, 5),
        (as_orb_slam, 5),
        (as_camera_info, 5),
        (as_nested, 5),
        (as_file_storage_per_camera, 5),
        (as_matrix_files("txt"), 5),
        (as_matrix_files("csv"), 5),
        (as_matrix_files("npy"), 5),
        (as_headed_text, 5),
        (as_ini, 5),
        (as_toml, 5),
        (as_mc_calib, 5),
        (as_loose_matlab, 5),
        (as_list_of_cameras, 5),
        (as_tables, 5),
        (as_files_posed_to_a_board, 5),
        (as_posed_to_a_board, 5),
        (as_files_numbered_from_1, 5),
        (plain({"K1": "KK_left", "K2": "KK_right", "D1": "kc_left", "D2": "kc_right"}), 5),
        (plain({"K1": "intrinsic_left", "K2": "intrinsic_right", "D1": "distort_left", "D2": "distort_right"}), 5),
        (plain({"R": "R_LR", "T": "t_LR"}), 5),
        (plain({}), 5),
        (plain({"K1": "M1", "K2": "M2", "R": "Rlr", "T": "Tlr"}), 5),
        (plain({"K1": "Kl", "K2": "Kr", "D1": "Dl", "D2": "Dr"}), 5),
        (plain({"K1": "mtx_left", "K2": "mtx_right", "D1": "dist_left", "D2": "dist_right"}), 5),
        (plain({"K1": "K0", "K2": "K1", "D1": "D0", "D2": "D1", "size": "img_size"}), 5),
        (plain({"K1": "mtxL", "K2": "mtxR", "D1": "distL", "D2": "distR", "R": "Rot", "T": "Trns"}), 5),
        (plain({"K1": "M1", "K2": "M2", "R": "Rlr", "T": "Tlr", "size": "S"}), 5),
        (
            plain(
                {
                    "K1": "Camera_Matrix_1",
                    "K2": "Camera_Matrix_2",
                    "D1": "Distortion_Coefficients_1",
                    "D2": "Distortion_Coefficients_2",
                    "R": "Rotation_Matrix",
                    "T": "Translation_Vector",
                }
            ),
            5,
        ),
        (
            plain(
                {
                    "K1": "intrinsicMatrix1",
                    "K2": "intrinsicMatrix2",
                    "D1": "distortionCoefficients1",
                    "D2": "distortionCoefficients2",
                    "R": "rotationOfCamera2",
                    "T": "translationOfCamera2",
                }
            ),
            5,
        ),
        (plain({"K1": "K_left", "K2": "K_right", "D1": "dist_coeffs_left", "D2": "dist_coeffs_right"}), 5),
        (plain({"K1": "cam1_mtx", "K2": "cam2_mtx", "D1": "cam1_dist", "D2": "cam2_dist", "R": "R_stereo"}), 5),
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
        np.testing.assert_allclose(one.lens[:terms], other.lens[:terms], atol=1e-9)
        np.testing.assert_allclose(one.R, other.R, atol=1e-6)
        np.testing.assert_allclose(one.t, other.t, atol=1e-4)


@pytest.mark.parametrize(
    "names",
    [("P1.txt", "P2.txt"), ("cam1_P.txt", "cam2_P.txt"), ("camL_proj.csv", "camR_proj.csv"), ("left.npy", "right.npy")],
)
def test_projection_matrices_tell_undistorted_cameras(cameras: Rig, tmp_path: Path, names: tuple[str, str]) -> None:
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix(), [5.0, 6.0, 900.0]
    for name, device, scale in zip(names, (cameras.left, cameras.right), (-0.37, 0.02), strict=True):
        matrix = scale * device.K @ np.column_stack([device.R, device.t]) @ world
        if name.endswith("npy"):
            np.save(tmp_path / name, matrix)
        else:
            np.savetxt(tmp_path / name, matrix, delimiter="," if name.endswith("csv") else " ")
    found = load_opencv_rig(
        [tmp_path / name for name in names], "other", WHEN, (cameras.left.width, cameras.left.height)
    )
    for name in ("left", "right"):
        one, other = found.devices[name], cameras.devices[name]
        assert not one.distortion.any()
        for value, wanted in ((one.K, other.K), (one.R, other.R), (one.t, other.t)):
            np.testing.assert_allclose(value, wanted, atol=1e-6)


def test_sl_studio_is_one_camera_and_a_projector(tmp_path: Path) -> None:
    cameras = bench_rig()
    storage = cv2.FileStorage(str(tmp_path / "calibration.xml"), cv2.FILE_STORAGE_WRITE)
    projector = cameras.with_projector()
    for name, value in (("frameWidth", cameras.left.width), ("frameHeight", cameras.left.height),
                        ("screenResX", projector.width), ("screenResY", projector.height),
                        ("Kc", cameras.left.K), ("kc", cameras.left.distortion), ("Kp", projector.K),
                        ("kp", projector.distortion), ("Rp", projector.R), ("Tp", projector.t[:, None])):  # fmt: skip
        storage.write(name, value)
    storage.release()
    found = load_opencv_rig([tmp_path / "calibration.xml"], "one", WHEN)
    assert found.right is None
    np.testing.assert_allclose(found.with_projector().t, projector.t)
    np.testing.assert_allclose(found.with_projector().K, projector.K)


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


def test_a_shape_of_height_and_width_is_turned(cameras: Rig, tmp_path: Path) -> None:
    device = cameras.left
    values = {"size": "img_shape"}
    (path,) = plain(values)(cameras, tmp_path)
    with np.load(path) as archive:
        document = {name: archive[name] for name in archive.files}
    np.savez(path, **{**document, "img_shape": np.array([device.height, device.width])})
    found = load_opencv_rig([path], "other", WHEN)
    assert (found.left.width, found.left.height) == (device.width, device.height)


def test_a_rectified_pair_is_read_by_its_baseline(cameras: Rig, tmp_path: Path) -> None:
    f, base = 120.0, 50.0
    (tmp_path / "calib.txt").write_text(
        f"cam0=[{f} 0 31; 0 {f} 23; 0 0 1]\ncam1=[{f} 0 33; 0 {f} 23; 0 0 1]\ndoffs=2\nbaseline={base}\n"
        "width=64\nheight=48\nndisp=20\n"
    )
    found = load_opencv_rig([tmp_path / "calib.txt"], "pair", WHEN)
    np.testing.assert_allclose(found.right.centre, [base, 0, 0])
    assert found.right.K[0, 2] - found.left.K[0, 2] == 2
    rows = [[f, 0, 32, 0, 0, f, 24, 0, 0, 0, 1, 0], [f, 0, 32, -f * base / 1000, 0, f, 24, 0, 0, 0, 1, 0]]
    lines = [f"P{k}: {' '.join(f'{v:.9e}' for v in row)}" for k, row in enumerate(rows)]
    (tmp_path / "odometry.txt").write_text("\n".join(lines))
    found = load_opencv_rig([tmp_path / "odometry.txt"], "pair", WHEN, (64, 48))
    np.testing.assert_allclose(found.right.centre, [base, 0, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("rig.mat", b"MATLAB 5.0 MAT-file, broken", "found a file that cannot be read"),
        ("rig.h5", b"\x89HDF\r\n\x1a\nbroken", "found a file that cannot be read"),
        ("rig.txt", b"nothing of a rig", "expected a calibration"),
        ("rig.json", b"[1, 2]", "found no table of keys"),
        ("rig.m", b"K = [1 2 3];", "found no M1, D1, M2, D2, R, T"),
    ],
)
def test_what_is_no_calibration_is_one_line(tmp_path: Path, name: str, content: bytes, said: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RigError, match=said) as problem:
        load_opencv_rig([tmp_path / name], "other", WHEN)
    assert "\n" not in str(problem.value)
    assert name in str(problem.value)


def test_a_board_s_size_is_no_image_s(cameras: Rig, tmp_path: Path) -> None:
    (path,) = plain({"size": "board_size"})(cameras, tmp_path)
    with pytest.raises(RigError, match="image_size"):
        load_opencv_rig([path], "other", WHEN)

"""Stereo calibrations in the formats of programs: MATLAB, Bouguet, Kalibr, ROS, EuRoC, KITTI, Middlebury, COLMAP,
MC-Calib, SLStudio.

Whatever a value is called inside, it becomes the names of OpenCV's samples: M1, D1, M2, D2, R, T and the images' size.
Conventions differ: MATLAB counts pixels from 1 and multiplies rows from the left, COLMAP puts pixel centres at halves,
Kalibr and ROS measure in metres, ROS tells where the cameras stand by its rectification.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from metrology.arrays import Array
from metrology.errors import RigError
from storage.calibration_documents import flat
from storage.calibration_names import side_of_file
from storage.one_camera_files import from_metashape, from_realsense
from storage.pose_names import turned

Found = dict[str, Array]

_MM_PER_METRE = np.array(1000.0)
_SIZES = {1: "size", 2: "size2"}  # of the cameras' images
_ROTATION_ERROR = 1e-3  # by which R Rᵀ of a rotation, rounded as it may be, departs from 1
_PAIRS_ALIKE = 0.02  # of their distance, and radians: by which cameras fixed to each other differ from pair to pair
_PINHOLE_LENSES = ("radtan", "radial-tangential", "plumb_bob", "none")
_PREFIXES = ((1, "LEFT."), (2, "RIGHT."), (1, "left."), (2, "right."))
_RECTIFIED = (
    ("camera_matrix", "distortion_coefficients", "rectification_matrix", "projection_matrix"),
    ("K", "D", "R", "P"),
    ("k", "d", "r", "p"),
    ("camera_matrix", "distortion", "rectification", "projection"),
)
_MODELS = {  # COLMAP: which of its parameters are fx, fy, cx, cy, and which the distortion
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), ()),
    "PINHOLE": ((0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3,)),
    "RADIAL": ((0, 0, 1, 2), (3, 4)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7, 8, 9, 10, 11)),
}


def from_document(document: Mapping[str, Any], path: Path) -> Found | None:
    """What a program's own file says; None where it is nobody's known format. `path` tells one camera's files apart."""
    document = _unwrapped(document)
    values = flat(document)
    if {"projection", "f", "width", "height"} <= set(document):
        return from_metashape(document, 2 if side_of_file([path.stem, path.parent.name]) == 2 else 1)
    if (realsense := from_realsense(document)) is not None:
        return realsense
    if "CameraParameters1" in document:
        return _matlab(document)
    if _is_camchain(document):
        return _kalibr(document)
    if {"fc_left", "fc_right"} <= set(values):
        return _bouguet(values)
    if {"IntrinsicMatrix1", "IntrinsicMatrix2", "RotationOfCamera2", "TranslationOfCamera2"} <= set(values):
        return _matlab({f"CameraParameters{n}": _numbered(values, n) for n in "12"} | values)
    if {"camera_0.camera_pose_matrix", "camera_1.camera_pose_matrix"} <= set(values):
        return _mc_calib(values)
    if {"Kc", "kc", "Kp", "kp", "Rp", "Tp"} <= set(values):
        return _sl_studio(values)
    if {"cam0", "cam1", "baseline"} <= set(values):
        return _middlebury(values)
    if {"P_rect_00", "P_rect_01"} <= set(values) or {"K_00", "K_01"} <= set(values):
        return _kitti_raw(values)
    if {"P0", "P1"} <= set(values) and np.size(values["P0"]) == np.size(values["P1"]) == 12:
        return _kitti_odometry(values)
    if "T_BS" in values and "intrinsics" in values:
        return _euroc(values, path)
    sides = [(number, _rectified_names(values, prefix)) for number, prefix in _PREFIXES]
    both = [(number, names) for number, names in sides if names]
    if len(both) == 2:
        return {key: value for number, names in both for key, value in _rectified(values, names, number).items()}
    if (alone := _rectified_names(values, "")) is not None:
        said = f"{document.get('camera_name', '')} {path.name}".lower()
        right = "right" in said or np.ravel(values[alone["P"]])[3] != 0
        return _rectified(values, alone, 2 if right else 1)
    return None


def _is_camchain(document: Mapping[str, Any]) -> bool:
    """Whether a file is Kalibr's; others name cameras alike and say otherwise where they stand."""
    cameras = [document.get(name) for name in ("cam0", "cam1")]
    if not isinstance(cameras[0], Mapping) or "intrinsics" not in cameras[0]:
        return False
    return not isinstance(cameras[1], Mapping) or "T_cn_cnm1" in cameras[1] or "camera_model" in cameras[0]


def _unwrapped(document: Mapping[str, Any]) -> Mapping[str, Any]:
    """The table inside a file that holds but one, as MATLAB saves a struct under a variable's name."""
    inner = [value for value in document.values() if isinstance(value, Mapping)]
    return inner[0] if len(inner) == 1 and len(document) == 1 else document


def _matlab(document: Mapping[str, Any]) -> Found:
    """`toStruct(stereoParams)`, by save or jsonencode; IntrinsicMatrix and RotationOfCamera2 act on rows."""
    found: Found = {}
    for number in (1, 2):
        camera = document[f"CameraParameters{number}"]
        K = np.array(camera["K"], float) if "K" in camera else np.array(camera["IntrinsicMatrix"], float).T
        K[:2, 2] -= 1  # MATLAB's first pixel is 1
        radial = np.zeros(3)
        told = np.ravel(np.array(camera.get("RadialDistortion", ()), float))
        radial[: told.size] = told
        tangential = np.ravel(np.array(camera.get("TangentialDistortion", (0.0, 0.0)), float))
        found[f"M{number}"], found[f"D{number}"] = K, np.array([[*radial[:2], *tangential[:2], radial[2]]])
        size = np.ravel(np.array(camera.get("ImageSize", ()), float))
        if size.size == 2:
            found[_SIZES[number]] = size[::-1]
    if "RotationOfCamera2" in document:
        found["R"] = np.array(document["RotationOfCamera2"], float).T
        found["T"] = np.ravel(np.array(document["TranslationOfCamera2"], float))
    else:
        pose = document["PoseCamera2"]
        matrix = np.array(
            pose["A"] if "A" in pose else np.column_stack([pose["R"], np.ravel(pose["Translation"])]), float
        )
        found["R"], found["T"] = matrix[:3, :3], matrix[:3, 3]
    return found


def _numbered(values: Mapping[str, Any], number: str) -> dict[str, Any]:
    """The values whose names end in a camera's number, by their names without it."""
    return {name[:-1]: value for name, value in values.items() if name.endswith(number)}


def _mc_calib(values: Mapping[str, Any]) -> Found:
    """MC-Calib: each camera's pose leads from the camera to the group's first one."""
    found: Found = {}
    for number, name in ((1, "camera_0"), (2, "camera_1")):
        found[f"M{number}"] = np.asarray(values[f"{name}.camera_matrix"], float)
        found[f"D{number}"] = np.reshape(np.asarray(values[f"{name}.distortion_vector"], float), (1, -1))
        found[f"placed{number}"] = np.reshape(np.asarray(values[f"{name}.camera_pose_matrix"], float), (4, 4))
        if f"{name}.img_width" in values and f"{name}.img_height" in values:
            wide, high = (float(values[f"{name}.img_{side}"]) for side in ("width", "height"))
            found[_SIZES[number]] = np.array([wide, high])
    return found


def _sl_studio(values: Mapping[str, Any]) -> Found:
    """SLStudio: one camera and its projector."""
    found = {name: np.asarray(values[said], float) for name, said in
             (("M1", "Kc"), ("D1", "kc"), ("M3", "Kp"), ("D3", "kp"), ("R3", "Rp"), ("T3", "Tp"))}  # fmt: skip
    for name, wide, high in (("size", "frameWidth", "frameHeight"), ("size3", "screenResX", "screenResY")):
        if wide in values and high in values:
            found[name] = np.array([float(values[wide]), float(values[high])])
    return found


def _kalibr(document: Mapping[str, Any]) -> Found:
    """A camchain of two cameras, cam0 left."""
    if "cam1" not in document:
        raise RigError("found cam0 alone, expected cam0 and cam1 of a Kalibr camchain")
    found: Found = {"unit": _MM_PER_METRE}
    for number, name in ((1, "cam0"), (2, "cam1")):
        camera = document[name]
        _check_lens(name, str(camera.get("camera_model", "pinhole")), str(camera.get("distortion_model", "none")))
        fx, fy, cx, cy = (float(value) for value in camera["intrinsics"])
        found[f"M{number}"] = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        found[f"D{number}"] = np.array([camera.get("distortion_coeffs", ())], float)
        if "resolution" in camera:
            found[_SIZES[number]] = np.array(camera["resolution"], float)
    if "T_cn_cnm1" not in document["cam1"] and "T_cam_imu" in document["cam1"]:
        left, right = (np.reshape(np.array(document[name]["T_cam_imu"], float), (4, 4)) for name in ("cam0", "cam1"))
        return found | _relative(left[:3, :3], left[:3, 3], right[:3, :3], right[:3, 3])
    matrix = np.reshape(np.array(document["cam1"]["T_cn_cnm1"], float), (4, 4))
    return found | {"R": matrix[:3, :3], "T": matrix[:3, 3]}


def _check_lens(name: str, model: str, lens: str) -> None:
    if model != "pinhole" or lens not in _PINHOLE_LENSES:
        raise RigError(f"{name}: found the model {model} with {lens}, expected pinhole with radtan")


def _rectified_names(values: Mapping[str, Any], prefix: str) -> dict[str, str] | None:
    """How one camera of ROS or ORB-SLAM calls K, D, R (its rectification) and P; None where it is not told by them."""
    for names in _RECTIFIED:
        found = {role: f"{prefix}{name}" for role, name in zip("KDRP", names, strict=True)}
        if all(name in values for name in found.values()) and np.size(values[found["P"]]) == 12:
            return found
    return None


def _rectified(values: Mapping[str, Any], names: Mapping[str, str], number: int) -> Found:
    """One camera; R and T follow once both are there (`rectified_pose`). ROS measures in metres, as ORB-SLAM does."""
    prefix = names["K"].rpartition(".")[0]
    found = {
        f"M{number}": np.reshape(np.asarray(values[names["K"]], float), (3, 3)),
        f"D{number}": np.reshape(np.asarray(values[names["D"]], float), (1, -1)),
        f"rectified{number}": np.reshape(np.asarray(values[names["R"]], float), (3, 3)),
        f"projection{number}": np.reshape(np.asarray(values[names["P"]], float), (3, 4)),
        "unit": _MM_PER_METRE,
    }
    for wide, high in (("image_width", "image_height"), ("width", "height")):
        at = [f"{prefix}.{name}" if prefix else name for name in (wide, high)]
        at = at if at[0] in values else [f"image.{name}" for name in (wide, high)]
        if all(name in values for name in at):
            found[_SIZES[number]] = np.array([float(np.ravel(values[name])[0]) for name in at])
    return found


def _bouguet(values: Mapping[str, Any]) -> Found:
    """Calib_Results_stereo of the Camera Calibration Toolbox for MATLAB, .mat or .m."""
    found: Found = {}
    for number, side in ((1, "left"), (2, "right")):
        fc, cc = (np.ravel(np.asarray(values[f"{name}_{side}"], float)) for name in ("fc", "cc"))
        skew = float(np.ravel(np.asarray(values.get(f"alpha_c_{side}", 0.0), float))[0])
        found[f"M{number}"] = np.array([[fc[0], skew * fc[0], cc[0]], [0, fc[1], cc[1]], [0, 0, 1]])
        found[f"D{number}"] = np.reshape(np.asarray(values[f"kc_{side}"], float), (1, -1))
    found["R"] = np.asarray(values["R"] if "R" in values else values["om"], float)
    found["T"] = np.ravel(np.asarray(values["T"], float))
    if "nx" in values and "ny" in values:
        found["size"] = np.array([float(values["nx"]), float(values["ny"])])
    return found


def _middlebury(values: Mapping[str, Any]) -> Found:
    """calib.txt of a rectified pair: right of the left camera by the baseline, mm."""
    found: Found = {f"M{n}": np.asarray(values[name], float) for n, name in ((1, "cam0"), (2, "cam1"))}
    size = np.array([float(values["width"]), float(values["height"])])
    none = np.zeros((1, 5))
    pose = {"R": np.eye(3), "T": np.array([-float(values["baseline"]), 0.0, 0.0])}
    return found | pose | {"D1": none, "D2": none, "size": size}


def _kitti_raw(values: Mapping[str, Any]) -> Found:
    """calib_cam_to_cam.txt: cameras 0 and 1, each posed to camera 0; metres."""
    found: Found = {"unit": _MM_PER_METRE}
    poses = []
    for number, name in ((1, "00"), (2, "01")):
        found[f"M{number}"] = np.reshape(values[f"K_{name}"], (3, 3))
        found[f"D{number}"] = np.reshape(values[f"D_{name}"], (1, -1))
        poses.append((np.reshape(values[f"R_{name}"], (3, 3)), np.ravel(values[f"T_{name}"])))
        if f"S_{name}" in values:
            found[_SIZES[number]] = np.ravel(values[f"S_{name}"])
    return found | _relative(*poses[0], *poses[1])


def _kitti_odometry(values: Mapping[str, Any]) -> Found:
    """calib.txt of rectified cameras 0 and 1 by their projections K [I | t]; metres."""
    left, right = (np.reshape(np.asarray(values[name], float), (3, 4)) for name in ("P0", "P1"))
    shift = np.linalg.solve(right[:, :3], right[:, 3]) - np.linalg.solve(left[:, :3], left[:, 3])
    none = np.zeros((1, 5))
    found: Found = {"M1": left[:, :3], "M2": right[:, :3], "D1": none, "D2": none, "R": np.eye(3), "T": shift}
    return found | {"unit": _MM_PER_METRE}


def _euroc(values: Mapping[str, Any], path: Path) -> Found:
    """sensor.yaml of one camera of EuRoC's: `T_BS` is the camera's pose on the body; metres."""
    _check_lens(path.name, str(values.get("camera_model", "pinhole")), str(values.get("distortion_model", "none")))
    number = side_of_file([path.stem, path.parent.name])
    if number not in (1, 2):
        raise RigError("found a sensor.yaml in a folder that names no camera, expected cam0 and cam1")
    fx, fy, cx, cy = np.ravel(values["intrinsics"])
    found = {
        f"M{number}": np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]),
        f"D{number}": np.reshape(np.asarray(values["distortion_coefficients"], float), (1, -1)),
        f"placed{number}": np.reshape(np.asarray(values["T_BS"], float), (4, 4)),
        "unit": _MM_PER_METRE,
    }
    if "resolution" in values:
        found[_SIZES[number]] = np.ravel(np.asarray(values["resolution"], float))
    return found


def _relative(R1: Array, t1: Array, R2: Array, t2: Array) -> Found:
    """Pose of the second camera from the first, of two that are posed to one frame."""
    return {"R": R2 @ R1.T, "T": t2 - R2 @ R1.T @ t1}


def pose_of_both(found: Mapping[str, Array]) -> Found:
    """Where the right camera or the projector stands, from what files of one device each say of their rectification or
    their place.
    """
    return _pose_of_right(found) | _pose_of_projector(found)


def _pose_of_projector(found: Mapping[str, Array]) -> Found:
    """From the left camera, of a projector that a file of its own says where it stands."""
    if "R3" in found or not {"posedR3", "posedT3"} <= set(found):
        return {}
    R, t = _posed(found, "3")
    if {"posedR1", "posedT1"} <= set(found):
        R, t = _relative(*_posed(found, "1"), R, t).values()
    return {"R3": R, "T3": t}


def _pose_of_right(found: Mapping[str, Array]) -> Found:
    if "placed1" in found and "placed2" in found:
        left, right = (np.asarray(np.linalg.inv(found[f"placed{number}"]), float) for number in (1, 2))
        return _relative(left[:3, :3], left[:3, 3], right[:3, :3], right[:3, 3])
    posed = [side for side in "12" if f"posedR{side}" in found and f"posedT{side}" in found]
    if len(posed) == 2:
        return _relative(*(part for side in posed for part in _posed(found, side)))
    if len(posed) == 1 and "R" not in found:
        return dict(zip("RT", _posed(found, posed[0]), strict=True))
    if is_rotation(found.get("R")) or not {"rectified1", "rectified2", "projection2"} <= set(found):
        return {}
    left, right, projection = found["rectified1"], found["rectified2"], found["projection2"]
    base = projection[:, 3] / np.array([projection[0, 0], projection[1, 1], 1.0])
    return {"R": right.T @ left, "T": right.T @ base}


def is_rotation(value: Array | None) -> bool:
    """Whether a value is a rotation: a matrix, or a vector."""
    if value is None or value.size not in (3, 9) or not np.isfinite(value).all():
        return False
    R = turned(value)
    return bool(np.abs(R @ R.T - np.eye(3)).max() < _ROTATION_ERROR and np.linalg.det(R) > 0)


def _posed(found: Mapping[str, Array], side: str) -> tuple[Array, Array]:
    return turned(found[f"posedR{side}"]), found[f"posedT{side}"].ravel()


def from_colmap(folder: Path) -> Found:
    """`cameras.txt` and `images.txt` of a model: two images, by name left and right, or pairs by two cameras that were
    fixed to each other.
    """
    cameras = {row[0]: row[1:] for row in _rows(folder / "cameras.txt")}
    images = sorted((row for row in _rows(folder / "images.txt")[::2]), key=lambda row: row[9])
    pairs = _pairs(images)
    if not pairs:
        raise RigError(
            f"{folder / 'images.txt'}: found {len(images)} images, expected two, left and right by name, or as many of "
            "either of two cameras"
        )
    images = pairs[0]
    found: Found = {}
    poses = []
    for number, image in enumerate(images, start=1):
        model, width, height, *rest = cameras[image[8]]
        if model not in _MODELS:
            raise RigError(f"{folder / 'cameras.txt'}: found the model {model}, expected one of {', '.join(_MODELS)}")
        places, lens = _MODELS[model]
        values = [float(value) for value in rest]
        fx, fy, cx, cy = (values[place] for place in places)
        terms = [values[place] for place in lens]
        found[f"M{number}"] = np.array([[fx, 0, cx - 0.5], [0, fy, cy - 0.5], [0, 0, 1]])  # centres at halves
        found[f"D{number}"] = np.array([terms + [0.0] * (max(4, len(terms)) - len(terms))])
        found[_SIZES[number]] = np.array([float(width), float(height)])
        poses.append(_image_pose(image))
    if len(pairs) == 1:
        return found | _relative(*poses[0], *poses[1])
    return found | _usual_pose([_relative(*_image_pose(left), *_image_pose(right)) for left, right in pairs], folder)


def _pairs(images: list[list[str]]) -> list[list[list[str]]]:
    """The left and the right image of each moment, in the order of their names; empty where they are no pairs."""
    if len(images) == 2:
        return [images]
    cameras = list(dict.fromkeys(image[8] for image in images))
    own = [[image for image in images if image[8] == camera] for camera in cameras]
    return [list(pair) for pair in zip(*own, strict=True)] if len(own) == 2 and len(own[0]) == len(own[1]) else []


def _image_pose(image: list[str]) -> tuple[Array, Array]:
    return _turned([float(q) for q in image[1:5]]), np.array(image[5:8], float)


def _usual_pose(said: list[Found], folder: Path) -> Found:
    """The median of what pairs of images say; RigError where they say different things."""
    turns = [cv2.Rodrigues(one["R"])[0].ravel() for one in said]
    turn, shift = np.median(turns, axis=0), np.median([one["T"] for one in said], axis=0)
    off = max(float(np.linalg.norm(one["T"] - shift)) for one in said) / max(float(np.linalg.norm(shift)), 1e-12)
    if max(off, float(np.abs(turns - turn).max())) > _PAIRS_ALIKE:
        raise RigError(
            f"{folder / 'images.txt'}: found {len(said)} pairs of images whose cameras stand up to {off:.1%} of their "
            "distance apart from each other's, expected two cameras fixed to each other, pairs by the order of names"
        )
    return {"R": turned(turn), "T": shift}


def _rows(path: Path) -> list[list[str]]:
    """Words of the lines that are no comment; the line of points after each image may be empty."""
    if not path.is_file():
        binary = " but .bin" if path.with_suffix(".bin").is_file() else ""
        raise RigError(f"{path}: found no such file{binary}, expected COLMAP's text export (colmap model_converter)")
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return [line.split() for line in lines if line.strip() or path.name == "images.txt"]


def _turned(q: list[float]) -> Array:
    """Rotation of a quaternion w, x, y, z."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat([q[1], q[2], q[3], q[0]]).as_matrix(), float)

"""Stereo calibrations of other programs: MATLAB, Kalibr, ROS, COLMAP, and plain JSON, YAML, MAT and NPZ files.

Whatever a file is called inside, it becomes the names of OpenCV's samples: M1, D1, M2, D2, R, T and the images' size.
Conventions differ: MATLAB counts pixels from 1 and multiplies rows from the left, COLMAP puts pixel centres at halves,
Kalibr and ROS measure in metres, ROS tells where the cameras stand by its rectification.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrology.errors import RigError

Array = NDArray[np.float64]
Found = dict[str, Array]

_MM_PER_METRE = np.array(1000.0)
_MODELS = {  # COLMAP: which of its parameters are fx, fy, cx, cy, and which the distortion
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), ()),
    "PINHOLE": ((0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3,)),
    "RADIAL": ((0, 0, 1, 2), (3, 4)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7, 8, 9, 10, 11)),
}


def read_document(path: Path) -> dict[str, Any]:
    """A JSON, YAML, MAT or NPZ file as nested tables; RigError where it is none."""
    try:
        if path.suffix.lower() == ".npz":
            with np.load(path, allow_pickle=False) as archive:
                return {name: archive[name] for name in archive.files}
        if path.suffix.lower() == ".mat":
            from scipy.io import loadmat

            return {k: v for k, v in loadmat(path, simplify_cells=True).items() if not k.startswith("__")}
        text = path.read_text(encoding="utf-8-sig")
        if path.suffix.lower() == ".json":
            document = json.loads(text)
        else:
            import yaml  # type: ignore[import-untyped]

            document = yaml.safe_load(text)
    except Exception as problem:  # what a damaged file makes of three libraries
        said = " ".join(str(problem).split())[:100]
        raise RigError(f"{path}: found a file that cannot be read ({said}), expected a calibration") from None
    if not isinstance(document, dict):
        raise RigError(f"{path}: found no table of keys, expected a calibration")
    return document


def from_document(document: Mapping[str, Any], name: str) -> Found | None:
    """What a program's own file says; None where it is nobody's known format. `name` tells ROS's cameras apart."""
    document = _unwrapped(document)
    if "CameraParameters1" in document:
        return _matlab(document)
    if "cam0" in document and isinstance(document["cam0"], Mapping) and "intrinsics" in document["cam0"]:
        return _kalibr(document)
    if "projection_matrix" in document and "rectification_matrix" in document:
        return _ros(document, name)
    return None


def flat(document: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables as one, `left.K` for K inside left; matrices that are tables with `data` become lists."""
    found: dict[str, Any] = {}
    for key, value in document.items():
        if isinstance(value, Mapping) and "data" in value and "rows" in value:
            found[prefix + key] = np.reshape(value["data"], (int(value["rows"]), int(value["cols"])))
        elif isinstance(value, Mapping):
            found |= flat(value, f"{prefix}{key}.")
        else:
            found[prefix + key] = value
    return found


def numbers(value: Any) -> Array | None:
    """A value as an array of numbers, None where it is none."""
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError):
        return None
    return array if array.size else None


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
        if size.size == 2 and number == 1:
            found["size"] = size[::-1]
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


def _kalibr(document: Mapping[str, Any]) -> Found:
    """A camchain of two cameras, cam0 left."""
    if "cam1" not in document:
        raise RigError("found cam0 alone, expected cam0 and cam1 of a Kalibr camchain")
    found: Found = {"unit": _MM_PER_METRE}
    for number, name in ((1, "cam0"), (2, "cam1")):
        camera = document[name]
        model, lens = camera.get("camera_model", "pinhole"), camera.get("distortion_model", "none")
        if model != "pinhole" or lens not in ("radtan", "none"):
            raise RigError(f"{name}: found the model {model} with {lens}, expected pinhole with radtan")
        fx, fy, cx, cy = (float(value) for value in camera["intrinsics"])
        found[f"M{number}"] = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        found[f"D{number}"] = np.array([camera.get("distortion_coeffs", ())], float)
        if number == 1 and "resolution" in camera:
            found["size"] = np.array(camera["resolution"], float)
    matrix = np.array(document["cam1"]["T_cn_cnm1"], float)
    return found | {"R": matrix[:3, :3], "T": matrix[:3, 3]}


def _ros(document: Mapping[str, Any], name: str) -> Found:
    """One camera of `camera_calibration`; R and T follow once both are there (`ros_pose`)."""
    values = flat(document)
    said = f"{document.get('camera_name', '')} {name}".lower()
    number = 2 if "right" in said or np.ravel(values["projection_matrix"])[3] != 0 else 1
    return {
        f"M{number}": np.reshape(values["camera_matrix"], (3, 3)),
        f"D{number}": np.reshape(values["distortion_coefficients"], (1, -1)),
        f"rectified{number}": np.reshape(values["rectification_matrix"], (3, 3)),
        f"projection{number}": np.reshape(values["projection_matrix"], (3, 4)),
        "size": np.array([document["image_width"], document["image_height"]], float),
        "unit": _MM_PER_METRE,
    }


def ros_pose(found: Mapping[str, Array]) -> Found:
    """Where the right camera stands, from both cameras' rectification."""
    if "rectified1" not in found or "rectified2" not in found:
        return {}
    left, right, projection = found["rectified1"], found["rectified2"], found["projection2"]
    base = np.array([projection[0, 3] / projection[0, 0], 0.0, 0.0])
    return {"R": right.T @ left, "T": right.T @ base}


def from_colmap(folder: Path) -> Found:
    """`cameras.txt` and `images.txt` of a model: its first two images, by name, are left and right."""
    cameras = {row[0]: row[1:] for row in _rows(folder / "cameras.txt")}
    images = sorted((row for row in _rows(folder / "images.txt")[::2]), key=lambda row: row[9])
    if len(images) != 2:
        raise RigError(f"{folder / 'images.txt'}: found {len(images)} images, expected two: left and right, by name")
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
        found["size"] = np.array([float(width), float(height)])
        poses.append((_turned([float(q) for q in image[1:5]]), np.array(image[5:8], float)))
    (R1, t1), (R2, t2) = poses
    return found | {"R": R2 @ R1.T, "T": t2 - R2 @ R1.T @ t1}


def _rows(path: Path) -> list[list[str]]:
    """Words of the lines that are no comment; the line of points after each image may be empty."""
    if not path.is_file():
        raise RigError(f"{path}: found no such file, expected COLMAP's text export")
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return [line.split() for line in lines if line.strip() or path.name == "images.txt"]


def _turned(q: list[float]) -> Array:
    """Rotation of a quaternion w, x, y, z."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat([q[1], q[2], q[3], q[0]]).as_matrix(), float)

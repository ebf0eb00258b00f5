"""One camera each in files of Metashape, mrcal and RealSense, by the names of OpenCV's samples."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from metrology.arrays import Array
from metrology.errors import RigError

Found = dict[str, Array]

_MM_PER_METRE = np.array(1000.0)
_TERMS = ("k1", "k2", "p2", "p1", "k3")  # Metashape's p1 and p2 are OpenCV's p2 and p1


def from_metashape(camera: Mapping[str, Any], side: int) -> Found:
    """Camera calibration as Metashape saves it: cx and cy from the image's middle, pixel centres at halves."""
    said = {name: float(value) for name, value in camera.items() if isinstance(value, float | int)}
    if said.get("k4"):
        raise RigError(f"found k4 of {said['k4']:g}, expected Metashape's lens without it: k1, k2, k3, p1, p2")
    middle = [said[name] / 2 + said.get(shift, 0.0) - 0.5 for name, shift in (("width", "cx"), ("height", "cy"))]
    K = np.array(
        [[said["f"] + said.get("b1", 0.0), said.get("b2", 0.0), middle[0]], [0, said["f"], middle[1]], [0, 0, 1]]
    )
    terms = np.array([[said.get(name, 0.0) for name in _TERMS]])
    return {f"M{side}": K, f"D{side}": terms, _size(side): np.array([said["width"], said["height"]])}


def from_mrcal(text: str, side: int) -> Found | None:
    """A `.cameramodel`: fx, fy, cx, cy and OpenCV's terms, and the pose from the reference; None where it is none."""
    model = re.search(r"'lensmodel'\s*:\s*'(\w+)'", text)
    if model is None:
        return None
    if model[1] != "LENSMODEL_PINHOLE" and not re.fullmatch(r"LENSMODEL_OPENCV\d+", model[1]):
        raise RigError(f"lensmodel: found {model[1]}, expected LENSMODEL_PINHOLE or LENSMODEL_OPENCV4 to 12")
    values = {}
    for name in ("intrinsics", "extrinsics", "imagersize"):
        inside = re.search(rf"'{name}'\s*:\s*\[([^\]]*)\]", text)
        if inside is None:
            raise RigError(f"found no {name}, expected a whole camera model")
        values[name] = np.array([float(word) for word in inside[1].replace(",", " ").split()])
    fx, fy, cx, cy, *terms = values["intrinsics"]
    pose = values["extrinsics"]
    return {
        f"M{side}": np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]),
        f"D{side}": np.array([terms or [0.0] * 5]),
        f"posedR{side}": pose[:3],
        f"posedT{side}": pose[3:],
        _size(side): values["imagersize"],
    }


def from_realsense(document: Mapping[str, Any]) -> Found | None:
    """Two cameras as RealSense's library prints them: ppx, ppy, coeffs; R column by column; metres. None where the
    document holds none.
    """
    tables = {name: value for name, value in document.items() if isinstance(value, Mapping)}
    cameras = {name: camera for name, camera in tables.items() if {"fx", "fy", "ppx", "ppy"} <= set(camera)}
    pose = next((value for value in tables.values() if {"rotation", "translation"} <= set(value)), None)
    if len(cameras) != 2 or pose is None:
        return None
    found: Found = {
        "unit": _MM_PER_METRE,
        "R": np.reshape(np.array(pose["rotation"], float), (3, 3)).T,
        "T": np.array(pose["translation"], float),
    }
    for name, camera in cameras.items():
        side = 2 if re.search(r"right|infra(?:red)?_?2|ir_?2", name.lower()) else 1
        fx, fy, cx, cy = (float(camera[key]) for key in ("fx", "fy", "ppx", "ppy"))
        found[f"M{side}"] = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        found[f"D{side}"] = np.array([camera.get("coeffs", [0.0] * 5)], float)
        found[_size(side)] = np.array([float(camera["width"]), float(camera["height"])])
    return found


def _size(side: int) -> str:
    return "size" if side == 1 else "size2"

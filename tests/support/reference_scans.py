"""The independently rendered scans of the shared folder, read without the archive: frames, rig and truth."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from metrology.cloud import Reconstruction
from metrology.fringe import FringeCode
from metrology.reconstruct import reconstruct
from metrology.rig import Device, Rig


def read_rig(path: Path) -> Rig:
    document = json.loads(path.read_text())

    def device(d: dict[str, Any], first: bool = False) -> Device:
        R, t = (np.eye(3), np.zeros(3)) if first else (np.array(d["R"]), np.array(d["t"]))
        return Device(d["width"], d["height"], np.array(d["K"]), np.array(d["distortion"]), R, t)

    cameras = document["cameras"]
    left, right = device(cameras["left"], first=True), device(cameras["right"])
    return Rig(document["id"], document["calibrated_at"], left, right, device(document["projector"]))


@cache
def reference_scan(folder: Path, rig_name: str = "rig.json") -> tuple[Reconstruction, dict[str, Any]]:
    """Cloud and truth of one scene folder."""
    scene = json.loads((folder / "scene.json").read_text())
    frames = {
        side: np.array([[cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED) for name in e] for e in exposures])
        for side, exposures in scene["frames"].items()
    }
    fringe = scene["fringe"]
    code = FringeCode(fringe["axis"], fringe["steps"], tuple(fringe["counts"]))
    rig = read_rig(folder.parent / rig_name)
    cloud = reconstruct(frames["left"], frames["right"], rig, code, scene["exposures"])
    return cloud, json.loads((folder / "truth.json").read_text())

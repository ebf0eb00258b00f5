"""A plane's frames as other programs write them, and how far off the plane is what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.binary_code import binary_from_gray
from metrology.fringe import FringeCode
from metrology.reconstruct import reconstruct
from storage.scene import load_scene
from tests.support.rendered_fringes import PLANE_DISTANCE, PLANE_NORMAL, plane_depth, seen_coordinate, small_rig


def scan(code: FringeCode, phase_sign: int = 1, binary: bool = False) -> dict[str, NDArray[np.uint8]]:
    """Each camera's frames of a plane; with phase_sign −1 the steps run backward; bits in Gray code or plain binary."""
    rig, rng, fine = small_rig(), np.random.default_rng(5), 8
    size = rig.with_projector().width
    lines = replace(code, size_px=(code.size_px or size) * fine).patterns(size * fine, 1)[:, 0]
    lines = binary_from_gray(lines, code) if binary else lines
    order = [k * 4 + (phase_sign * s) % 4 for k in range(len(code.counts)) for s in range(4)] if phase_sign < 0 else []
    lines = lines[order + list(range(len(order), len(lines)))]
    views = {}
    for camera in ("left", "right"):
        seen = seen_coordinate(rig, plane_depth(rig.devices[camera], PLANE_NORMAL, PLANE_DISTANCE), "x")
        places = np.clip(np.rint((np.nan_to_num(seen) + 0.5) * fine - 0.5).astype(int), 0, size * fine - 1)
        levels = np.where(np.isfinite(seen), 30 + 160 * lines[:, places], 4) + rng.normal(
            0, 1.5, (len(lines), *seen.shape)
        )
        views[camera] = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    return views


def save(folder: Path, views: dict[str, NDArray[np.uint8]], names: Sequence[str]) -> Path:
    """Write frames by names in which {camera} is L and R."""
    for camera, frames in views.items():
        for name, frame in zip(names, frames, strict=True):
            path = folder / name.format(camera={"left": "L", "right": "R"}[camera])
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), frame)
    return folder


def measured(folder: Path) -> NDArray[np.float64]:
    """Distances of the measured points from the plane, by a rig without its projector."""
    scene, rig = load_scene(folder), replace(small_rig(), projector=None)
    found = reconstruct(scene.frames("left"), scene.frames("right"), rig, scene.code, scene.exposures)
    return np.asarray((found.points @ PLANE_NORMAL - PLANE_DISTANCE)[found.flags == 0])

"""A scan of a roof of two planes: something with depth, from which a projector can be found."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from metrology.fringe import Axis, FringeCode
from metrology.moments import moment_of
from metrology.results import SceneKey
from metrology.rig import Rig
from storage.scene import write_scene
from tests.support.rendered_fringes import clean_frames, plane_depth, recorded, seen_coordinate

WHEN = "2026-11-01T00:00:00Z"


def roof_scan(folder: Path, rig: Rig, axis: Axis, apart: float, station: str) -> Path:
    """A roof of two planes, nearer by `apart` millimetres, seen by both cameras."""
    code = FringeCode(axis, 4, (13, 12, 11))
    size = code.size(rig.with_projector().width, rig.with_projector().height)
    rng, views = np.random.default_rng(7), []
    for device in (rig.left, rig.with_right()):
        planes = []
        for tilt in (0.45, -0.45):
            normal = np.array([tilt, -0.1, -1.0]) / np.linalg.norm([tilt, -0.1, -1.0])
            planes.append(plane_depth(device, normal, float(normal @ [0.0, 0.0, 700.0 - apart])))
        nearer = np.linalg.norm(planes[0] - device.centre, axis=-1) > np.linalg.norm(planes[1] - device.centre, axis=-1)
        seen = seen_coordinate(rig, np.where(nearer[..., None], planes[1], planes[0]), axis)
        lit = np.isfinite(seen)
        frames = clean_frames(np.where(lit, seen, 0), code, size, 110.0, 80.0)
        views.append(recorded(np.where(lit, frames, 4.0), rng, 1.0))
    key = SceneKey("TRIAL", "P1", station, moment_of(WHEN))
    write_scene(folder, key, rig.id, code, [1.0], views[0], views[1])
    return folder

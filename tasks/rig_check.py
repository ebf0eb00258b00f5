"""Whether a rig still fits a scene."""

from __future__ import annotations

from pathlib import Path

from metrology.reconstruct import reconstruct
from metrology.rig import Rig
from metrology.rig_health import HealthSettings, RigHealth, epipolar_health
from storage.scene import load_scene


def check_scene(rig: Rig, folder: Path, settings: HealthSettings | None = None) -> RigHealth:
    """Reconstruct a scene with a rig and judge the rig by it; nothing is stored."""
    scene = load_scene(folder)
    scene.check_fits(rig)
    reconstruction = reconstruct(scene.frames("left"), scene.frames("right"), rig, scene.code, scene.exposures)
    return epipolar_health(reconstruction, axis=scene.code.axis, settings=settings)

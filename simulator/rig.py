"""A virtual rig: two converging cameras with a projector between and above them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from metrology.errors import SpecError
from metrology.rig import Device, Rig
from simulator.relief import Floats


@dataclass(frozen=True)
class RigDesign:
    """What a rig is built to; a built one departs from it a little."""

    camera_width: int = 1624
    camera_height: int = 1234
    camera_focal_px: float = 3640.0
    projector_width: int = 1280
    projector_height: int = 800
    projector_focal_px: float = 2550.0
    baseline_mm: float = 300.0
    """Distance between the cameras."""
    stand_off_mm: float = 700.0
    """Distance of the point all three look at from the middle of the baseline."""
    projector_rise_mm: float = 90.0
    """How far the projector stands above the baseline."""
    spread: float = 1.0
    """Size of the departures from the design: 1 is an ordinary build, 0 none."""

    def __post_init__(self) -> None:
        for name in ("camera_focal_px", "projector_focal_px", "baseline_mm", "stand_off_mm"):
            if getattr(self, name) <= 0:
                raise SpecError(f"rig {name}: found {getattr(self, name)}, expected a positive number")
        if self.spread < 0:
            raise SpecError(f"rig spread: found {self.spread}, expected 0 or more")


def virtual_rig(
    rng: np.random.Generator,
    design: RigDesign | None = None,
    rig_id: str = "rig-virtual",
    calibrated_at: str = "2026-11-01T08:00:00Z",
) -> Rig:
    """A rig as it might be built to a design: poses, focal lengths and lenses vary a little."""
    design = design or RigDesign()
    aim = np.array([0.0, 0.0, design.stand_off_mm])
    half = 0.5 * design.baseline_mm
    camera = (design.camera_width, design.camera_height, design.camera_focal_px)
    projector = (design.projector_width, design.projector_height, design.projector_focal_px)
    built = [
        _device(rng, camera, np.array([-half, 0.0, 0.0]), aim, -0.1, design.spread),
        _device(rng, camera, np.array([half, 0.0, 0.0]), aim, -0.1, design.spread),
        _device(rng, projector, np.array([0.0, -design.projector_rise_mm, -10.0]), aim, -0.03, design.spread),
    ]
    left = built[0]
    # From the baseline's frame into the left camera's.
    seen = [
        replace(d, R=d.R @ left.R.T, t=d.t - d.R @ left.R.T @ left.t) if d is not left
        else replace(d, R=np.eye(3), t=np.zeros(3))
        for d in built
    ]  # fmt: skip
    return Rig(rig_id, calibrated_at, seen[0], seen[1], seen[2])


def _device(
    rng: np.random.Generator, size: tuple[int, int, float], centre: Floats, aim: Floats, k1: float, spread: float
) -> Device:
    """A device near `centre` that looks at about `aim`."""
    width, height, focal = size
    centre = centre + spread * rng.normal(0, 2.0, 3)
    aim = aim + spread * rng.normal(0, 2.0, 3)
    z = (aim - centre) / np.linalg.norm(aim - centre)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    R = Rotation.from_rotvec([0, 0, spread * rng.normal(0, math.radians(0.4))]).as_matrix() @ R
    fx = focal * (1 + spread * rng.normal(0, 0.002))
    K = np.array([
        [fx, 0, (width - 1) / 2 + spread * rng.normal(0, 0.004 * width)],
        [0, fx * (1 + spread * rng.normal(0, 0.0005)), (height - 1) / 2 + spread * rng.normal(0, 0.004 * height)],
        [0, 0, 1],
    ])  # fmt: skip
    distortion = np.array([
        k1 * (1 + 0.2 * spread * rng.normal()), -k1 * (1 + 0.3 * spread * rng.normal()),
        spread * rng.normal(0, 1.5e-4), spread * rng.normal(0, 1.5e-4), 0.0,
    ])  # fmt: skip
    return Device(width, height, K, distortion, R, -R @ centre)


def warmed(rig: Rig, kelvin: float, expansion_per_k: float = 23e-6) -> Rig:
    """The rig after its frame (aluminium by default) has warmed: all distances between its devices have grown."""
    grow = 1 + expansion_per_k * kelvin
    return replace(
        rig,
        right=replace(rig.with_right(), t=rig.with_right().t * grow),
        projector=replace(rig.with_projector(), t=rig.with_projector().t * grow),
    )


def aim_frame(rig: Rig) -> tuple[Floats, Floats]:
    """Where a panel stands by default: facing the rig at the point both cameras look at.

    Returns
    -------
    R, t : (3, 3), (3,)
        Panel frame (x right, y up, z towards the rig) to rig frame.
    """
    a, b = rig.left.R[2], rig.with_right().R[2]
    gap = rig.with_right().centre - rig.left.centre
    # Feet of the common perpendicular of the two optical axes.
    s, u = np.linalg.lstsq(np.stack([a, -b], axis=1), gap, rcond=None)[0]
    aim = 0.5 * (rig.left.centre + s * a + rig.with_right().centre + u * b)
    z = 0.5 * (rig.left.centre + rig.with_right().centre) - aim
    z /= np.linalg.norm(z)
    x = gap - (gap @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1), aim

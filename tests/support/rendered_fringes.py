"""Fringe frames of known coordinate, a small rig, and a plane seen by it: truth for the reconstruction tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metrology.fringe import FringeCode
from metrology.rig import Device, Rig

USUAL = FringeCode("x", 4, (70, 64, 59))


def clean_frames(
    coordinate: NDArray,
    code: FringeCode,
    size: int,
    mean: NDArray | float,
    modulation: NDArray | float,
    gamma: float = 1.0,
) -> NDArray[np.float64]:
    """(frames, h, w) noiseless levels that a camera records of the code's patterns at a projector `coordinate`."""
    position = (np.asarray(coordinate, float) + 0.5) / size
    fringes = [
        0.5 + 0.5 * np.cos(2 * np.pi * (count * position + step / code.steps))
        for count in code.counts
        for step in range(code.steps)
    ]
    if code.gray:
        stripe = np.clip(np.floor(code.gray.stripes * position).astype(int), 0, code.gray.stripes - 1)
        for bit in range(code.gray.bits - 1, -1, -1):
            lit = ((stripe ^ (stripe >> 1)) >> bit & 1).astype(float)
            fringes += [lit, 1 - lit] if code.gray.inverse else [lit]
    return mean + modulation * (2 * np.stack(fringes) ** gamma - 1)


def recorded(
    clean: NDArray, rng: np.random.Generator | None, sigma: float = 2.0, exposures: Sequence[float] = (1.0,)
) -> NDArray[np.uint8]:
    """(exposures, frames, h, w) with noise of `sigma` grey levels, rounded and clipped to 8 bits."""
    levels = np.stack([clean * time for time in exposures])
    if rng is not None:
        levels = levels + rng.normal(0, sigma, levels.shape)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def ramp(height: int, width: int, size: int, tilt: float = 0.02) -> NDArray[np.float64]:
    """(h, w) projector coordinate rising across nearly the whole projector."""
    v, u = np.mgrid[:height, :width].astype(float)
    return 10 + (size - 40) * u / width + tilt * v


def small_rig(scale: float = 1.0, upright: bool = False) -> Rig:
    """Two 320×240 cameras 300 mm apart and a projector between them, 700 mm from the scene; lens distortion.

    With `upright` the cameras stand above each other, for fringes along y.
    """
    lens = np.array([-0.08, 0.12, 3e-4, -2e-4, 0.0])
    camera = np.array([[800.0, 0, 161.3], [0, 801.0, 118.2], [0, 0, 1]])
    other = np.array([[803.0, 0, 159.3], [0, 799.0, 119.2], [0, 0, 1]])
    beam = np.array([[640.0, 0, 159.5], [0, 640.0, 119.5], [0, 0, 1]])
    target = np.array([0.0, 0.0, 700.0])
    axis = np.array([0.0, 1.0, 0.0]) if upright else np.array([1.0, 0.0, 0.0])
    left = Device(320, 240, camera, lens, np.eye(3), np.zeros(3))
    right = Device(320, 240, other, -0.7 * lens, *_aim(280 * axis, target, scale))
    projector = Device(320, 240, beam, np.zeros(5), *_aim(140 * axis + [10, -30, 20], target, scale))
    return Rig("small", "2026-01-01T00:00:00Z", left, right, projector)


def _aim(position: NDArray, target: NDArray, scale: float) -> tuple[NDArray, NDArray]:
    """R, t of a device at `position` that looks at `target`, both times `scale`."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    return R, -R @ position * scale


def plane_depth(device: Device, normal: NDArray, distance: float) -> NDArray[np.float64]:
    """(h, w, 3) points where a camera's pixels see the plane normal · x = distance."""
    v, u = np.mgrid[: device.height, : device.width].astype(float)
    rays = device.rays(np.stack([u, v], axis=-1))
    reach = (distance - device.centre @ normal) / (rays @ normal)
    return device.centre + reach[..., None] * rays


def seen_coordinate(rig: Rig, points: NDArray, axis: str) -> NDArray[np.float64]:
    """(h, w) projector coordinate of points; NaN where they lie off the projector's image."""
    pixels = rig.projector.project(points)
    return np.where(rig.projector.inside(pixels), pixels[..., 0 if axis == "x" else 1], np.nan)


PLANE_NORMAL = np.array([0.12, -0.08, -1.0]) / np.linalg.norm([0.12, -0.08, -1.0])
PLANE_DISTANCE = float(PLANE_NORMAL @ [0.0, 0.0, 700.0])


def plane_scan(
    rig: Rig,
    code: FringeCode,
    rng: np.random.Generator | None,
    sigma: float = 2.0,
    mean: NDArray | float = 110.0,
    modulation: NDArray | float = 80.0,
    gamma: float = 1.0,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Frames of both cameras looking at the plane; dark where the projector does not reach."""
    size = code.size(rig.projector.width, rig.projector.height)
    views = []
    for device in (rig.left, rig.right):
        scale = np.linalg.norm(rig.right.centre) / np.linalg.norm(small_rig().right.centre)
        coordinate = seen_coordinate(rig, plane_depth(device, PLANE_NORMAL, PLANE_DISTANCE * scale), code.axis)
        lit = np.isfinite(coordinate)
        frames = clean_frames(np.where(lit, coordinate, 0), code, size, mean, modulation, gamma)
        views.append(recorded(np.where(lit, frames, 4.0), rng, sigma))
    return views[0], views[1]

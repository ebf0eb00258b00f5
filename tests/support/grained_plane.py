"""A plane with a random grain before the rig of the calibration bench, at half its pixels: what its cameras decode."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.cloud import DecodedView
from metrology.noise import NoiseModel
from metrology.rig import Device, Rig
from tests.support.calibration_bench import bench_rig, turn

NORMAL = turn(8, -12, 0) @ np.array([0.0, 0.0, 1.0])
THROUGH = np.array([0.0, 0.0, 700.0])
GRAIN_MM = 0.7


def half_size(device: Device) -> Device:
    """The device with half as many pixels, for speed."""
    K = device.K.copy()
    K[:2] /= 2
    return replace(device, width=device.width // 2, height=device.height // 2, K=K)


def half_size_rig() -> Rig:
    """The bench's rig with half as many camera pixels."""
    whole = bench_rig()
    return replace(whole, left=half_size(whole.left), right=half_size(whole.right))


def view(device: Device, projector: Device, grain: NDArray[np.float32], rng: np.random.Generator) -> DecodedView:
    """What a camera decodes and sees of a plane with a random grain."""
    v, u = np.mgrid[: device.height, : device.width].astype(float)
    rays = device.rays(np.stack([u, v], -1))
    reach = (NORMAL @ (THROUGH - device.centre)) / (rays @ NORMAL)
    points = device.centre + reach[..., None] * rays
    place = ((points[..., :2] - THROUGH[:2]) / GRAIN_MM + np.array(grain.shape)[::-1] / 2).astype(np.float32)
    texture = cv2.remap(grain, place[..., 0], place[..., 1], cv2.INTER_CUBIC)
    noise = rng.normal(0, 0.02, texture.shape)
    return DecodedView(
        coordinate=(projector.project(points)[..., 0] + noise).astype(np.float32),
        sigma=np.full(texture.shape, 0.02, np.float32),
        modulation=np.full(texture.shape, 40, np.float32),
        texture=(texture + rng.normal(0, 0.6, texture.shape)).astype(np.float32),
        flags=np.zeros(texture.shape, np.uint16),
        noise=NoiseModel(0.5, 0.01),
    )


def seen_by(rig: Rig, *names: str) -> list[DecodedView]:
    """What cameras of a rig decode and see of the one plane."""
    rng = np.random.default_rng(1)
    grain = (100 + cv2.GaussianBlur(rng.normal(0, 12, (700, 700)), (0, 0), 1.0)).astype(np.float32)
    return [view(getattr(rig, name), rig.projector, grain, rng) for name in names]


@cache
def both_views() -> tuple[DecodedView, DecodedView]:
    """What the cameras of `half_size_rig` see; several tests look at them, none writes to them."""
    left, right = seen_by(half_size_rig(), "left", "right")
    return left, right


def turned(device: Device, axis: int, degrees: float) -> Device:
    """The device turned about an axis of its own."""
    angles = [0.0, 0.0, 0.0]
    angles[axis] = degrees
    rotation = turn(*angles)
    return replace(device, R=rotation @ device.R, t=rotation @ device.t)

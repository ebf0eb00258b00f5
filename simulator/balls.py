"""Spheres before the rig, as on a ball bar: traced exactly, matt, with their shadows.

They stand in the panel's frame in place of a panel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Float32
from metrology.rig import Device
from simulator.relief import Floats
from simulator.require import require
from simulator.shading import Light
from simulator.trace import Hits, four

_OFF_MM = 1e-4
_BAND = 64  # rows at once


@dataclass(frozen=True)
class Ball:
    """A sphere."""

    id: str
    x_mm: float
    y_mm: float
    z_mm: float
    """x_mm, y_mm, z_mm: its centre, panel frame."""
    diameter_mm: float

    def __post_init__(self) -> None:
        require(1 <= self.diameter_mm <= 200, f"sphere {self.id} diameter_mm", self.diameter_mm, "1 to 200 mm")

    @property
    def centre(self) -> Floats:
        """(3,) mm."""
        return np.array([self.x_mm, self.y_mm, self.z_mm])


def trace_balls(
    balls: tuple[Ball, ...], reflectance: float, back_mm: float, light: Light, camera: Device, projector: Device,
    blur_px: float,
) -> Hits:  # fmt: skip
    """Everything a camera sees of spheres before a dark plate.

    Parameters
    ----------
    reflectance : float
        Of the spheres.
    back_mm : float
        How far behind the panel frame's origin the plate stands.
    camera, projector : Device
        Posed in the panel's frame.
    blur_px : float
        Standard deviation of the camera's point-spread function, pixel area included.
    """
    height, width = camera.height, camera.width
    offsets = four(blur_px)
    parts = [
        _band(balls, reflectance, back_mm, light, camera, projector, offsets, slice(top, min(top + _BAND, height)))
        for top in range(0, height, _BAND)
    ]
    column, row, direct, ambient = (np.concatenate(part) for part in zip(*parts, strict=True))
    first = np.arange(height * width + 1, dtype=np.int64) * len(offsets)
    return Hits(height, width, first, column, row, direct, ambient)


def _band(
    balls: tuple[Ball, ...], reflectance: float, back_mm: float, light: Light, camera: Device, projector: Device,
    offsets: Floats, rows: slice,
) -> tuple[Floats, Floats, Float32, Float32]:  # fmt: skip
    v, u = np.mgrid[rows, : camera.width].astype(float)
    pixels = np.stack([u, v], -1).reshape(-1, 1, 2) + offsets
    rays = camera.rays(pixels.reshape(-1, 2))
    distance = (-back_mm - camera.centre[2]) / rays[:, 2]
    normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), rays.shape).copy()
    albedo = np.full(len(rays), light.background)
    for ball in balls:
        at = _meet(camera.centre, rays, ball)
        nearer = at < distance
        distance = np.where(nearer, at, distance)
        normal[nearer] = (camera.centre + at[nearer, None] * rays[nearer] - ball.centre) / (ball.diameter_mm / 2)
        albedo[nearer] = reflectance
    points = camera.centre + distance[:, None] * rays
    towards = projector.centre - points
    r = np.linalg.norm(towards, axis=1)
    towards /= r[:, None]
    cosine = (normal * towards).sum(1)
    start = points + _OFF_MM * normal
    seen = cosine > 0
    for ball in balls:
        seen &= ~np.isfinite(_meet(start, towards, ball))
    bright = np.where(seen, light.brightness * albedo * cosine * (light.distance_mm / r) ** 2, 0.0)
    coordinate = projector.project(points)
    return (
        coordinate[:, 0].copy(), coordinate[:, 1].copy(), bright.astype(np.float32),
        (light.ambient * albedo).astype(np.float32),
    )  # fmt: skip


def _meet(origins: Floats, rays: Floats, ball: Ball) -> NDArray[np.float64]:
    """Distance along unit rays at which they meet a sphere from outside; inf where they miss it."""
    off = origins - ball.centre
    along = (off * rays).sum(-1)
    under = along**2 - (off**2).sum(-1) + (ball.diameter_mm / 2) ** 2
    with np.errstate(invalid="ignore"):
        at = -along - np.sqrt(under)
    return np.where((under > 0) & (at > 0), at, np.inf)

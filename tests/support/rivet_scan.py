"""Organised clouds of riveted skin with known truth, made directly: no fringes, so hundreds of heads in seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from metrology.arrays import Array
from metrology.cloud import DecodedView, Reconstruction
from metrology.results import RivetDetection
from metrology.rig import Device, Rig
from metrology.rivets.ellipse import ellipse_of_shape
from metrology.rivets.geometry import image_scales
from metrology.surfaces import Frame


@dataclass(frozen=True)
class Head:
    """A head on the skin: centre in the skin's frame, size, height and tilt, mm and degrees."""

    x: float
    y: float
    diameter: float = 8.0
    height: float = 0.1
    tilt_deg: float = 0.0
    tilt_towards_deg: float = 0.0
    crown: float = 0.0
    contrast: float = 40.0


@dataclass(frozen=True)
class Skin:
    """The skin: its frame and two radii of curvature (mm, positive towards the rig), and noise of the cloud."""

    radius_x: float = np.inf
    radius_y: float = np.inf
    slant_deg: tuple[float, float] = (10.0, -6.0)
    sigma_z: float = 0.015
    correlated_px: float = 0.0

    @property
    def frame(self) -> Frame:
        a, b = np.radians(self.slant_deg)
        return Frame.on_plane([0.0, 0.0, 700.0], [np.tan(b), np.tan(a), -1.0])

    def height(self, x: Array, y: Array) -> Array:
        return np.asarray(-(x**2) / (2 * self.radius_x) - y**2 / (2 * self.radius_y))


def rig_of(width: int = 640, height: int = 480) -> Rig:
    """Two cameras of five pixels per millimetre at 700 mm, and a projector between them."""
    K = np.array([[3500.0, 0, width / 2 + 3], [0, 3507.0, height / 2 - 5], [0, 0, 1]])
    lens = np.array([-0.09, 0.12, 2e-4, -1e-4, 0.0])
    devices = []
    for x, distortion in ((0.0, lens), (280.0, -0.6 * lens), (140.0, np.zeros(5))):
        forward = np.array([-x, 0.0, 700.0]) / np.hypot(x, 700.0)
        right = np.cross([0.0, 1.0, 0.0], forward)
        R = np.stack([right, np.cross(forward, right), forward])
        devices.append(Device(width, height, K, distortion, R, -R @ [x, 0.0, 0.0]))
    return Rig("test", "2026-01-01T00:00:00Z", *devices)


def scan(skin: Skin, heads: Sequence[Head], rng: np.random.Generator | None, grain: float = 0.6) -> Reconstruction:
    """The cloud and textures that a perfect instrument with the skin's noise would give."""
    rig = rig_of()
    points, textures = without_noise(skin, tuple(heads))
    size = points.shape[:2]
    if rng is not None:
        error = rng.normal(size=size)
        if skin.correlated_px:
            error = cv2.GaussianBlur(error, (0, 0), skin.correlated_px)
        points = points * (1 + skin.sigma_z * error / error.std() / points[..., 2])[..., None]
        textures = [texture + rng.normal(0, grain, size) for texture in textures]
    views = [
        DecodedView(
            coordinate=np.broadcast_to(np.arange(size[1], dtype=np.float32), size),
            sigma=np.full(size, 0.02, np.float32),
            modulation=np.full(size, 60, np.float32),
            texture=texture.astype(np.float32),
            flags=np.zeros(size, np.uint16),
        )
        for texture in textures
    ]
    return Reconstruction(
        rig=rig,
        left=views[0],
        right=views[1],
        points=points.astype(np.float32),
        sigma_z=np.full(size, skin.sigma_z, np.float32),
        flags=np.zeros(size, np.uint16),
    )


@cache
def without_noise(skin: Skin, heads: tuple[Head, ...]) -> tuple[Array, list[Array]]:
    """(h, w, 3) points that the left camera sees, and both cameras' textures."""
    rig = rig_of()
    seen = [seen_by(camera, skin, heads) for camera in (rig.left, rig.right)]
    shade = 0.05 * (np.arange(rig.left.width) - 0.5 * (rig.left.width - 1))
    return seen[0][0], [110.0 + shade - ring_darkness(heads, *places, rig) for _, places in seen]


def seen_by(camera: Device, skin: Skin, heads: Sequence[Head]) -> tuple[Array, tuple[Array, Array]]:
    """(h, w, 3) points that a camera's pixels see, and their x and y in the skin's frame."""
    frame = skin.frame
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    rays = camera.rays(np.stack([u, v], axis=-1)) @ frame.axes.T
    eye = frame.local(camera.centre)
    level = np.zeros(u.shape)
    for _ in range(6):
        reach = (level - eye[2]) / rays[..., 2]
        x, y = eye[0] + reach * rays[..., 0], eye[1] + reach * rays[..., 1]
        level = surface(skin, heads, x, y)
    return frame.rig(np.stack([x, y, level], axis=-1)), (x, y)


def surface(skin: Skin, heads: Sequence[Head], x: Array, y: Array) -> Array:
    """Height of skin and heads over the skin's frame; a head's plane refers to the tangent plane at its centre."""
    level = skin.height(x, y)
    for head in heads:
        dx, dy = x - head.x, y - head.y
        inside = np.hypot(dx, dy) < head.diameter / 2
        slope = np.tan(np.radians(head.tilt_deg))
        turn = np.radians(head.tilt_towards_deg)
        at = float(skin.height(np.array(head.x), np.array(head.y)))
        tangent = at - head.x * dx / skin.radius_x - head.y * dy / skin.radius_y
        dome = head.crown * (0.5 - (dx**2 + dy**2) / (head.diameter / 2) ** 2)
        plane = tangent + head.height + slope * (dx * np.cos(turn) + dy * np.sin(turn)) + dome
        level = np.where(inside, plane, level)
    return level


def ring_darkness(heads: Sequence[Head], x: Array, y: Array, rig: Rig) -> Array:
    """Grey levels that the gaps round the heads take, blurred to 0.75 pixels."""
    sigma = 0.75 * 700.0 / rig.left.K[0, 0]
    dark = np.zeros(x.shape)
    for head in heads:
        r = np.hypot(x - head.x, y - head.y) - head.diameter / 2
        dark += head.contrast * np.exp(-0.5 * (r / sigma) ** 2)
    return dark


def truth_detection(reconstruction: Reconstruction, skin: Skin, head: Head) -> RivetDetection:
    """The detection of a head as it is: what measuring is given when detection makes no error."""
    frame = skin.frame
    level = float(skin.height(np.array(head.x), np.array(head.y)))
    centre = frame.rig([head.x, head.y, level + head.height / 2])
    normal = np.array([head.x / skin.radius_x, head.y / skin.radius_y, 1.0]) @ frame.axes
    [jacobian] = image_scales(reconstruction.rig.left, centre[None], normal[None])
    pixel = reconstruction.rig.left.project(centre)
    e = ellipse_of_shape(pixel[0], pixel[1], (head.diameter / 2) ** 2 * jacobian @ jacobian.T)
    return RivetDetection(e.u, e.v, 2 * e.a, 2 * e.b, float(np.degrees(e.angle)), 1.0, rim_sigma_px=0.75)

"""Synthetic textures of riveted skin with exact truth: what detection is tested and timed on.

A flat panel seen by a tilted pinhole camera: brushed metal under uneven light, rims as thin rings, seams, scratches,
glints, slots, and round things that are no rivets. The scene is painted at twice the resolution, blurred by the lens
and averaged to pixels, so that rims are blurred as a lens blurs them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from tests.support.texture_spec import RimTruth, Texture, TextureSpec

Image = NDArray[np.float32]

_FINE = 2  # painted pixels per pixel
_FOCAL_PX = 2600.0


@dataclass(frozen=True)
class _View:
    """Plane (mm) to image (px) and back."""

    to_image: Array
    to_plane: Array

    def pixels(self, points: Array) -> Array:
        q = np.column_stack([points, np.ones(len(points))]) @ self.to_image.T
        return np.asarray(q[:, :2] / q[:, 2:])

    def plane(self, u: Array, v: Array) -> tuple[Array, Array]:
        m = self.to_plane
        w = m[2, 0] * u + m[2, 1] * v + m[2, 2]
        return (m[0, 0] * u + m[0, 1] * v + m[0, 2]) / w, (m[1, 0] * u + m[1, 1] * v + m[1, 2]) / w

    def circle(self, centre: Array, radius: float) -> tuple[float, float, float, float, float]:
        """The image of a circle: u, v, semi-axes (longer first), angle."""
        x, y = centre
        conic = np.array([[1, 0, -x], [0, 1, -y], [-x, -y, x * x + y * y - radius**2]])
        q = self.to_plane.T @ conic @ self.to_plane
        middle = -np.linalg.solve(q[:2, :2], q[:2, 2])
        level = q[2, 2] + q[:2, 2] @ middle
        values, vectors = np.linalg.eigh(q[:2, :2] / -level)
        major = vectors[:, 0]
        return (
            float(middle[0]),
            float(middle[1]),
            float(1 / np.sqrt(values[0])),
            float(1 / np.sqrt(values[1])),
            float(np.arctan2(major[1], major[0]) % np.pi),
        )


def paint_texture(spec: TextureSpec, generator: np.random.Generator) -> Texture:
    """Paint one image."""
    view = _view(spec, generator)
    height, width = spec.height * _FINE, spec.width * _FINE
    v, u = np.mgrid[0:height, 0:width].astype(np.float64)
    u, v = (u + 0.5) / _FINE - 0.5, (v + 0.5) / _FINE - 0.5
    x, y = view.plane(u, v)
    canvas = _light(spec, u, v, generator) + _grain(spec, generator, (height, width))
    blur = generator.uniform(0.6, 1.1)
    seams = [_paint_seam(canvas, view, x, y, k, generator) for k in range(spec.seams)]
    rims = _paint_rims(canvas, view, spec, seams, blur, generator)
    _paint_distractors(canvas, view, spec, seams, rims, generator)
    _paint_scratches(canvas, spec, generator)
    blurred = cv2.GaussianBlur(canvas, (0, 0), blur * _FINE)
    image = cv2.resize(blurred, (spec.width, spec.height), interpolation=cv2.INTER_AREA).astype(np.float32)
    for _ in range(spec.highlights):
        centre = generator.uniform([0, 0], [spec.width, spec.height])
        _add_glint(image, centre, generator.uniform(15, 80, 2), generator.uniform(40, 130), generator)
    rims = [_with_glint(image, r, generator) if generator.random() < spec.glints else r for r in rims]
    levels = image + generator.normal(0, spec.noise, image.shape)
    return Texture(
        image=np.clip(np.rint(levels), 0, 255).astype(np.uint8),
        rims=tuple(rims),
        seams=tuple(view.pixels(s(np.linspace(-300, 300, 3000))) for s in seams),
    )


def _view(spec: TextureSpec, generator: np.random.Generator) -> _View:
    """A camera 650 mm from a panel slanted by up to the given tilt in any direction, four pixels to the millimetre."""
    tilt, azimuth = np.radians(generator.uniform(0.1, 1) * spec.tilt_deg), generator.uniform(0, 2 * np.pi)
    rotation = cv2.Rodrigues(tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]))[0]
    rotation = rotation @ cv2.Rodrigues(np.array([0.0, 0.0, generator.uniform(-0.3, 0.3)]))[0]
    K = np.array([[_FOCAL_PX, 0, spec.width / 2], [0, _FOCAL_PX, spec.height / 2], [0, 0, 1]])
    to_image = K @ np.column_stack([rotation[:, 0], rotation[:, 1], [0, 0, _FOCAL_PX / 4]])
    return _View(to_image, np.linalg.inv(to_image))


def _light(spec: TextureSpec, u: Array, v: Array, generator: np.random.Generator) -> Image:
    """Skin under a lamp: a slope and a fall-off to the corners."""
    p, q = 2 * u / spec.width - 1, 2 * v / spec.height - 1
    slope = generator.uniform(-22, 22, 2)
    light = generator.uniform(105, 140) + slope[0] * p + slope[1] * q - generator.uniform(8, 18) * (p**2 + q**2)
    return np.asarray(light, np.float32)


def _grain(spec: TextureSpec, generator: np.random.Generator, shape: tuple[int, int]) -> Image:
    """Brushed metal: streaks along one direction, and blotches of dirt."""
    streaks = cv2.GaussianBlur(generator.normal(size=shape).astype(np.float32), (0, 0), 6 * _FINE, sigmaY=0.6 * _FINE)
    cell = 64 * _FINE
    coarse = generator.normal(size=(shape[0] // cell + 2, shape[1] // cell + 2)).astype(np.float32)
    blotches = cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    return spec.grain * streaks / streaks.std() + 2.0 * blotches


Curve = Callable[[Array], Array]


def _paint_seam(canvas: Image, view: _View, x: Array, y: Array, number: int, generator: np.random.Generator) -> Curve:
    """A dark gap across the panel, with the panels beside it not equally bright; returns its centre line in mm."""
    along_x = bool((number + generator.integers(2)) % 2) if number == 0 else bool(number % 2)
    offset, slope = generator.uniform(-80, 80), generator.uniform(-0.05, 0.05)
    bow, period = generator.uniform(0.2, 1.2), generator.uniform(200, 420)

    def line(s: Array) -> Array:
        return np.asarray(offset + slope * s + bow * np.sin(2 * np.pi * s / period))

    s, across = (x, y) if along_x else (y, x)
    distance = (across - line(s)).astype(np.float32)
    canvas[np.abs(distance) < generator.uniform(0.7, 1.4)] -= generator.uniform(12, 55)
    canvas[distance > 0] += generator.uniform(-6, 6)

    def curve(t: Array) -> Array:
        return np.column_stack([t, line(t)] if along_x else [line(t), t])

    return curve


def _paint_rims(
    canvas: Image, view: _View, spec: TextureSpec, seams: list[Curve], blur: float, generator: np.random.Generator
) -> list[RimTruth]:
    """Rims of four sizes, clear of seams and of each other by half a diameter."""
    sizes = np.exp(generator.uniform(np.log(spec.radius_px[0]), np.log(spec.radius_px[1]), 4))
    wanted = int(generator.integers(spec.rivets[0], spec.rivets[1] + 1))
    rims: list[RimTruth] = []
    for _ in range(200 * wanted):
        if len(rims) == wanted:
            break
        centre_px = generator.uniform([0, 0], [spec.width, spec.height])
        x, y = view.plane(*centre_px)
        centre = np.array([x, y], float)
        local = np.sqrt(abs(np.linalg.det(_jacobian(view, centre))))
        radius = float(generator.choice(sizes)) / local
        ellipse = view.circle(centre, radius)
        if not _is_free(ellipse, spec, view, seams, rims):
            continue
        rims.append(_paint_rim(canvas, view, centre, radius, local, ellipse, blur, spec, generator))
    return rims


def _jacobian(view: _View, centre: Array) -> Array:
    ends = view.pixels(centre + np.array([[0, 0], [1e-3, 0], [0, 1e-3]]))
    return np.asarray((ends[1:] - ends[0]).T / 1e-3)


def _is_free(
    ellipse: tuple[float, float, float, float, float],
    spec: TextureSpec,
    view: _View,
    seams: list[Curve],
    rims: list[RimTruth],
) -> bool:
    u, v, a, b, _ = ellipse
    margin = a + 9
    if b < 0.85 * spec.radius_px[0] or a > 1.2 * spec.radius_px[1]:
        return False
    if not (margin < u < spec.width - margin and margin < v < spec.height - margin):
        return False
    for seam in seams:
        if np.hypot(*(view.pixels(seam(np.linspace(-300, 300, 1200))) - [u, v]).T).min() < a + 14:
            return False
    return all(np.hypot(u - r.u, v - r.v) > max(a + r.a + 10, 1.5 * (a + r.a)) for r in rims)


def _paint_rim(
    canvas: Image,
    view: _View,
    centre: Array,
    radius: float,
    pixels_per_mm: float,
    ellipse: tuple[float, float, float, float, float],
    blur: float,
    spec: TextureSpec,
    generator: np.random.Generator,
) -> RimTruth:
    """One head: its own brightness, the gap round it, perhaps a slot and a filled arc."""
    gap = generator.uniform(0.15, 0.4)
    lo, hi = np.log(spec.contrast)
    contrast = float(np.exp(generator.uniform(lo, hi)))
    sign = -1.0 if generator.random() < spec.bright else 1.0
    hidden = generator.uniform(30, 110) if generator.random() < spec.partial else 0.0
    facing, wave, phase = generator.uniform(-np.pi, np.pi), generator.uniform(0, 0.3), generator.uniform(-np.pi, np.pi)
    u0, v0, u1, v1 = _window(ellipse, canvas.shape, 4.0)
    v, u = np.mgrid[v0:v1, u0:u1].astype(float)
    x, y = view.plane((u + 0.5) / _FINE - 0.5, (v + 0.5) / _FINE - 0.5)
    dx, dy = x - centre[0], y - centre[1]
    rho, theta = np.hypot(dx, dy), np.arctan2(dy, dx)
    # Soft by a quarter of a painted pixel: area coverage of the painted pixels.
    soft = 0.25 / pixels_per_mm
    inside = _soft_step((radius - gap / 2 - rho) / soft)
    ring = _soft_step((radius + gap / 2 - rho) / soft) - inside
    peak = _blurred_bar(gap * pixels_per_mm, blur)
    strength = contrast / peak * (1 + wave * np.cos(2 * theta - phase))
    if hidden:
        away = np.abs((theta - facing + np.pi) % (2 * np.pi) - np.pi)
        strength = strength * _soft_step((away - np.radians(hidden) / 2) / 0.03)
    head = generator.uniform(-3, 3) + generator.uniform(-3, 3) * (dx * np.cos(phase) + dy * np.sin(phase)) / radius
    patch = inside * head - sign * ring * strength
    if generator.random() < spec.slots:
        turn = generator.uniform(0, np.pi)
        along, across = dx * np.cos(turn) + dy * np.sin(turn), dy * np.cos(turn) - dx * np.sin(turn)
        patch -= 2 * contrast * ((np.abs(across) < 0.12 * radius) & (np.abs(along) < 0.7 * radius))
    canvas[v0:v1, u0:u1] += patch.astype(np.float32)
    sigma = float(np.hypot(blur, gap * pixels_per_mm / np.sqrt(12)))
    return RimTruth(*ellipse, contrast=sign * contrast, coverage=1 - hidden / 360, sigma_px=sigma, glint=False)


def _soft_step(t: Array) -> Array:
    return np.asarray(1 / (1 + np.exp(-np.clip(t, -40, 40) * 1.7)))


def _blurred_bar(width_px: float, blur_px: float) -> float:
    """Centre value of a bar of height 1 under a Gaussian blur, pixel averaging included."""
    sigma = np.hypot(blur_px, 1 / np.sqrt(12))
    t = np.linspace(-0.5, 0.5, 201) * width_px
    return float(np.mean(np.exp(-0.5 * (t / sigma) ** 2)) * width_px / (np.sqrt(2 * np.pi) * sigma))


def _window(
    ellipse: tuple[float, float, float, float, float], shape: tuple[int, ...], margin: float
) -> tuple[int, int, int, int]:
    """u0, v0, u1, v1 in painted pixels."""
    u, v, a, _, _ = ellipse
    reach = (a + margin) * _FINE
    return (
        max(0, int(u * _FINE - reach)),
        max(0, int(v * _FINE - reach)),
        min(shape[1], int(u * _FINE + reach) + 2),
        min(shape[0], int(v * _FINE + reach) + 2),
    )


def _paint_distractors(
    canvas: Image,
    view: _View,
    spec: TextureSpec,
    seams: list[Curve],
    rims: list[RimTruth],
    generator: np.random.Generator,
) -> None:
    """Round stickers (a brighter or darker disc) and open holes (a black disc): neither has a rim."""
    placed = list(rims)
    for k in range(spec.stickers + spec.holes):
        for _ in range(200):
            centre_px = generator.uniform([0, 0], [spec.width, spec.height])
            centre = np.array(view.plane(*centre_px), float)
            local = np.sqrt(abs(np.linalg.det(_jacobian(view, centre))))
            radius = generator.uniform(*spec.radius_px) / local
            ellipse = view.circle(centre, radius)
            if _is_free(ellipse, spec, view, seams, placed):
                break
        else:
            continue
        placed.append(RimTruth(*ellipse, contrast=0.0, coverage=1.0, sigma_px=1.0, glint=False))
        u0, v0, u1, v1 = _window(ellipse, canvas.shape, 4.0)
        v, u = np.mgrid[v0:v1, u0:u1].astype(float)
        x, y = view.plane((u + 0.5) / _FINE - 0.5, (v + 0.5) / _FINE - 0.5)
        inside = _soft_step((radius - np.hypot(x - centre[0], y - centre[1])) * local * 4).astype(np.float32)
        part = canvas[v0:v1, u0:u1]
        if k < spec.stickers:
            part += inside * generator.choice([-1, 1]) * np.float32(generator.uniform(8, 60))
        else:
            part += inside * (generator.uniform(5, 15) - part)


def _paint_scratches(canvas: Image, spec: TextureSpec, generator: np.random.Generator) -> None:
    """Fine lines, straight or a little bent, dark or bright."""
    for _ in range(spec.scratches):
        length, direction = generator.uniform(50, 480) * _FINE, generator.uniform(0, 2 * np.pi)
        t = np.arange(0, length, 2.0)
        angle = direction + generator.uniform(-1, 1) / (900 * _FINE) * t
        start = generator.uniform([0, 0], [spec.width * _FINE, spec.height * _FINE])
        points = start + np.cumsum(2.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1), axis=0)
        layer = np.zeros(canvas.shape, np.uint8)
        corners = np.round(points * 16).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(layer, [corners], False, 255, 1, cv2.LINE_AA, shift=4)
        canvas += layer.astype(np.float32) / 255 * np.float32(generator.choice([-1, 1]) * generator.uniform(25, 90))


def _with_glint(image: Image, rim: RimTruth, generator: np.random.Generator) -> RimTruth:
    """A reflection of the lamp on or near the head."""
    t, share = generator.uniform(0, 2 * np.pi), generator.uniform(0, 1.05)
    c, s = np.cos(rim.angle), np.sin(rim.angle)
    x, y = share * rim.a * np.cos(t), share * rim.b * np.sin(t)
    centre = np.array([rim.u + c * x - s * y, rim.v + s * x + c * y])
    size = generator.uniform(1.5, 5, 2)
    _add_glint(image, centre, size * min(1.0, rim.b / 18), generator.uniform(40, 160), generator)
    return RimTruth(rim.u, rim.v, rim.a, rim.b, rim.angle, rim.contrast, rim.coverage, rim.sigma_px, glint=True)


def _add_glint(image: Image, centre: Array, size: Array, height: float, generator: np.random.Generator) -> None:
    turn = generator.uniform(0, np.pi)
    reach = int(4 * size.max()) + 1
    u0, u1 = max(0, int(centre[0]) - reach), min(image.shape[1], int(centre[0]) + reach + 1)
    v0, v1 = max(0, int(centre[1]) - reach), min(image.shape[0], int(centre[1]) + reach + 1)
    v, u = np.mgrid[v0:v1, u0:u1].astype(float)
    p = (u - centre[0]) * np.cos(turn) + (v - centre[1]) * np.sin(turn)
    q = (v - centre[1]) * np.cos(turn) - (u - centre[0]) * np.sin(turn)
    image[v0:v1, u0:u1] += (height * np.exp(-0.5 * ((p / size[0]) ** 2 + (q / size[1]) ** 2))).astype(np.float32)

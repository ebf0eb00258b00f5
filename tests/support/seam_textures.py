"""Images with seams by formula: blurred bands on unevenly lit, grainy skin, with exact centre lines and ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from metrology.arrays import Array


@dataclass(frozen=True)
class Band:
    """A seam in the image: its course is ``y = bow · sin(2π x/period)``, x along it from `through`, y across.

    Attributes
    ----------
    through : (u, v)
        px.
    angle_deg : float
        Direction of x, from +u towards +v.
    width_px : float
    contrast : float
        Grey levels below the skin (negative: brighter).
    reach : (float, float)
        Where along x it begins and ends, px.
    bow_px, period_px : float
    other_side : float
        How much brighter the skin on the side of growing y is, grey levels.
    """

    through: tuple[float, float]
    angle_deg: float
    width_px: float = 8.0
    contrast: float = 40.0
    reach: tuple[float, float] = (-3000.0, 3000.0)
    bow_px: float = 0.0
    period_px: float = 1600.0
    other_side: float = 0.0

    def local(self, u: Array, v: Array) -> tuple[Array, Array]:
        """x along the course's axis, and signed distance from the course (exact to second order of its bend)."""
        angle = np.deg2rad(self.angle_deg)
        du, dv = u - self.through[0], v - self.through[1]
        x, y = du * np.cos(angle) + dv * np.sin(angle), -du * np.sin(angle) + dv * np.cos(angle)
        wave = 2 * np.pi / self.period_px
        slope = self.bow_px * wave * np.cos(wave * x)
        return x, (y - self.bow_px * np.sin(wave * x)) / np.sqrt(1 + slope**2)

    def offsets(self, points: Array) -> Array:
        """Signed distance of points (n, 2) from the centre line, px."""
        return self.local(points[:, 0], points[:, 1])[1]

    def end(self, which: int) -> Array:
        """u, v of one end (0 or 1)."""
        angle, x = np.deg2rad(self.angle_deg), self.reach[which]
        y = self.bow_px * np.sin(2 * np.pi * x / self.period_px)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return np.asarray(self.through + turn @ [x, y])


@dataclass(frozen=True)
class Look:
    """How the camera sees it: lens blur (standard deviation, px; the pixel comes on top), noise, grain, light."""

    blur_px: float = 0.7
    noise: float = 2.0
    grain: float = 0.6
    skin: float = 120.0
    slope: float = 15.0


def paint(
    bands: Sequence[Band],
    shape: tuple[int, int],
    generator: np.random.Generator,
    look: Look | None = None,
    discs: Sequence[tuple[float, float, float, float]] = (),
    glints: Sequence[tuple[float, float, float, float]] = (),
) -> NDArray[np.float32]:
    """(h, w) grey levels of skin with seams.

    Parameters
    ----------
    discs : sequence of (u, v, radius, level)
        Rivet heads that cover the seams.
    glints : sequence of (u, v, sigma, level)
        Highlights, clipped at 255.
    """
    look = look or Look()
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    # Blur of lens and pixel together.
    soft = np.sqrt(2.0 * (look.blur_px**2 + 1 / 12))
    image = look.skin + look.slope * (u / shape[1] - 0.5) - look.slope * (v / shape[0] - 0.5) ** 2
    places = [band.local(u, v) for band in bands]
    floor = image.copy()
    for band, (_, y) in zip(bands, places, strict=True):
        image += band.other_side * (y > 0)
    for band, (x, y) in zip(bands, places, strict=True):
        across = 0.5 * (erf((y + band.width_px / 2) / soft) - erf((y - band.width_px / 2) / soft))
        along = 0.5 * (erf((x - band.reach[0]) / soft) - erf((x - band.reach[1]) / soft))
        cover = across * along
        image = image * (1 - cover) + (floor - band.contrast) * cover
    for centre_u, centre_v, radius, level in discs:
        inside = 0.5 * (1 - erf((np.hypot(u - centre_u, v - centre_v) - radius) / soft))
        image = image * (1 - inside) + level * inside
    for centre_u, centre_v, sigma, level in glints:
        image += level * np.exp(-0.5 * ((u - centre_u) ** 2 + (v - centre_v) ** 2) / sigma**2)
    if look.grain > 0:
        streaks = cv2.GaussianBlur(generator.normal(size=shape), (0, 0), 6.0, sigmaY=0.6)
        image += look.grain * streaks / streaks.std()
    image += generator.normal(0, look.noise, shape)
    return np.clip(np.rint(image), 0, 255).astype(np.float32)


def random_bands(generator: np.random.Generator, shape: tuple[int, int], count: int) -> list[Band]:
    """Seams right across an image: the first in any direction, the next at some angle to it."""
    angle = generator.uniform(0, 180)
    bands = []
    for k in range(count):
        bands.append(
            Band(
                through=(
                    shape[1] * generator.uniform(0.35, 0.65),
                    shape[0] * generator.uniform(0.35, 0.65),
                ),
                angle_deg=angle + 90 * k + generator.uniform(-20, 20),
                width_px=generator.uniform(4, 16),
                contrast=generator.uniform(12, 55),
                bow_px=generator.uniform(0, 5),
                period_px=generator.uniform(800, 1700),
                other_side=generator.uniform(-6, 6),
            )
        )
    return bands

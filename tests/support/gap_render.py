"""The picture of a gap's section by casting single rays at its outline: slow, and sharing nothing with `gap.model`."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from metrology.arrays import Array
from metrology.seams.gap import model
from metrology.seams.gap.levels import LEVEL_SCATTER
from metrology.seams.gap.profiles import Profiles

SKIN_A, CHAMFER_A, WALL_A, FLOOR, WALL_B, CHAMFER_B, SKIN_B = range(7)
# Relative brightness where light falls, and in shadow.
LIT = np.array([1.0, 0.55, 0.15, 0.32, 0.15, 0.6, 0.98])
SHADED = np.array([1.0, 0.05, 0.08, 0.04, 0.08, 0.05, 0.98])
FINE_MM = 0.004


@dataclass(frozen=True)
class Gap:
    """A gap between two skins; side B lies `step_mm` higher."""

    width_mm: float
    chamfer_mm: float = 0.0
    step_mm: float = 0.0
    depth_mm: float = 3.0
    sealed: bool = False
    chamfer_slope: float = 1.0
    # What the sky gives the middle of the floor, of its brightness.
    sky: float = 0.0
    # Brightness of both chamfers in the lamp's light.
    glints: tuple[float, float] = (float(LIT[CHAMFER_A]), float(LIT[CHAMFER_B]))
    # Brightness of all but the skin, relative to what it is beside skin without a highlight.
    dimmed: float = 1.0

    @property
    def outline(self) -> Array:
        """(8, 2) x, h from far out on skin A to far out on skin B; h above the mean of both skins."""
        low, high = -self.step_mm / 2, self.step_mm / 2
        half, c = self.width_mm / 2, self.chamfer_mm
        down = self.chamfer_slope * c
        foot = (low - down, high - down) if self.sealed else (-self.depth_mm, -self.depth_mm)
        return np.array([
            [-30, low], [-half - c, low], [-half, low - down], [-half, foot[0]],
            [half, foot[1]], [half, high - down], [half + c, high], [30, high],
        ])  # fmt: skip


def seen(gap: Gap, xi: float, eye: Array, lamp: Array) -> tuple[int, bool]:
    """Which piece of the outline the ray from `eye` through (xi, 0) meets first, and whether light falls on it."""
    direction = np.array([xi, 0.0]) - eye
    far = eye + 3.0 * direction
    distance, piece = min(crossings(gap.outline, eye, far))
    point = eye + distance * (far - eye)
    towards = (lamp - point) / np.linalg.norm(lamp - point)
    # The light must come from the piece's outer side, and past everything.
    a, b = gap.outline[piece], gap.outline[piece + 1]
    facing = (b[0] - a[0]) * towards[1] - (b[1] - a[1]) * towards[0] > 0
    return piece, bool(facing and not crossings(gap.outline, point + 1e-7 * towards, point + 20 * towards))


def crossings(outline: Array, start: Array, end: Array) -> list[tuple[float, int]]:
    """Where on the way from start to end (0 … 1) it crosses which piece."""
    found = []
    way = end - start
    for k, (a, b) in enumerate(itertools.pairwise(outline)):
        along = b - a
        bottom = way[0] * along[1] - way[1] * along[0]
        if bottom == 0:
            continue
        t = ((a[0] - start[0]) * along[1] - (a[1] - start[1]) * along[0]) / bottom
        s = ((a[0] - start[0]) * way[1] - (a[1] - start[1]) * way[0]) / bottom
        if 0 < t <= 1 and 0 <= s <= 1:
            found.append((float(t), k))
    return found


def sky_seen(gap: Gap, x: float) -> float:
    """Share of the sky's light that a place on the floor gets: directions (2-D, by their cosine) that meet nothing."""
    start = np.array([x, -gap.depth_mm + 1e-6])
    angles = np.linspace(-np.pi / 2, np.pi / 2, 721)[1:-1]
    free = [not crossings(gap.outline, start, start + 20 * np.array([np.sin(a), np.cos(a)])) for a in angles]
    return float(np.cos(angles) @ free / np.cos(angles).sum())


def picture(gap: Gap, eye: Array, lamp: Array, reach_mm: float, px_mm: float, lens_px: float) -> tuple[Array, Array]:
    """Fine positions on the reference curve, and the blurred brightness there."""
    xi = np.arange(-reach_mm - 1, reach_mm + 1, FINE_MM)
    pieces = [seen(gap, float(x), eye, lamp) for x in xi]
    lit_level = LIT.copy()
    lit_level[[CHAMFER_A, CHAMFER_B]] = gap.glints
    sharp = np.array([lit_level[piece] if lit else SHADED[piece] for piece, lit in pieces])
    sharp *= np.array([1.0 if piece in (SKIN_A, SKIN_B) else gap.dimmed for piece, _ in pieces])
    if gap.sky > 0:
        inside = np.linspace(-0.5, 0.5, 41)[1:-1] * gap.width_mm
        seen_there = np.array([sky_seen(gap, float(x)) for x in inside])
        # Where on the floor the ray from the eye through ξ arrives.
        floor_x = xi + (xi - eye[0]) * gap.depth_mm / eye[1]
        change = np.interp(floor_x, inside, seen_there / seen_there[len(inside) // 2] - 1.0)
        sharp += np.array([gap.sky if piece == FLOOR else 0.0 for piece, _ in pieces]) * change
    lens = gaussian_filter1d(sharp, lens_px / px_mm / FINE_MM, mode="nearest")
    return xi, uniform_filter1d(lens, round(1 / px_mm / FINE_MM), mode="nearest")


def profiles(gap: Gap, stations: int, rng: np.random.Generator, noise: float = 0.01, lens_px: float = 0.6) -> Profiles:
    """What two cameras see of a straight seam, some 20 rows of pixels per station."""
    eyes, lamp, px_mm = np.array([[-160.0, 680.0], [130.0, 685.0]]), np.array([-25.0, 690.0]), 5.0
    reach = gap.width_mm / 2 + gap.chamfer_mm + 1.6
    n, k = round(2 * reach * px_mm / 0.25), len(eyes)
    x = np.broadcast_to(np.linspace(-reach, reach, n), (stations, k, n)).copy()
    x += rng.uniform(-0.02, 0.02, x.shape)
    fine = [picture(gap, eye, lamp, reach, px_mm, lens_px) for eye in eyes]
    clean = np.stack([np.interp(x[:, c], *fine[c]) for c in range(k)], axis=1)
    return Profiles(
        stations=np.arange(stations),
        half_widths=np.full(stations, (gap.width_mm + gap.chamfer_mm) / 2),
        places=np.linspace(-1, 1, stations),
        x=x,
        grey=clean * (1 + noise * rng.standard_normal(clean.shape)),
        variance=np.full(clean.shape, noise**2) * np.maximum(clean, 0.05) ** 2,
        sizes=np.full((stations, k), n),
        tilts=np.tile([-gap.step_mm / 2, 0.0], (stations, 1)),
        eyes=np.tile(eyes, (stations, 1, 1)),
        lamps=np.tile(lamp, (stations, 1)),
        px_mm=np.full((stations, k), px_mm),
        normals=np.tile([1.0, 0.0], (k, 1)),
        ambient=np.array([0.2, 0.2]),
        chamfer_slope=1.0,
        courses=np.zeros((stations, k, model.LEVELS)),
        level_scatter=LEVEL_SCATTER,
    )

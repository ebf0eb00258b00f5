"""Paints the reflectance of a panel's skin: brushing, blotches, scratches, stickers, smudges, letters and marks.

What has a thickness is drawn once more into the coat, the map of how far paint and stickers stand above the skin.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Float32
from simulator.clutter import Patch, Scratch
from simulator.marks import Stencil, Stroke, letter_coverage, letters_reach
from simulator.overlay import COAT_TEXEL_MM
from simulator.panel import Panel
from simulator.relief import Floats
from simulator.trace import ReflectanceMap

TEXEL_MM = COAT_TEXEL_MM  # about half a camera pixel


def paint(panel: Panel, rng: np.random.Generator) -> ReflectanceMap:
    """The panel's reflectance map, rows along +y."""
    surface = panel.surface
    shape, origin = _map(panel)
    values = np.ones(shape, np.float32)
    if surface.blotches:
        values += np.float32(surface.blotches) * _clouds(shape, surface.blotch_mm, rng)
    if surface.brushing:
        streaks = _streaks(shape, surface.streak_mm, surface.grain_mm, math.radians(surface.brushing_deg), rng)
        values += np.float32(surface.brushing) * streaks
    for scratch in (*surface.scratches, *_random_scratches(panel, rng)):
        _draw_scratch(values, origin, scratch)
    for patch in surface.patches:
        _draw_patch(values, origin, patch)
    for gouge in panel.gouges:
        if gouge.contrast:
            line = Scratch(gouge.start_mm, gouge.end_mm, 2 * gouge.width_mm, gouge.contrast)
            _draw_scratch(values, origin, line)
    for stencil in surface.stencils:
        _draw_stencil(values, origin, stencil)
    for stroke in surface.strokes:
        _draw_stroke(values, origin, stroke, rng)
    values *= np.float32(surface.reflectance)
    return ReflectanceMap(np.clip(values, 0.01, 1.0).astype(np.float32), origin, TEXEL_MM)


def coat(panel: Panel) -> Float32:
    """(rows, columns) how far paint and stickers stand above the skin, mm; (0, 0) where none has a thickness."""
    patches = [patch for patch in panel.surface.patches if patch.thickness_mm]
    stencils = [stencil for stencil in panel.surface.stencils if stencil.thickness_mm]
    if not (patches or stencils):
        return np.zeros((0, 0), np.float32)
    shape, origin = _map(panel)
    height = np.zeros(shape, np.float32)
    for thickness, found in [
        *((patch.thickness_mm, _covered(height, origin, patch)) for patch in patches),
        *((stencil.thickness_mm, _lettered(height, origin, stencil)) for stencil in stencils),
    ]:
        if found is not None:
            rows, columns, cover = found
            height[rows, columns] += np.float32(thickness) * cover.astype(np.float32)
    return height


def _map(panel: Panel) -> tuple[tuple[int, int], Floats]:
    """Shape and origin (mm) of a map over the panel."""
    shape = (math.ceil(panel.height_mm / TEXEL_MM) + 3, math.ceil(panel.width_mm / TEXEL_MM) + 3)
    return shape, np.array([-panel.width_mm / 2 - TEXEL_MM, -panel.height_mm / 2 - TEXEL_MM])


def _clouds(shape: tuple[int, int], size_mm: float, rng: np.random.Generator) -> Float32:
    """Smooth random field of unit variance whose features are `size_mm` large."""
    cell = max(1.0, size_mm / 2 / TEXEL_MM)
    coarse = (int(shape[0] / cell) + 8, int(shape[1] / cell) + 8)
    field = _unit(cv2.GaussianBlur(rng.standard_normal(coarse).astype(np.float32), (0, 0), 1.0))
    fine = cv2.resize(field, (int(coarse[1] * cell), int(coarse[0] * cell)), interpolation=cv2.INTER_CUBIC)
    row, column = rng.integers(0, int(2 * cell), 2)
    return np.asarray(fine[row : row + shape[0], column : column + shape[1]], np.float32)


def _streaks(
    shape: tuple[int, int], length_mm: float, grain_mm: float, angle: float, rng: np.random.Generator
) -> Float32:
    """Brushing: noise drawn out along one direction, unit variance."""
    side = math.ceil(math.hypot(*shape)) if angle else max(shape)
    noise = rng.standard_normal((side if angle else shape[0], side if angle else shape[1])).astype(np.float32)
    along, across = length_mm / TEXEL_MM / 2, grain_mm / TEXEL_MM / 2
    field: NDArray[Any] = cv2.GaussianBlur(noise, (0, 0), sigmaX=along, sigmaY=max(across, 0.3))
    # A part of coarser streaks among the fine ones, as a brush leaves them.
    field = _unit(field) + 0.6 * _unit(cv2.GaussianBlur(noise, (0, 0), sigmaX=4 * along, sigmaY=2 * across))
    if angle:
        middle = (side / 2, side / 2)
        turn = cv2.getRotationMatrix2D(middle, -math.degrees(angle), 1.0)
        field = cv2.warpAffine(field, turn, (side, side), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        top, left = (side - shape[0]) // 2, (side - shape[1]) // 2
        field = field[top : top + shape[0], left : left + shape[1]]
    return _unit(field)


def _unit(field: NDArray[Any]) -> Float32:
    """The field with mean 0 and variance 1."""
    return np.asarray((field - field.mean()) / field.std(), np.float32)


def _random_scratches(panel: Panel, rng: np.random.Generator) -> list[Scratch]:
    """Straight scratches in all directions: most of them faint and thin, dark or bright."""
    scratches = []
    for _ in range(panel.surface.random_scratches):
        x, y = rng.uniform(-0.5, 0.5, 2) * (panel.width_mm, panel.height_mm)
        length, angle = rng.uniform(8, 70), rng.uniform(0, math.pi)
        dx, dy = 0.5 * length * math.cos(angle), 0.5 * length * math.sin(angle)
        contrast = rng.choice([-1.0, 1.0]) * rng.uniform(0.08, 0.35)
        scratches.append(Scratch((x - dx, y - dy), (x + dx, y + dy), rng.uniform(0.05, 0.25), contrast))
    return scratches


def _window(values: Float32, origin: Floats, low: Floats, high: Floats) -> tuple[slice, slice, Floats, Floats] | None:
    """The part of the map between two corners (mm), with its x and y; None where it lies outside."""
    first = np.maximum(np.floor((low - origin) / TEXEL_MM).astype(int), 0)
    last = np.minimum(np.ceil((high - origin) / TEXEL_MM).astype(int) + 1, [values.shape[1], values.shape[0]])
    if (last <= first).any():
        return None
    x = origin[0] + TEXEL_MM * np.arange(first[0], last[0])[None, :]
    y = origin[1] + TEXEL_MM * np.arange(first[1], last[1])[:, None]
    return slice(first[1], last[1]), slice(first[0], last[0]), x, y


def _soft(distance: Floats) -> Floats:
    """Coverage of a texel at a signed distance (mm) outside an outline."""
    return np.clip(0.5 - distance / TEXEL_MM, 0.0, 1.0)


def _draw_scratch(values: Float32, origin: Floats, scratch: Scratch) -> None:
    a, b = np.array(scratch.start_mm), np.array(scratch.end_mm)
    window = _window(
        values, origin, np.minimum(a, b) - scratch.width_mm - 0.2, np.maximum(a, b) + scratch.width_mm + 0.2
    )
    if window is None:
        return
    rows, columns, x, y = window
    along = b - a
    share = np.clip(((x - a[0]) * along[0] + (y - a[1]) * along[1]) / (along @ along), 0.0, 1.0)
    distance = np.hypot(x - a[0] - share * along[0], y - a[1] - share * along[1]) - scratch.width_mm / 2
    # A line thinner than a texel covers its share of it.
    cover = _soft(distance) * min(1.0, scratch.width_mm / TEXEL_MM)
    values[rows, columns] *= (1.0 + scratch.contrast * cover).astype(np.float32)


def _draw_patch(values: Float32, origin: Floats, patch: Patch) -> None:
    found = _covered(values, origin, patch)
    if found is not None:
        rows, columns, cover = found
        values[rows, columns] *= (1.0 + patch.contrast * cover).astype(np.float32)


def _covered(values: Float32, origin: Floats, patch: Patch) -> tuple[slice, slice, Floats] | None:
    """The part of the map that a patch may cover, and its share of each texel there."""
    centre, size = np.array([patch.x_mm, patch.y_mm]), np.array(patch.size_mm)
    reach = np.full(2, np.hypot(*size) * (1.5 if patch.shape == "smudge" else 0.5) + 0.2)
    window = _window(values, origin, centre - reach, centre + reach)
    if window is None:
        return None
    rows, columns, x, y = window
    c, s = math.cos(math.radians(patch.angle_deg)), math.sin(math.radians(patch.angle_deg))
    u, v = c * (x - centre[0]) + s * (y - centre[1]), -s * (x - centre[0]) + c * (y - centre[1])
    rho = np.hypot(u / size[0], v / size[1]) * 2
    if patch.shape == "rectangle":
        cover = _soft(np.maximum(np.abs(u) - size[0] / 2, np.abs(v) - size[1] / 2))
    elif patch.shape == "disc":
        cover = _soft((rho - 1) * min(size) / 2)
    elif patch.shape == "ring":
        outside = (rho - 1) * min(size) / 2
        cover = _soft(np.maximum(outside, -patch.line_mm - outside))
    else:
        cover = np.exp(-2 * ((u / size[0]) ** 2 + (v / size[1]) ** 2) * 4)
    return rows, columns, cover


def _lettered(values: Float32, origin: Floats, stencil: Stencil) -> tuple[slice, slice, Floats] | None:
    """The part of the map that a stencil may cover, and its share of each texel there."""
    centre, reach = np.array([stencil.x_mm, stencil.y_mm]), letters_reach(stencil)
    window = _window(values, origin, centre - reach, centre + reach)
    if window is None:
        return None
    rows, columns, x, y = window
    return rows, columns, letter_coverage(stencil, x, y)


def _draw_stencil(values: Float32, origin: Floats, stencil: Stencil) -> None:
    found = _lettered(values, origin, stencil)
    if found is not None:
        rows, columns, cover = found
        values[rows, columns] *= (1.0 + stencil.contrast * cover).astype(np.float32)


def _draw_stroke(values: Float32, origin: Floats, stroke: Stroke, rng: np.random.Generator) -> None:
    """A line whose colour a rough skin takes in patches."""
    points = np.array(stroke.points_mm, float)
    margin = stroke.width_mm + 0.2
    window = _window(values, origin, points.min(axis=0) - margin, points.max(axis=0) + margin)
    if window is None:
        return
    rows, columns, x, y = window
    distance = np.full(np.broadcast_shapes(x.shape, y.shape), np.inf)
    for a, b in pairwise(points):
        along = b - a
        share = np.clip(((x - a[0]) * along[0] + (y - a[1]) * along[1]) / max(along @ along, 1e-12), 0.0, 1.0)
        distance = np.minimum(distance, np.hypot(x - a[0] - share * along[0], y - a[1] - share * along[1]))
    cover = np.clip(0.5 - (distance - stroke.width_mm / 2) / (2 * TEXEL_MM), 0.0, 1.0)
    if stroke.patchy:
        noise = _unit(cv2.GaussianBlur(rng.standard_normal(cover.shape).astype(np.float32), (0, 0), 1.2))
        cover = cover * np.clip(1.0 - 2 * stroke.patchy + 0.5 * noise + stroke.patchy, 0.0, 1.0)
    values[rows, columns] *= (1.0 + stroke.contrast * cover).astype(np.float32)

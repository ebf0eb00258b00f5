"""The stitched picture of a panel, and the map of how far its skin deviates from a smooth one, in the panel's frame.

Every place of the panel is looked up in the images of the scans that saw it. Where several did, the one whose middle is
nearest counts most, so that no edge is seen between them. The picture is to be looked at: nothing is measured in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.assembly.assemble import Assembly
from metrology.assembly.scan import PanelScan
from metrology.assembly.smooth_skin import SmoothSkin
from metrology.panel import Placement

Texture = NDArray[np.uint8]

FINER = 2
"""Pixels of the picture for one of the map, along each side."""
_STEPS_MM = (0.25, 0.5, 1.0, 2.0, 4.0)
_MOST_PIXELS = 4e6  # of the picture: a few hundred kilobytes, and sharp on a screen
_FEW = 6  # samples of the thinned cloud from one point of the smooth skin's fit to the next
_NEAREST = 8  # power of the distance to a scan's middle by which its weight falls
_FAR_MM = 3.0  # what lies farther from the smooth skin is not the skin
_CLOSED_MM = 12.0  # gaps, edges and heads in the measured skin belong to the picture
_BRIGHT = 120.0  # median grey of each scan's share


@dataclass(frozen=True)
class Stitched:
    """A part of a panel as it looks from outside, x to the right and y upwards."""

    part: int
    grey: Texture
    """(h, w) uint8."""
    seen: NDArray[np.bool_]
    """(h, w): where any scan measured the skin."""
    deviation: NDArray[np.float32]
    """(h / FINER, w / FINER) float32: above the smooth skin, along its normal, mm; NaN where there is no point."""
    left_mm: float
    top_mm: float
    """left_mm, top_mm: x of the picture's left edge and y of its upper edge, panel's frame."""
    mm_per_px: float
    """Of the picture."""

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height."""
        height, width = self.grey.shape
        return width * self.mm_per_px, height * self.mm_per_px

    def shows(self, x: float, y: float) -> bool:
        """Whether the skin was seen at a place of the panel's frame."""
        column, row = int((x - self.left_mm) // self.mm_per_px), int((self.top_mm - y) // self.mm_per_px)
        height, width = self.seen.shape
        return 0 <= column < width and 0 <= row < height and bool(self.seen[row, column])


def stitched(assembly: Assembly, textures: Mapping[int, Texture]) -> list[Stitched]:
    """The picture of each part.

    Parameters
    ----------
    textures : mapping of int to (h, w) uint8
        What the left cameras saw, by the number of the scan.
    """
    found = []
    for number, part in enumerate(assembly.parts, 1):
        views = [
            _View(assembly.scans[k], placement, textures[k])
            for k, placement in zip(part.numbers, part.fit.placements, strict=True)
            if np.isfinite(assembly.scans[k].skin.points[::_FEW, ::_FEW]).any()
        ]
        if views:
            found.append(_of_part(number, views))
    return found


@dataclass(frozen=True)
class _View:
    scan: PanelScan
    placement: Placement
    texture: Texture

    def points(self) -> Array:
        """(n, 3) a few points of its skin, panel's frame."""
        points = self.scan.skin.points[::_FEW, ::_FEW].reshape(-1, 3)
        return self.placement.to_panel(points[np.isfinite(points[:, 2])])


@dataclass(frozen=True)
class _Grid:
    """Cells of the map: middles of columns, from the left, and of rows, from the top; heights of the smooth skin.

    `normals` (h, w, 3) are those of the smooth skin, outwards.
    """

    x: Array
    y: Array
    heights: Array
    normals: Array
    step: float


def _of_part(number: int, views: Sequence[_View]) -> Stitched:
    clouds = [view.points() for view in views]
    points = np.concatenate(clouds)
    grid = _grid(points)
    shape = grid.heights.shape
    fine = shape[0] * FINER, shape[1] * FINER
    grey, weight, deviation, measured = (np.zeros(s, np.float32) for s in (fine, fine, shape, shape))
    for view, cloud in zip(views, clouds, strict=True):
        rows, columns = _around(grid, cloud)
        looked_up = _looked_up(view, grid, rows, columns, np.median(cloud, axis=0))
        large = slice(rows.start * FINER, rows.stop * FINER), slice(columns.start * FINER, columns.stop * FINER)
        for total, more in ((grey[large], looked_up[0]), (weight[large], looked_up[1])):
            total += more
        for total, more in ((deviation[rows, columns], looked_up[2]), (measured[rows, columns], looked_up[3])):
            total += more
    with np.errstate(invalid="ignore", divide="ignore"):
        return Stitched(
            number, np.nan_to_num(grey / weight).clip(0, 255).astype(np.uint8), weight > 0, deviation / measured,
            float(grid.x[0] - grid.step / 2), float(grid.y[0] + grid.step / 2), grid.step / FINER,
        )  # fmt: skip


def _grid(points: Array) -> _Grid:
    low, high = points[:, :2].min(0), points[:, :2].max(0)
    area = float(np.prod(high - low))
    step = FINER * next((s for s in _STEPS_MM if area / s**2 < _MOST_PIXELS), _STEPS_MM[-1])
    x = np.arange(low[0], high[0] + step, step)
    y = np.arange(high[1], low[1] - step, -step)
    heights = SmoothSkin.fitted(points).on_grid(x, y)
    down, right = np.gradient(heights, step) if min(heights.shape) > 1 else (np.zeros_like(heights),) * 2
    normals = np.stack([-right, down, np.ones_like(heights)], axis=-1)
    return _Grid(x, y, heights, normals / np.linalg.norm(normals, axis=2, keepdims=True), step)


def _around(grid: _Grid, cloud: Array) -> tuple[slice, slice]:
    """Rows and columns of the grid that hold a scan's points."""
    columns = np.searchsorted(grid.x, [cloud[:, 0].min() - grid.step, cloud[:, 0].max() + grid.step])
    rows = np.searchsorted(-grid.y, [-cloud[:, 1].max() - grid.step, -cloud[:, 1].min() + grid.step])
    return slice(*map(int, rows)), slice(*map(int, columns))


def _looked_up(view: _View, grid: _Grid, rows: slice, columns: slice, middle: Array) -> tuple[NDArray[np.float32], ...]:
    """Weighted grey, weights, weighted deviation and its weights: what a scan adds to a stretch of the grid."""
    x, y = np.meshgrid(grid.x[columns], grid.y[rows])
    places = np.stack([x, y, grid.heights[rows, columns]], axis=-1)
    in_rig = view.placement.to_rig(places)
    pixels = view.scan.rig.left.project(in_rig)
    inside = (in_rig[..., 2] > 0) & view.scan.rig.left.inside(pixels)
    depth = view.scan.skin.under(pixels.reshape(-1, 2)).reshape(x.shape)
    # A point farther along the ray by a share lies that share of the camera's distance below the surface.
    toward = ((places - view.placement.t) * grid.normals[rows, columns]).sum(-1)
    above = (depth / in_rig[..., 2] - 1) * toward
    above[~inside | ~(np.abs(above) < _FAR_MM)] = np.nan
    share = (np.hypot(x - middle[0], y - middle[1]) / 100 + 1) ** -_NEAREST
    known = np.isfinite(above)
    grey, weight = _texture(view, pixels, _closed(known, grid.step) & inside, share, grid.step / FINER)
    measured = np.where(known, share, 0.0)
    return grey * weight, weight, np.nan_to_num(above * measured).astype(np.float32), measured.astype(np.float32)


def _closed(known: NDArray[np.bool_], step: float) -> NDArray[np.bool_]:
    """With the gaps in it."""
    width = 2 * round(_CLOSED_MM / 2 / step) + 1
    around = np.pad(known.astype(np.uint8), width)
    closed = cv2.morphologyEx(around, cv2.MORPH_CLOSE, np.ones((width, width), np.uint8))
    return np.asarray(closed[width:-width, width:-width] > 0)


def _texture(
    view: _View, pixels: Array, wanted: NDArray[np.bool_], share: Array, step: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Grey of the picture's finer pixels, and their weights."""
    size = pixels.shape[1] * FINER, pixels.shape[0] * FINER
    u, v, weight = (
        cv2.resize(np.ascontiguousarray(values, np.float32), size, interpolation=cv2.INTER_LINEAR)
        for values in (pixels[..., 0], pixels[..., 1], share)
    )
    per_step = float(np.median(np.abs(np.diff(u, axis=1)))) if size[0] > 1 else 1.0
    blurred = cv2.blur(view.texture, [max(1, round(per_step))] * 2)  # no grain from skipping pixels
    grey = cv2.remap(blurred, u, v, cv2.INTER_LINEAR).astype(np.float32)
    shown = cv2.resize(wanted.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    lit = grey[shown]
    gain = _BRIGHT / max(1.0, float(np.median(lit))) if lit.size else 1.0
    return np.asarray(grey * np.float32(gain)), np.where(shown, weight, np.float32(0))

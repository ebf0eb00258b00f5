"""The measured skin as the projector sees it: where it is, how large a millimetre is, and which way is up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.errors import UsageError
from metrology.rig import Device, Rig

_CELL_PX = 8.0
_FIT_ROUNDS = 10
_OFF_PANEL_MM = 10.0
_STRIDE = 8  # left pixels between samples of the cloud


class MeasuredSkin(Protocol):
    """What an overlay needs of a scan: the rig, and (h, w, 3) points in its frame, mm; NaN where none."""

    @property
    def rig(self) -> Rig:
        """The rig that took it."""

    @property
    def points(self) -> NDArray[np.float32]:
        """Entry [v, u]: the point that the left camera's pixel (u, v) sees."""


@dataclass(frozen=True)
class SkinMap:
    """The skin in projector pixels."""

    px_per_mm: float
    """Projector pixels per millimetre along the skin, downwards in the left image; the most over the field, so that
    what is drawn by it is nowhere smaller than asked for."""
    angle: float
    """Direction of the left image's +u in the projector image, radians: the operator's horizontal."""
    cell_px: float
    """Size of the table's cells, projector pixels."""
    table: NDArray[np.int64]
    """(rows + 1, columns + 1) of int: number of cells with skin above and to the left of each corner (a summed-area
    table)."""

    def share(self, low: Array, high: Array) -> Array:
        """(n,) shares of boxes that lie on the skin; corners (n, 2) in projector pixels."""
        first, last = np.floor(low / self.cell_px), np.ceil(high / self.cell_px)
        cells = np.maximum(last - first, 1).prod(1)
        bounds = np.array(self.table.shape)[::-1] - 1
        (x0, y0), (x1, y1) = (np.clip(corner, 0, bounds).astype(int).T for corner in (first, last))
        inside = self.table[y1, x1] - self.table[y0, x1] - self.table[y1, x0] + self.table[y0, x0]
        return np.asarray(inside / cells)


def map_skin(reconstruction: MeasuredSkin) -> SkinMap:
    """The measured skin in the projector's image."""
    grid = reconstruction.points[::_STRIDE, ::_STRIDE].astype(float)
    valid = np.isfinite(grid[..., 2])
    if not valid.any():
        raise UsageError("overlay: found no measured point in the scene, expected a reconstructed skin")
    valid[valid] = _on_panel(grid[valid])
    grid[~valid] = np.nan
    projector = screen(reconstruction.rig)
    pixels = np.full((*valid.shape, 2), np.nan)
    pixels[valid] = projector.project(grid[valid])
    scale = _scale(grid, pixels, projector)
    # Cells no finer than the samples of a coarse camera.
    cell = max(_CELL_PX, 1.2 * _STRIDE * scale * float(np.median(grid[valid][:, 2])) / reconstruction.rig.left.K[1, 1])
    return SkinMap(scale, _angle(pixels), cell, _coverage(pixels[valid], projector, cell))


def screen(rig: Rig) -> Device:
    """The device that an overlay is drawn for: the projector, or the left camera where none is calibrated."""
    return rig.screen or rig.left


def _on_panel(points: Array) -> NDArray[np.bool_]:
    """(n,) which points belong to the panel and not to what stands behind it.

    A panel is a smooth surface and most of what is measured: a quadric z(x, y), fitted with Cauchy weights.
    """
    x, y = ((points[:, k] - points[:, k].mean()) / max(float(np.ptp(points[:, k])), 1.0) for k in (0, 1))
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    away = points[:, 2] - np.median(points[:, 2])
    for _ in range(_FIT_ROUNDS):
        weight = 1 / (1 + (away / _OFF_PANEL_MM) ** 2)
        normal = design.T @ (design * weight[:, None]) + 1e-9 * np.eye(6)
        away = points[:, 2] - design @ np.linalg.solve(normal, design.T @ (weight * points[:, 2]))
    return np.asarray(np.abs(away) <= _OFF_PANEL_MM)


def _scale(grid: Array, pixels: Array, projector: Device) -> float:
    length = np.linalg.norm(np.diff(grid, axis=0), axis=2)
    scale = np.linalg.norm(np.diff(pixels, axis=0), axis=2) / length
    scale = scale[np.isfinite(scale)]
    if len(scale) == 0:  # single points
        return float(projector.K[1, 1] / np.nanmedian(grid[..., 2]))
    # A few neighbours stand on either side of an edge; the distance between them is none along the skin.
    return float(np.quantile(scale, 0.98))


def _angle(pixels: Array) -> float:
    along = np.diff(pixels, axis=1).reshape(-1, 2)
    along = along[np.isfinite(along[:, 0])]
    if len(along) == 0:
        return 0.0
    x, y = np.median(along, axis=0)
    return float(np.arctan2(y, x))


def _coverage(pixels: Array, projector: Device, cell: float) -> NDArray[np.int64]:
    columns, rows = int(np.ceil(projector.width / cell)), int(np.ceil(projector.height / cell))
    cells = np.zeros((rows, columns), np.uint8)
    x, y = np.floor(pixels[projector.inside(pixels)] / cell).clip(0).astype(int).T
    cells[y, x] = 1
    closed = cv2.morphologyEx(cells, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    table = np.zeros((rows + 1, columns + 1), np.int64)
    table[1:, 1:] = closed.cumsum(0).cumsum(1)
    return table

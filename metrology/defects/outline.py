"""Outlines of a defect at a share of its depth: length, width at 90° to it, area, and where they are cut off."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.defects.patch import Patch
from metrology.jit import kernel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_HARMONICS = 4  # of a closed outline in the frame in which its moments are a circle's
_POINTS = 180
_STAR = 0.15  # scatter of an outline about its harmonics, of its radius: beyond it the outline is no simple one
_FEWEST = 12
_LINE = 8.0  # times as long as wide
_INNER = 0.45  # of its length to either side of its middle, where its ends do not tell its width


@dataclass(frozen=True)
class Outline:
    """A closed curve in the tangent plane."""

    x: Array
    y: Array
    """x, y: (n,): mm in the patch's frame."""
    cells: Mask
    """(rows, columns): grid cells of the patch within it."""
    length: float
    width: float
    """length, width: its greatest extent, and that at 90° to it, mm."""
    angle: float
    """Direction of the length in the frame, radians."""
    area: float
    """mm²."""
    cut_by_view: float
    cut_by_seam: float
    """cut_by_view, cut_by_seam: shares of its border at which the view, or the plate at a seam, ends."""


def outline_at(patch: Patch, depth: Array, level: float, inside: tuple[int, int]) -> Outline | None:
    """The outline of what is deeper than a level round a grid cell; None where hardly a cell is.

    Parameters
    ----------
    depth : (rows, columns) ndarray
        Smoothed, mm.
    level : float
        mm.
    inside : (row, column)
    """
    deep = (depth > level) & patch.plate
    _, labels = cv2.connectedComponents(deep.astype(np.uint8), connectivity=4)
    if labels[inside] == 0:
        return None
    cells = labels == labels[inside]
    x, y, cut_by_view, cut_by_seam = _crossings(patch, depth, level, cells)
    if len(x) < _FEWEST:
        return None
    around, simple = _closed(patch, cells, x, y)
    cx, cy = around if simple else (x, y)
    length, width, angle = _extents(cx, cy)
    if length > _LINE * width:
        length, width, angle = _of_line(x, y, angle)
    area = _polygon_area(*around) if simple else float(cells.sum()) * patch.cell_mm2
    return Outline(*around, cells, length, width, angle, area, cut_by_view, cut_by_seam)


def _crossings(patch: Patch, depth: Array, level: float, cells: Mask) -> tuple[Array, Array, float, float]:
    """Where a level is crossed between neighbouring grid cells; shares of the border that lie elsewhere."""
    places = np.empty((2, 4 * int(cells.sum())))
    on_plate, by_view, by_seam = crossings(
        depth, level, cells, patch.plate, patch.view, patch.x, patch.y, places[0], places[1]
    )
    total = max(on_plate + by_view + by_seam, 1)
    return places[0, :on_plate], places[1, :on_plate], by_view / total, by_seam / total


@kernel
def crossings(depth, level, cells, plate, view, x, y, at_x, at_y):  # type: ignore[no-untyped-def]
    """Where a level is crossed between a grid cell of a region and one outside of it.

    Parameters
    ----------
    depth, x, y : (rows, columns) float64
    level : float
    cells, plate, view : (rows, columns) bool
        The region's; the plate's; where the view ends.
    at_x, at_y : (4 n,) float64, output
        For n cells.

    Returns
    -------
    on_plate, by_view, by_seam : int
        Numbers of borders at which the level is crossed, the view ends (the border of the image is that of the
        window), and the plate ends at a seam.
    """
    on_plate, by_view, by_seam = 0, 0, 0
    rows, columns = cells.shape
    for i in range(rows):
        for j in range(columns):
            if not cells[i, j]:
                continue
            for k in range(4):
                m, n = i + (k == 0) - (k == 1), j + (k == 2) - (k == 3)
                if m < 0 or n < 0 or m >= rows or n >= columns:
                    by_view += 1
                elif cells[m, n]:
                    continue
                elif not plate[m, n]:
                    if view[m, n]:
                        by_view += 1
                    else:
                        by_seam += 1
                elif depth[m, n] <= level:
                    share = (depth[i, j] - level) / max(depth[i, j] - depth[m, n], 1e-12)
                    at_x[on_plate] = x[i, j] + share * (x[m, n] - x[i, j])
                    at_y[on_plate] = y[i, j] + share * (y[m, n] - y[i, j])
                    on_plate += 1
    return on_plate, by_view, by_seam


def _closed(patch: Patch, cells: Mask, x: Array, y: Array) -> tuple[tuple[Array, Array], bool]:
    """A smooth closed curve through crossings, and whether it follows them.

    Harmonics of the radius against the direction, in the frame in which the cells' second moments are a circle's.
    """
    own = np.stack([patch.x[cells], patch.y[cells]], axis=1)
    centre = own.mean(axis=0)
    own -= centre
    spread, axes = np.linalg.eigh(own.T @ own / max(len(own) - 1, 1) + 1e-6 * np.eye(2))
    scale = 2 * np.sqrt(spread)
    white = ((np.stack([x, y], axis=1) - centre) @ axes) / scale
    radius, turn = np.hypot(*white.T), np.arctan2(white[:, 1], white[:, 0])
    fit = np.linalg.lstsq(
        np.vstack([_harmonics(turn), 1e-2 * np.sqrt(len(turn)) * np.eye(2 * _HARMONICS + 1)[1:]]),
        np.concatenate([radius, np.zeros(2 * _HARMONICS)]), rcond=None,
    )[0]  # fmt: skip
    scatter = float(np.sqrt(np.mean((radius - _harmonics(turn) @ fit) ** 2)))
    around = np.linspace(-np.pi, np.pi, _POINTS, endpoint=False)
    r = _harmonics(around) @ fit
    curve = (r[:, None] * np.stack([np.cos(around), np.sin(around)], axis=1) * scale) @ axes.T + centre
    return (curve[:, 0], curve[:, 1]), scatter < _STAR


def _harmonics(turn: Array) -> Array:
    orders = np.arange(1, _HARMONICS + 1)
    return np.column_stack([np.ones_like(turn), np.cos(turn[:, None] * orders), np.sin(turn[:, None] * orders)])


def _extents(x: Array, y: Array) -> tuple[float, float, float]:
    """Greatest extent of a curve, that at 90° to it, and the direction of the first."""
    turn = np.linspace(0, np.pi, _POINTS, endpoint=False)
    along = np.outer(np.cos(turn), x) + np.outer(np.sin(turn), y)
    extent = np.ptp(along, axis=1)
    k = int(extent.argmax())
    return float(extent[k]), float(extent[(k + _POINTS // 2) % _POINTS]), float(turn[k])


def _of_line(x: Array, y: Array, angle: float) -> tuple[float, float, float]:
    """Extents along and across a narrow outline by its crossings (harmonics overshoot at its ends), and its direction.

    A degree of its direction would be more than its width.
    """
    design = np.stack([np.cos(angle) * x + np.sin(angle) * y, np.ones_like(x)], axis=1)
    off = np.cos(angle) * y - np.sin(angle) * x
    slope = np.linalg.lstsq(design, off)[0][0]
    angle += float(np.arctan(slope))
    along, across = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    sides = across[np.abs(along - 0.5 * (along.min() + along.max())) < _INNER * np.ptp(along)]
    width = 2 * float(np.median(np.abs(sides - sides.mean())))
    return float(np.ptp(along)), width, angle


def _polygon_area(x: Array, y: Array) -> float:
    return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))

"""Outlines of a defect at a share of its depth: length, width at 90° to it, area, and where they are cut off."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from metrology.arrays import Array, Mask
from metrology.defects.patch import Patch
from metrology.jit import kernel

_HARMONICS = 40  # of a closed outline in the frame in which its moments are a circle's: of a fold's corner is 1 % left
_CORNER, _LOW = 1.0, 0.1  # how large they usually are over the radius: over the square of their order, and at most
_HIDDEN = 0.2  # of the radius may a crossing be off that no points show, where all are such
_LEAST_NOISE = 0.01  # of a crossing over the radius: the grid's own
_DEEPER = 1.2  # times the level, up to where the slope at an outline is taken
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
    """length, width: its extent where it is longest, and that at 90° to it, mm."""
    length_sd: float
    width_sd: float
    """length_sd, width_sd: standard deviations of these by noise where the level is crossed, mm."""
    by_level: float
    """Share by which its extents shrink where the level rises by that share: large where the flanks are flat."""
    angle: float
    """Direction of the length in the frame, radians."""
    area: float
    """mm²."""
    cut_by_view: float
    cut_by_seam: float
    """cut_by_view, cut_by_seam: shares of its border at which the view, or the plate at a seam, ends."""


def outline_at(patch: Patch, depth: Array, level: float, inside: tuple[int, int], noise: float = 0.0) -> Outline | None:
    """The outline of what is deeper than a level round a grid cell; None where hardly a cell is.

    At the ridge to another defect it is closed as the rest of it tells.

    Parameters
    ----------
    depth : (rows, columns) ndarray
        Smoothed, mm.
    level : float
        mm.
    inside : (row, column)
    noise : float
        Standard deviation of the depth at a crossing, as if crossings were independent, mm.
    """
    deep = (depth > level) & patch.plate & ~patch.others
    _, labels = cv2.connectedComponents(deep.astype(np.uint8), connectivity=4)
    if labels[inside] == 0:
        return None
    cells = labels == labels[inside]
    x, y, seen, cut_by_view, cut_by_seam = _crossings(patch, depth, level, cells)
    if len(x) < _FEWEST:
        return None
    hidden = np.inf if seen.sum() >= _FEWEST else _HIDDEN
    by_level = float((1 - np.sqrt((depth[cells] > _DEEPER * level).mean())) / (_DEEPER - 1))
    curve = _closed(patch, cells, x, y, np.where(seen, noise * by_level / level, hidden))
    cx, cy = (curve.x, curve.y) if curve.simple else (x, y)
    length, width, angle = _extents(cx, cy)
    length_sd, width_sd = (curve.extent_sd(turn) for turn in (angle, angle + 0.5 * np.pi))
    if length > _LINE * width:
        length, width, angle = _of_line(x, y, angle)
    area = _polygon_area(cx, cy) if curve.simple else float(cells.sum()) * patch.cell_mm2
    sds, cut = (length_sd, width_sd), (cut_by_view, cut_by_seam)
    return Outline(curve.x, curve.y, cells, length, width, *sds, by_level, angle, area, *cut)


def _crossings(patch: Patch, depth: Array, level: float, cells: Mask) -> tuple[Array, Array, Mask, float, float]:
    """Where a level is crossed between neighbouring grid cells, and whether skin was seen there; shares of the border
    that lie elsewhere."""
    places = np.empty((3, 4 * int(cells.sum())))
    on_plate, by_view, by_seam = crossings(
        depth, level, cells, patch.plate, patch.view, patch.skin, patch.x, patch.y, places[0], places[1], places[2]
    )
    total = max(on_plate + by_view + by_seam, 1)
    x, y, seen = places[:, :on_plate]
    return x, y, seen > 0, by_view / total, by_seam / total


@kernel
def crossings(depth, level, cells, plate, view, skin, x, y, at_x, at_y, seen):  # type: ignore[no-untyped-def]
    """Where a level is crossed between a grid cell of a region and one outside of it.

    Parameters
    ----------
    depth, x, y : (rows, columns) float64
    level : float
    cells, plate, view, skin : (rows, columns) bool
        The region's; the plate's; where the view ends; where sound skin is.
    at_x, at_y, seen : (4 n,) float64, output
        For n cells; 1 where there is sound skin on both sides, else 0.

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
                    seen[on_plate] = skin[i, j] and skin[m, n]
                    on_plate += 1
    return on_plate, by_view, by_seam


@dataclass(frozen=True)
class _Curve:
    """A smooth closed curve through crossings."""

    x: Array
    y: Array
    """x, y: (n,): mm."""
    moved: Array
    """(2, n, k): by how much a place moves with each of its harmonics, mm."""
    covariance: Array
    """(k, k): of the harmonics, by noise."""
    simple: bool
    """Whether it follows the crossings."""

    def extent_sd(self, turn: float) -> float:
        """Standard deviation of its extent in a direction, mm."""
        way = np.array([np.cos(turn), np.sin(turn)])
        along = way[0] * self.x + way[1] * self.y
        change = way @ (self.moved[:, along.argmax()] - self.moved[:, along.argmin()])
        return float(np.sqrt(change @ self.covariance @ change))


def _closed(patch: Patch, cells: Mask, x: Array, y: Array, noise: Array) -> _Curve:
    """A smooth closed curve through crossings.

    Harmonics of the radius against the direction, in the frame in which the cells' second moments are a circle's. What
    they usually are beforehand, and the noise (standard deviation of each crossing, over the radius; infinite where no
    skin was seen) tell how closely the crossings are followed: a corner is one where noise leaves it, and noise makes
    no corner.
    """
    own = np.stack([patch.x[cells], patch.y[cells]], axis=1)
    centre = own.mean(axis=0)
    own -= centre
    spread, axes = np.linalg.eigh(own.T @ own / max(len(own) - 1, 1) + 1e-6 * np.eye(2))
    scale = 2 * np.sqrt(spread)
    white = ((np.stack([x, y], axis=1) - centre) @ axes) / scale
    radius, turn = np.hypot(*white.T), np.arctan2(white[:, 1], white[:, 0])
    orders = np.arange(1, _HARMONICS + 1)
    usual = np.tile(np.minimum(_CORNER / orders**2, _LOW), 2)
    design, variance = _harmonics(turn), np.maximum(noise, _LEAST_NOISE) ** 2
    weighted = (design / variance[:, None]).T
    covariance = np.linalg.inv(weighted @ design + np.diag([1e-6, *usual**-2.0]))
    fit = covariance @ (weighted @ radius)
    scatter = float(np.sqrt(np.mean((radius - design @ fit)[np.isfinite(noise)] ** 2)))
    around = np.linspace(-np.pi, np.pi, _POINTS, endpoint=False)
    design = _harmonics(around)
    ways = axes @ (scale[:, None] * np.stack([np.cos(around), np.sin(around)]))
    px, py = ways * (design @ fit) + centre[:, None]
    return _Curve(px, py, ways[:, :, None] * design, np.asarray(covariance), scatter < _STAR)


def _harmonics(turn: Array) -> Array:
    orders = np.arange(1, _HARMONICS + 1)
    return np.column_stack([np.ones_like(turn), np.cos(turn[:, None] * orders), np.sin(turn[:, None] * orders)])


def _extents(x: Array, y: Array) -> tuple[float, float, float]:
    """Extents of a curve along its length and at 90° to it, and the length's direction.

    That is the direction in which it is longest on the whole: the greatest of all extents is one that noise has chosen.
    """
    turns = np.linspace(0, np.pi, _POINTS, endpoint=False)
    extent = np.ptp(np.outer(np.cos(turns), x) + np.outer(np.sin(turns), y), axis=1)
    turn = 0.5 * float(np.angle(extent @ np.exp(2j * turns))) % np.pi
    c, s = np.cos(turn), np.sin(turn)
    length, width = float(np.ptp(c * x + s * y)), float(np.ptp(c * y - s * x))
    return (length, width, turn) if length >= width else (width, length, (turn + 0.5 * np.pi) % np.pi)


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

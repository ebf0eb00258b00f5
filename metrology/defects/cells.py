"""The cloud on cells of 4 × 4 pixels: quick to fit, finer than any dent, and clear of what is no skin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Mask
from metrology.cloud import PixelFlag
from metrology.jit import kernel
from metrology.results import RivetDetection, SeamLine
from metrology.rivets.ellipse import Ellipse
from metrology.sighted import Sighted

SIZE = 4
"""Pixels along a cell's side."""
STEEPEST = 2.5
"""Slope that no skin and no dent of it has, as the rig sees the skin inclined."""
BAD = np.uint16(PixelFlag.EDGE | PixelFlag.SLOPE)
"""Flags of pixels that are left out."""
_GUARD_PX = 6  # round heads, holes and seams: mixed phase, and the matching's support
_SHARE = 0.5  # of a cell's pixels that must be sound
_GAP = 3  # cells that the drop may leave without points
_NEIGHBOURS, _ALONE = 5, 0.3  # cells round one, and their share that must be sound: others were matched by chance
_BORDER = 2  # cells
_BEYOND_PX = 120  # a seam's line may end before the seam does
_GONE_PX = 8  # without points on a line is where the skin ends
_LEAST_PLATE = 0.03  # of all cells with skin: smaller pieces bear no reference
_LEAST_CELLS = 400


@dataclass(frozen=True)
class CellMap:
    """Means over cells."""

    points: Array
    """(rows, columns, 3): rig frame, mm; NaN without enough sound points."""
    sigma: Array
    """(rows, columns): standard deviation of z if pixels were independent, mm."""
    plate: NDArray[np.int32]
    """(rows, columns) int32: which piece of skin between seams a cell lies on, 1 …; 0 on none."""
    seam: Mask
    """(rows, columns): cells of seams."""
    covered: Mask
    """(rows, columns): cells of fasteners and holes."""
    free: Mask
    """(rows, columns): sound cells of a plate that are no fastener, hole or seam."""

    @property
    def plates(self) -> range:
        """Numbers of the plates."""
        return range(1, int(self.plate.max(initial=0)) + 1)

    def chosen(self, use: NDArray[np.intp]) -> tuple[Array, Array]:
        """(n, 3) points and (n,) their sigma of cells by their flat indices (n,)."""
        return self.points.reshape(-1, 3)[use], self.sigma.ravel()[use]


def cell_map(sighted: Sighted) -> CellMap:
    """The cells of a scan."""
    reconstruction = sighted.reconstruction
    height, width = reconstruction.points.shape[:2]
    rows, columns = height // SIZE, width // SIZE
    points, sigma = np.empty((rows, columns, 3)), np.empty((rows, columns))
    means(reconstruction.points, reconstruction.sigma_z, reconstruction.flags, BAD, SIZE, _SHARE, points, sigma)
    alone = cv2.blur(np.isfinite(sigma).astype(np.float32), (_NEIGHBOURS, _NEIGHBOURS)) < _ALONE
    points[alone], sigma[alone] = np.nan, np.nan
    seam = _coarse(_seam_mask(sighted.lines, reconstruction.valid), rows, columns)
    covered = _coarse(_covered(sighted, (height, width)), rows, columns)
    near = cv2.dilate((np.isfinite(sigma) | covered).astype(np.uint8), np.ones((_NEIGHBOURS, _NEIGHBOURS))) > 0
    plate = _plates(_coarse(reconstruction.valid, rows, columns) & near & ~seam & ~_steep(points))
    # Half a matching window is missing at the border of the image.
    inside = np.zeros(plate.shape, bool)
    inside[_BORDER:-_BORDER, _BORDER:-_BORDER] = True
    return CellMap(points, sigma, plate, seam, covered, np.isfinite(sigma) & (plate > 0) & ~covered & inside)


@kernel
def means(points, sigma_z, flags, bad, size, share, mean, sigma):  # type: ignore[no-untyped-def]
    """Means of the sound points of each cell, and their standard deviation; NaN where too few are sound.

    Parameters
    ----------
    points : (h, w, 3) float32
    sigma_z : (h, w) float32
    flags : (h, w) uint16
    bad : uint16
        Flags of unsound points.
    size : int
    share : float
        Of a cell's pixels that must be sound.
    mean : (h/size, w/size, 3) float64, output
    sigma : (h/size, w/size) float64, output
    """
    for i in range(mean.shape[0]):
        for j in range(mean.shape[1]):
            n, x, y, z, s = 0, 0.0, 0.0, 0.0, 0.0
            for v in range(i * size, (i + 1) * size):
                for u in range(j * size, (j + 1) * size):
                    if flags[v, u] & bad or not np.isfinite(points[v, u, 2]):
                        continue
                    n += 1
                    x += points[v, u, 0]
                    y += points[v, u, 1]
                    z += points[v, u, 2]
                    s += sigma_z[v, u] ** 2
            if n < share * size * size:
                mean[i, j, :] = np.nan
                sigma[i, j] = np.nan
            else:
                mean[i, j, 0], mean[i, j, 1], mean[i, j, 2] = x / n, y / n, z / n
                sigma[i, j] = np.sqrt(s) / n


def _coarse(mask: NDArray[np.generic], rows: int, columns: int) -> Mask:
    """Cells of which any pixel is in a mask."""
    part = np.ascontiguousarray(mask[: rows * SIZE, : columns * SIZE]).view(np.uint8)
    share = cv2.resize(part * np.uint8(255), (columns, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(share > 0)


def _steep(points: Array) -> Mask:
    """Cells beside a drop that no skin and no dent of it makes: there the panel ends, and something behind begins."""
    steep = np.zeros(points.shape[:2], bool)
    z = points[..., 2]
    for axis in (0, 1):
        pitches = np.abs(np.diff(points[::8, ::8, 1 - axis], axis=axis))
        if not np.isfinite(pitches).any():
            continue
        pitch = float(np.nanmedian(pitches)) / 8
        for reach in range(1, _GAP + 1):
            count = z.shape[axis] - reach
            drop = np.abs(z.take(range(reach, count + reach), axis) - z.take(range(count), axis))
            off = drop > STEEPEST * reach * pitch
            if not off.any():
                continue
            for between in range(reach + 1):
                part = [slice(None), slice(None)]
                part[axis] = slice(between, between + count)
                steep[tuple(part)] |= off
    return steep


def _seam_mask(lines: Sequence[SeamLine], valid: Mask) -> NDArray[np.uint8]:
    """Pixels of seams; where the skin ends soon behind a line's end, on to there."""
    mask = np.zeros(valid.shape, np.uint8)
    for line in lines:
        if not line.relief:
            continue
        course = line.centre_px
        reach = min(len(course) - 1, 60)
        head = _beyond(course[0], course[0] - course[reach], valid)
        tail = _beyond(course[-1], course[-1] - course[-1 - reach], valid)
        width = int(np.nanmax(line.width_px)) + 2 * _GUARD_PX
        cv2.polylines(mask, [np.rint([*head, *course, *tail]).astype(np.int32)], False, 1, width)
    return mask


def _beyond(end: Array, way: Array, valid: Mask) -> list[Array]:
    """Where the skin ends on the way on from a line's end; nothing if that is far."""
    steps = end + np.arange(1, _BEYOND_PX)[:, None] * way / max(float(np.linalg.norm(way)), 1e-9)
    u, v = np.rint(steps).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < valid.shape[1]) & (v < valid.shape[0])
    on_skin = np.zeros(len(steps), bool)
    on_skin[inside] = valid[v[inside], u[inside]]
    # Single pixels without a point are no end.
    off = np.convolve(~on_skin, np.ones(_GONE_PX), "valid") >= _GONE_PX
    return [steps[int(off.argmax()) + _GONE_PX - 1]] if off.any() else []


def _covered(sighted: Sighted, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Pixels of heads and holes. A ring in the height map that may be no fastener may be the edge of a dent."""
    mask = np.zeros(shape, np.uint8)
    for ellipse in fasteners(sighted.detections):
        _fill(mask, ellipse)
    for opening in sighted.openings:
        _fill(mask, opening.ellipse)
    return mask


def fasteners(detections: Sequence[RivetDetection]) -> list[Ellipse]:
    """Outlines of the heads of a scan, those left out that only the height map shows and that are in doubt."""
    return [
        Ellipse(d.u_px, d.v_px, 0.5 * d.major_px, 0.5 * d.minor_px, float(np.radians(d.angle_deg)))
        for d in detections
        if d.doubt is None or d.found_by == "image"
    ]


def _fill(mask: NDArray[np.uint8], ellipse: Ellipse) -> None:
    size = 2 * (ellipse.a + _GUARD_PX), 2 * (ellipse.b + _GUARD_PX)
    cv2.ellipse(mask, ((ellipse.u, ellipse.v), size, float(np.degrees(ellipse.angle))), 1, -1)


def _plates(skin: Mask) -> NDArray[np.int32]:
    """Numbers of the pieces of skin that are large enough for a reference of their own."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(skin.astype(np.uint8), connectivity=4)
    areas = stats[:, cv2.CC_STAT_AREA]
    least = max(_LEAST_CELLS, _LEAST_PLATE * areas[1:].sum())
    numbers = np.zeros(count, np.int32)
    large = [k for k in range(1, count) if areas[k] >= least]
    numbers[large] = np.arange(1, len(large) + 1)
    return np.asarray(numbers[labels])

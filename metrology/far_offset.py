"""How far the right camera sees the skin's texture off the epipolar lines, when a rig was knocked far.

The fine registration of `metrology.texture_offset` looks a few pixels around where the rig expects a patch. Here none
of the rig is used to find it: both textures are laid out over projector coordinate and image row, in which a point of
the skin has the same coordinate in both views and only its row differs. A block of the left texture is looked for along
all rows of the right one; the rig comes in only where it says which row it expected.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Float32
from metrology.cloud import DecodedView, Reconstruction
from metrology.texture_offset import TextureOffsets

_BIN_PX = 2  # rows of an image per row of the layout
_BLOCK = 32  # rows and columns of a block of the layout
_HIGH_PASS = 6.0  # radius, in bins, beyond which brightness is the light's and not the skin's
_LEAST_CORRELATION = 0.4  # of a thousand bins: noise alone reaches a quarter somewhere along a thousand rows
_LEAST_LEAD = 0.1  # of the best place over any other
_LEAST_FILLED = 0.6  # of a block's bins
_EXCLUDE = 4  # bins around the best place that belong to it
_SIGMA_PX = 1.0


@dataclass(frozen=True)
class _Grid:
    """Layout of both views: rows of the images against projector coordinate."""

    lowest: float
    step: float
    """lowest, step: coordinate of the first column's border, and width of a column, projector pixels."""
    columns: int
    upright: bool
    """Whether the image's rows are the layout's; else its columns are."""

    def turned(self, image: NDArray) -> NDArray:
        """An image's values with the layout's rows first."""
        return image if self.upright else image.T

    def bins(self, coordinate: Float32) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]:
        """Which pixels of a turned view lie on the layout, and their rows and columns there."""
        column = np.floor((coordinate - self.lowest) / self.step)
        inside = (column >= 0) & (column < self.columns)
        row = np.nonzero(inside)[0] // _BIN_PX
        return inside, row, column[inside].astype(np.int64)


def measure_far_offsets(reconstruction: Reconstruction) -> TextureOffsets:
    """Offsets of blocks of texture over the whole height of the image, known to about a pixel.

    Returns
    -------
    TextureOffsets
        Only blocks with texture enough to be found in one place alone.
    """
    grid = _grid(reconstruction.left, reconstruction.with_right())
    if grid is None:
        return _none()
    left, filled = _lay_out(reconstruction.left, grid)
    right, seen = _lay_out(reconstruction.with_right(), grid)
    expected, pixels = _expected_rows(reconstruction, grid, left.shape)
    centres, across = [], []
    for top in range(0, left.shape[0] - _BLOCK + 1, _BLOCK):
        for first in range(0, left.shape[1] - _BLOCK + 1, _BLOCK):
            block = np.s_[top : top + _BLOCK, first : first + _BLOCK]
            if filled[block].mean() < _LEAST_FILLED or not np.isfinite(expected[block]).any():
                continue
            found = _place(left[block], right[:, first : first + _BLOCK])
            if found is None:
                continue
            below = round(found)
            if seen[below : below + _BLOCK, first : first + _BLOCK].mean() > _LEAST_FILLED:
                across.append(_BIN_PX * (found - top) - float(np.nanmedian(expected[block])))
                centres.append(np.nanmedian(pixels[block].reshape(-1, 2), axis=0))
    if not across:
        return _none()
    return TextureOffsets(np.array(centres), np.array(across), np.full(len(across), _SIGMA_PX))


def _none() -> TextureOffsets:
    return TextureOffsets(np.empty((0, 2)), np.empty(0), np.empty(0))


def _grid(left: DecodedView, right: DecodedView) -> _Grid | None:
    """The layout that both views share, with about two pixels of the left image per column; None without overlap."""
    low, high = -np.inf, np.inf
    for view in (left, right):
        seen = view.coordinate[np.isfinite(view.coordinate)]
        if seen.size < _BLOCK**2:
            return None
        low, high = max(low, float(np.quantile(seen, 0.001))), min(high, float(np.quantile(seen, 0.999)))
    by_u, by_v = (_median_step(left.coordinate, axis) for axis in (1, 0))
    step = _BIN_PX * max(by_u, by_v)
    if not (step > 0 and high - low > _BLOCK * step):
        return None
    return _Grid(low, step, int((high - low) / step), by_u >= by_v)


def _median_step(coordinate: Float32, axis: int) -> float:
    step = np.abs(np.diff(coordinate, axis=axis))
    step = step[np.isfinite(step)]
    return float(np.median(step)) if step.size else 0.0


def _lay_out(view: DecodedView, grid: _Grid) -> tuple[Float32, NDArray[np.bool_]]:
    """Texture of a view over row and coordinate without the light's slow course, and which bins have pixels."""
    coordinate, texture = grid.turned(view.coordinate), np.nan_to_num(grid.turned(view.texture))
    inside, row, column = grid.bins(coordinate)
    shape = (-(-coordinate.shape[0] // _BIN_PX), grid.columns)
    place = row * grid.columns + column
    count = np.bincount(place, minlength=shape[0] * shape[1]).reshape(shape).astype(np.float32)
    total = np.bincount(place, texture[inside], shape[0] * shape[1]).reshape(shape).astype(np.float32)
    slow = cv2.GaussianBlur(total, (0, 0), _HIGH_PASS) / np.maximum(cv2.GaussianBlur(count, (0, 0), _HIGH_PASS), 1e-3)
    filled = count > 0
    return np.where(filled, total / np.maximum(count, 1) - slow, 0).astype(np.float32), filled


def _expected_rows(reconstruction: Reconstruction, grid: _Grid, shape: tuple[int, int]) -> tuple[Array, Array]:
    """Shift in rows from the left to the right image that the rig predicts, bin by bin, and the bins' left pixels."""
    shift, pixels = np.full(shape, np.nan), np.full((*shape, 2), np.nan)
    step = 2 * _BIN_PX
    points = reconstruction.points[::step, ::step]
    v, u = (step * i for i in np.nonzero(np.isfinite(points[..., 2])))
    right = reconstruction.rig.with_right().project(reconstruction.points[v, u])
    across, row = (right[:, 1] - v, v) if grid.upright else (right[:, 0] - u, u)
    column = np.floor((reconstruction.left.coordinate[v, u] - grid.lowest) / grid.step).astype(np.int64)
    inside = (column >= 0) & (column < grid.columns)
    place = (row[inside] // _BIN_PX, column[inside])
    shift[place] = across[inside]
    pixels[place] = np.column_stack([u, v])[inside]
    return shift, pixels


def _place(block: Float32, strip: Float32) -> float | None:
    """The row of a strip at which a block lies, to a part of a row; None where no place stands out.

    Whole rows would agree by chance: blocks that are all off by less than half a row would seem to fit to nothing.
    """
    if block.std() == 0:
        return None
    match = cv2.matchTemplate(strip, block, cv2.TM_CCOEFF_NORMED)[:, 0]
    best = int(match.argmax())
    others = np.concatenate([match[: max(0, best - _EXCLUDE)], match[best + _EXCLUDE + 1 :]])
    lead = match[best] - (others.max() if others.size else -1.0)
    if not (match[best] > _LEAST_CORRELATION and lead > _LEAST_LEAD):
        return None
    if not 0 < best < len(match) - 1:
        return float(best)
    before, here, after = (float(value) for value in match[best - 1 : best + 2])
    bend = 2 * here - before - after  # the peak of the parabola through three places
    return best + (0.5 * (after - before) / bend if bend > 0 else 0.0)

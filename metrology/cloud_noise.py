"""How much the points of an organised cloud scatter, from the cloud itself.

The depth of a smooth skin follows a quadric over a few dozen pixels; what is left is noise, and the skin's own grain.
Differences of neighbours would see only the part that is new from pixel to pixel, and scanners smooth: their noise is
alike over several pixels. The residuals of a quadric over a whole tile see all of it that is shorter than a tile.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Float32
from metrology.errors import SceneError
from metrology.robust import MAD

_TILE = 32
_ENOUGH = 0.5  # of a tile's pixels
_CLIP = 3.0
_ROUNDS = 3
_BLOCK = 8
_MOST_TAKEN = 0.5  # of the variance, by the quadric
_FEWEST_TILES = 4
_LEAST_MM = 1e-4


def estimate_sigma(points: Float32, usable: NDArray[np.bool_]) -> Float32:
    """Standard deviation of every point's depth, mm, from the residuals of quadrics over tiles of 32 × 32 pixels.

    Parameters
    ----------
    points : (h, w, 3) ndarray of float32
        mm, z along the camera's axis.
    usable : (h, w) ndarray of bool
        Points of plain skin.

    Returns
    -------
    (h, w) ndarray of float32
        NaN where there is no point.

    Raises
    ------
    SceneError
        Where too few tiles are plain skin.
    """
    height, width = usable.shape
    rows, columns = height // _TILE, width // _TILE
    if min(rows, columns) < 1:
        raise SceneError(f"found a cloud of {width}×{height} pixels, expected at least {_TILE}×{_TILE}")
    depth = _tiles(points[..., 2], rows, columns).astype(float)
    weight = _tiles(usable, rows, columns) & np.isfinite(depth)
    enough = weight.mean(axis=1) >= _ENOUGH
    if enough.sum() < _FEWEST_TILES:
        raise SceneError(
            f"found {enough.sum()} of {enough.size} places with enough points to tell their noise by, expected "
            f"{_FEWEST_TILES} at least: give σ with the cloud"
        )
    sigma = np.full(rows * columns, np.nan)
    sigma[enough] = np.maximum(_scatter(depth[enough], weight[enough]), _LEAST_MM)
    spread = _laid_out(sigma.reshape(rows, columns), (height, width))
    return np.where(np.isfinite(points[..., 2]), spread, np.float32(np.nan)).astype(np.float32)


def _tiles(values: NDArray, rows: int, columns: int) -> NDArray:
    """(tiles, pixels) of the part that whole tiles cover."""
    cut = values[: rows * _TILE, : columns * _TILE].reshape(rows, _TILE, columns, _TILE)
    return np.ascontiguousarray(cut.swapaxes(1, 2)).reshape(rows * columns, _TILE * _TILE)


def _scatter(depth: NDArray[np.float64], used: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(tiles,) robust standard deviation of depth about a quadric over pixels."""
    v, u = (np.indices((_TILE, _TILE)).reshape(2, -1) - (_TILE - 1) / 2) / (_TILE / 2)
    design = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    level = np.nanmedian(np.where(used, depth, np.nan), axis=1, keepdims=True)
    value = np.where(used, depth - level, 0.0)
    kept = used
    sigma = np.zeros(len(depth))
    for _ in range(_ROUNDS):
        weight = kept.astype(float)
        normal = np.einsum("tp,pi,pj->tij", weight, design, design, optimize=True) + 1e-9 * np.eye(6)
        right = (weight * value) @ design
        residual = value - np.linalg.solve(normal, right[..., None])[..., 0] @ design.T
        off = np.where(used, np.abs(residual), np.nan)
        sigma = MAD * np.nanmedian(off, axis=1)
        kept = used & (off <= _CLIP * np.maximum(sigma, _LEAST_MM)[:, None])
    taken = design.shape[1] * _pixels_alike(np.where(kept, residual, 0.0), kept) / _TILE**2
    return sigma / np.sqrt(1.0 - min(taken, _MOST_TAKEN))


def _pixels_alike(residual: NDArray[np.float64], kept: NDArray[np.bool_]) -> float:
    """How many pixels scatter as one, by the means over blocks of 8 × 8: a quadric takes more from noise that does."""
    blocks = _TILE // _BLOCK
    cut = (len(residual), blocks, _BLOCK, blocks, _BLOCK)
    total, count = (values.reshape(cut).sum(axis=(2, 4)) for values in (residual, kept))
    full = count > _ENOUGH * _BLOCK**2
    variance = (residual**2).sum(axis=1) / np.maximum(kept.sum(axis=1), 1)
    alike = total**2 / np.maximum(count * variance[:, None, None], _LEAST_MM**2)
    # Of squared normal deviates the median is 0.455.
    return max(1.0, float(np.median(alike[full])) / 0.455) if full.any() else 1.0


def _laid_out(sigma: NDArray[np.float64], shape: tuple[int, int]) -> Float32:
    """The tiles' values over all pixels: medians of three by three tiles, in between a straight course."""
    known = np.isfinite(sigma)
    filled = np.where(known, sigma, np.median(sigma[known])).astype(np.float32)
    if min(filled.shape) >= 3:
        filled = np.asarray(cv2.medianBlur(filled, 3), np.float32)
    height, width = shape
    v = (np.arange(height) + 0.5) / _TILE - 0.5
    u = (np.arange(width) + 0.5) / _TILE - 0.5
    by_row = np.stack([np.interp(u, np.arange(filled.shape[1]), row) for row in filled])
    return np.stack([np.interp(v, np.arange(len(by_row)), column) for column in by_row.T], axis=1).astype(np.float32)

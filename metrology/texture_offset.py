"""Where the skin's own texture is seen by the right camera, against where equal phase puts it.

Fringe matching finds the counterpart of a left pixel along the epipolar line that the rig predicts; were that line
wrong, equal phase would still be found on it. Texture (grain, scratches, rims) does not know of the rig: a patch around
the left pixel, registered onto the right image, tells how far the true counterpart lies off the line.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.jit import kernel
from metrology.rig import Device

_HALF_PX = 10  # half-size of a patch
PATCH_PX = 2 * _HALF_PX + 1
"""Side of a patch."""
_SMOOTH_PX = 1.2  # so that linear interpolation does not lean towards whole pixels
_SEARCH_PX = 8  # across the epipolar line
_COARSE = 5  # every fifth pixel of a patch is enough to find the whole-pixel shift
_SPARSE = 5  # so is every fifth row and column for the affine map of a patch, whose points know it to hundredths
_ITERATIONS = 3
_LEAST_VALID = 0.6  # of a patch's pixels with a point
AFFINE_RMS_PX = 0.3
"""Of a patch's pixels about an affine map: a patch over a step is not one plane."""
_LEAST_CORRELATION = 0.5
_ALONG_SIGMA_PX = 0.5  # equal phase fixes the counterpart along the line to better than that
_WORST_SIGMA_PX = 0.3


@dataclass(frozen=True)
class TextureOffsets:
    """Registered patches."""

    left_px: Array
    """(n, 2): centres in the left image."""
    across_px: Array
    """(n,): how far off its epipolar line the right camera sees the patch, right pixels; + towards larger v."""
    sigma_px: Array
    """(n,): standard deviation as the patch's own residual tells it."""


def measure_offsets(
    reconstruction: Reconstruction, centres: NDArray[np.int64], affine_rms_px: float = AFFINE_RMS_PX
) -> TextureOffsets:
    """Register the patches about left pixels.

    Parameters
    ----------
    centres : (n, 2) int array
        Left pixels; those without enough texture or points are left out.
    affine_rms_px : float
        Patches that depart farther from an affine map are left out.
    """
    centres, across, sigma, correlation = _registered(reconstruction, centres, affine_rms_px)
    good = (correlation > _LEAST_CORRELATION) & (sigma < _WORST_SIGMA_PX) & (np.abs(across) < _SEARCH_PX)
    return TextureOffsets(centres[good].astype(float), across[good], sigma[good])


def correlations(reconstruction: Reconstruction, centres: NDArray[np.int64]) -> Array:
    """(m,) how alike both cameras see the patches about left pixels (n, 2), each where it is registered best.

    Those without enough points are left out.
    """
    return _registered(reconstruction, centres, AFFINE_RMS_PX)[3]


def _registered(
    reconstruction: Reconstruction, centres: NDArray[np.int64], affine_rms_px: float
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Centres that could be registered, how far across the epipolar line and its standard deviation, correlation."""
    left = _smooth(reconstruction.left.texture)
    right = _smooth(reconstruction.with_right().texture)
    height, width = left.shape
    margin = _HALF_PX + 1
    u, v = centres.T
    centres = centres[(u >= margin) & (v >= margin) & (u < width - margin) & (v < height - margin)]
    grid = np.arange(-_HALF_PX, _HALF_PX + 1)
    offset = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    sparse = offset[((offset + _HALF_PX) % _SPARSE == 0).all(axis=1)]
    centres, origin, matrix, direction = _right_geometry(reconstruction, centres, sparse, affine_rms_px)
    if len(centres) == 0:
        return centres, np.empty(0), np.empty(0), np.empty(0)
    # Across the line, carried into the left patch's frame, in which the shifts are counted.
    across = np.stack([-direction[:, 1], direction[:, 0]], -1)
    across *= np.where(across[:, 1:] < 0, -1.0, 1.0)
    inverse = np.linalg.inv(matrix)
    step = np.einsum("nij,nj->ni", inverse, across)

    def sample(shift: Array, every: int = 1) -> Array:
        values = np.empty((len(origin), len(offset[::every])))
        sample_patches(right, origin, matrix, shift, offset[::every], values)
        return values

    windows = np.lib.stride_tricks.sliding_window_view(left, (2 * margin + 1,) * 2)
    patch = windows[centres[:, 1] - margin, centres[:, 0] - margin].astype(float)
    target = patch[:, 1:-1, 1:-1].reshape(len(centres), -1)
    slope_u = (patch[:, 1:-1, 2:] - patch[:, 1:-1, :-2]).reshape(target.shape) / 2
    slope_v = (patch[:, 2:, 1:-1] - patch[:, :-2, 1:-1]).reshape(target.shape) / 2

    shift = _coarse(target, sample, step)
    along = np.einsum("nij,ni->nj", matrix, direction)
    shift, covariance, correlation = _refine(target, slope_u, slope_v, sample, shift, along)
    moved = np.einsum("nij,nj->ni", matrix, shift)
    forward = np.einsum("ni,nij->nj", across, matrix)
    sigma = np.sqrt(np.einsum("ni,nij,nj->n", forward, covariance, forward))
    return centres, np.einsum("ni,ni->n", moved, across), sigma, correlation


@kernel
def sample_patches(image, origin, matrix, shift, offset, values):  # type: ignore[no-untyped-def]
    """Bilinear values at ``origin + matrix · (offset + shift)``; beyond the border those of the border.

    Parameters
    ----------
    image : (h, w) float32
    origin, shift : (n, 2) float64; matrix : (n, 2, 2) float64
    offset : (k, 2) int64
    values : (n, k) float64
        Written.
    """
    height, width = image.shape
    for n in range(len(origin)):
        for k in range(len(offset)):
            du, dv = offset[k, 0] + shift[n, 0], offset[k, 1] + shift[n, 1]
            u = origin[n, 0] + matrix[n, 0, 0] * du + matrix[n, 0, 1] * dv
            v = origin[n, 1] + matrix[n, 1, 0] * du + matrix[n, 1, 1] * dv
            u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
            i, j = min(int(u), width - 2), min(int(v), height - 2)
            p, q = u - i, v - j
            above = image[j, i] * (1 - p) + image[j, i + 1] * p
            below = image[j + 1, i] * (1 - p) + image[j + 1, i + 1] * p
            values[n, k] = above * (1 - q) + below * q


def _smooth(texture: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(np.nan_to_num(texture), (0, 0), _SMOOTH_PX), np.float32)


def _right_geometry(
    reconstruction: Reconstruction, centres: NDArray[np.int64], offset: NDArray[np.int64], affine_rms_px: float
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Affine map of each patch into the right image, and the epipolar line's direction there.

    Returns the centres that have one, right pixels of the centres (n, 2), matrices (n, 2, 2), unit directions (n, 2).
    """
    rig = reconstruction.rig
    pixels = centres[:, None] + offset[None]
    points = reconstruction.points[pixels[..., 1], pixels[..., 0]].astype(float)
    valid = np.isfinite(points[..., 2])
    enough = valid.mean(1) > _LEAST_VALID
    centres, points, valid = centres[enough], points[enough], valid[enough]
    if len(centres) == 0:
        return centres, np.empty((0, 2)), np.empty((0, 2, 2)), np.empty((0, 2))
    seen = rig.with_right().project(np.where(valid[..., None], points, [0.0, 0.0, 1.0]))
    design = np.column_stack([np.ones(len(offset)), offset])
    weighted = design[None] * valid[..., None]
    normal = np.einsum("nki,nkj->nij", weighted, weighted)
    solution = np.linalg.solve(normal, np.einsum("nki,nkj->nij", weighted, seen))
    off = np.where(valid[..., None], seen - design @ solution, 0.0)
    rms = np.sqrt((off**2).sum((1, 2)) / valid.sum(1))
    origin, matrix = solution[:, 0], np.swapaxes(solution[:, 1:], 1, 2)
    inside = rig.with_right().inside(origin)
    keep = (rms < affine_rms_px) & inside & (np.linalg.det(matrix) > 0)
    depth = np.nanmean(np.where(valid, points[..., 2], np.nan), axis=1)
    return (
        centres[keep],
        origin[keep],
        matrix[keep],
        epipolar_directions(rig.left, rig.with_right(), centres[keep], depth[keep]),
    )


def epipolar_directions(left: Device, right: Device, left_px: NDArray[np.number], depth_mm: Array) -> Array:
    """(n, 2) unit directions in the right image of the epipolar lines of left pixels, near a depth."""
    rays = left.rays(left_px)
    points = rays * (depth_mm / rays[:, 2])[:, None]
    step = right.project(points * 1.001) - right.project(points * 0.999)
    return np.asarray(step / np.linalg.norm(step, axis=1, keepdims=True))


def _coarse(target: Array, sample: Callable[..., Array], step: Array) -> Array:
    """Whole-pixel shift across the line with the best correlation."""
    best = np.full(len(target), -np.inf)
    shift = np.zeros((len(target), 2))
    for pixels in range(-_SEARCH_PX, _SEARCH_PX + 1):
        value = _correlation(target[:, ::_COARSE], sample(pixels * step, _COARSE))
        better = value > best
        best[better] = value[better]
        shift[better] = pixels * step[better]
    return shift


def _correlation(a: Array, b: Array) -> Array:
    a, b = a - a.mean(1, keepdims=True), b - b.mean(1, keepdims=True)
    size = np.sqrt((a * a).sum(1) * (b * b).sum(1))
    return np.asarray((a * b).sum(1) / np.maximum(size, 1e-9))


def _refine(
    target: Array, slope_u: Array, slope_v: Array, sample: Callable[..., Array], shift: Array, along: Array
) -> tuple[Array, Array, Array]:
    """Gauss-Newton on shift, gain and offset; shifts along the epipolar line are held near zero by the phase match."""
    one = np.ones_like(target)
    prior = np.einsum("ni,nj->nij", along, along) / _ALONG_SIGMA_PX**2
    for _ in range(_ITERATIONS):
        seen = sample(shift)
        design = np.stack([slope_u, slope_v, seen, one], -1)
        normal = np.swapaxes(design, 1, 2) @ design
        right_side = (np.swapaxes(design, 1, 2) @ target[..., None])[..., 0]
        plain = np.linalg.solve(normal + 1e-6 * np.eye(4), right_side[..., None])[..., 0]
        residual = target - (design @ plain[..., None])[..., 0]
        variance = (residual**2).sum(1) / (target.shape[1] - 4) + 1e-12
        normal[:, :2, :2] += variance[:, None, None] * prior
        right_side[:, :2] -= variance[:, None] * np.einsum("nij,nj->ni", prior, shift)
        normal += 1e-6 * np.eye(4)
        # L(p) ≈ gain R(p + s) + offset + ∇L · δ, with δ what is still missing of the shift s.
        solution = np.linalg.solve(normal, right_side[..., None])[..., 0]
        shift = shift + np.clip(solution[:, :2], -1, 1)
    covariance = np.linalg.inv(normal)[:, :2, :2] * variance[:, None, None]
    return shift, covariance, _correlation(target, sample(shift))

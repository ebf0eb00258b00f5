"""Points without an order, laid on the pixels of a camera that is made for them.

Every pixel gets the point where its ray meets a plane through the nearest points; a pixel that no points surround gets
none. This costs what the pixels do not resolve: an edge is known to a pixel, and a few points share one plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from metrology.arrays import Array
from metrology.errors import SceneError
from metrology.rig import Device

_NEIGHBOURS = 8
_REACH_PX = 1.6  # the nearest point of a pixel is no farther than this
_AWAY = 2.5  # the camera's distance in sizes of the field
_LEAST_AWAY_MM, _MOST_AWAY_MM = 200.0, 5000.0
_SAMPLE = 20_000
_FEWEST = 1000
_LARGEST = 60_000_000
_SAME_SHEET = 8.0  # spacings of the points: neighbours that lie this much farther away belong to another sheet
_CHUNK = 200_000


@dataclass(frozen=True)
class Gridded:
    """Points on a camera's pixels."""

    device: Device
    """At the origin of the new frame."""
    R: Array
    t: Array
    """R, t: (3, 3) and (3,): A point x of the old frame is at R x + t in the new one, mm."""
    points: NDArray[np.float32]
    """(h, w, 3) of float32."""
    grey: NDArray
    """(h, w): brightness of the nearest point, 0 where there is none."""
    spacing_mm: float
    """Of the points, which a pixel spans."""


def grid_points(points: Array, grey: NDArray) -> Gridded:
    """Lay points on the pixels of a camera that faces them, from where their frame's origin lies or else along its z.

    Parameters
    ----------
    points : (n, 3) ndarray
        mm.
    grey : (n,) ndarray
    """
    known = np.isfinite(points).all(axis=1)
    points, grey = points[known], grey[known]
    if len(points) < _FEWEST:
        raise SceneError(f"found {len(points)} points, expected {_FEWEST} at least")
    axes, middle, size = _facing(points)
    spacing = _spacing(points)
    distance = float(np.clip(_AWAY * size.max(), _LEAST_AWAY_MM, _MOST_AWAY_MM))
    R, t = axes, np.array([0.0, 0.0, distance]) - axes @ middle
    seen = points @ R.T + t
    width, height = (int(np.ceil(side / spacing)) + 3 for side in size * distance / seen[:, 2].min())
    if width * height > _LARGEST:
        raise SceneError(f"found a cloud of {width}×{height} points, expected {_LARGEST:,} at most")
    focal = distance / spacing
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    device = Device(width, height, K, np.zeros(0), np.eye(3), np.zeros(3))
    laid, nearest = lay_on(device, seen, spacing)
    brightness = np.where(np.isfinite(laid[..., 2]), grey[nearest], 0).astype(grey.dtype)
    return Gridded(device, R, t, laid, brightness, spacing)


def _facing(points: Array) -> tuple[Array, Array, Array]:
    """Axes of a camera that faces the points (rows), the middle of their field, and its size, mm."""
    every = points[:: max(1, len(points) // _SAMPLE)]
    middle = np.median(every, axis=0)
    axes = np.linalg.svd(every - middle, full_matrices=False)[2]
    normal = axes[2]
    towards = -middle if np.linalg.norm(middle) > np.ptp(every @ axes[0]) else np.array([0.0, 0.0, 1.0])
    forward = -normal if normal @ towards > 0 else normal
    # x of the picture along x of the file, so that up stays up.
    across = np.array([1.0, 0.0, 0.0]) if abs(forward[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    across -= (across @ forward) * forward
    across /= np.linalg.norm(across)
    frame = np.stack([across, np.cross(forward, across), forward])
    local = every @ frame.T
    low, high = np.quantile(local[:, :2], [0, 1], axis=0)
    return frame, np.array([*(0.5 * (low + high)), np.median(local[:, 2])]) @ frame, high - low


def _spacing(points: Array) -> float:
    """Usual distance between neighbouring points, mm."""
    tree = cKDTree(points)
    some = points[:: max(1, len(points) // _SAMPLE)]
    return float(np.median(tree.query(some, k=5)[0][:, 1:].mean(axis=1)))


def lay_on(device: Device, seen: Array, spacing: float | None = None) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """The points where the pixels' rays meet planes through the nearest points.

    Parameters
    ----------
    device : Device
        At the origin.
    seen : (n, 3) ndarray
        Before it, mm.
    spacing : float, optional
        Usual distance between neighbouring points, mm.

    Returns
    -------
    points : (h, w, 3) ndarray of float32
        NaN where no points surround a pixel.
    nearest : (h, w) ndarray of int
        Which of the points is the nearest.
    """
    spacing = spacing or _spacing(seen)
    pixels = device.project(seen)
    tree = cKDTree(pixels)
    v, u = np.indices((device.height, device.width)).reshape(2, -1)
    centres = np.stack([u, v], axis=1).astype(float)
    depth = np.full(len(centres), np.nan)
    nearest = np.zeros(len(centres), np.int64)
    for first in range(0, len(centres), _CHUNK):
        part = slice(first, first + _CHUNK)
        far, found = tree.query(centres[part], k=_NEIGHBOURS, distance_upper_bound=2 * _REACH_PX)
        depth[part] = _depths(centres[part], far, found, pixels, seen[:, 2], _SAME_SHEET * spacing)
        nearest[part] = np.where(far[:, 0] <= _REACH_PX, np.minimum(found[:, 0], len(seen) - 1), 0)
    rays = np.concatenate([device.normalized(centres), np.ones((len(centres), 1))], axis=1)
    shape = (device.height, device.width)
    points = (rays * depth[:, None]).astype(np.float32).reshape(*shape, 3)
    return points, nearest.reshape(shape)


def _depths(centres: Array, far: Array, found: NDArray, pixels: Array, depth: Array, sheet: float) -> Array:
    """(n,) depth at the centres by planes through the front neighbours; NaN where they do not surround."""
    there = np.isfinite(far)
    index = np.where(there, found, 0)
    z = np.where(there, depth[index], np.inf)
    there &= z <= z.min(axis=1, keepdims=True) + sheet
    offset = pixels[index] - centres[:, None]
    # From both sides along both axes, so that nothing is continued over an edge.
    du, dv = np.where(there, offset[..., 0], 0.0), np.where(there, offset[..., 1], 0.0)
    around = (du.min(axis=1) <= 0) & (du.max(axis=1) >= 0) & (dv.min(axis=1) <= 0) & (dv.max(axis=1) >= 0)
    good = around & (far[:, 0] <= _REACH_PX) & (there.sum(axis=1) >= 4)
    weight = np.where(there, 1.0 / (0.25 + np.where(there, far, 0.0) ** 2), 0.0)
    inverse = np.where(there, 1.0 / np.where(there, z, 1.0), 0.0)
    design = np.stack([np.ones_like(du), du, dv], axis=-1)
    normal = np.einsum("nk,nki,nkj->nij", weight, design, design) + 1e-9 * np.eye(3)
    right = np.einsum("nk,nki->ni", weight * inverse, design)
    with np.errstate(divide="ignore", invalid="ignore"):
        fitted = 1.0 / np.linalg.solve(normal, right[..., None])[:, 0, 0]
    return np.where(good, fitted, np.nan)

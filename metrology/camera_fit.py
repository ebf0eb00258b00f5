"""The camera in whose pixels an organised cloud lies, from the cloud itself: entry [v, u] is on that pixel's ray.

Most scanners give points in their camera's own frame, z forward or (as in computer graphics) backward; then the rays
x/z, y/z tell the lens. Where the points are in another frame the camera's pose is found as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from metrology.arrays import Array
from metrology.errors import SceneError
from metrology.rig import Device

# Signs of the axes against x right, y down, z forward.
_FRAMES = ((1.0, 1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, -1.0, 1.0), (-1.0, 1.0, -1.0))
_SAMPLE = 3000
_FEWEST = 200
_OWN_FRAME_PX = 5.0  # a lens without distortion misses no more than this by its distortion
_LENGTHS = (0.8, 1.6, 3.2, 6.4)  # focal lengths to begin with, in image widths
_SOFT_PX = 0.5


@dataclass(frozen=True)
class FittedCamera:
    """A camera, and where it stood."""

    device: Device
    """At the origin."""
    R: Array
    t: Array
    """R, t: (3, 3) and (3,): A point x of the cloud's frame is at R x + t in the camera's, mm."""
    rms_px: float
    """Of the pixels against where the camera sees their points."""


def fit_camera(points: NDArray, most_px: float) -> FittedCamera | None:
    """The pinhole with distortion that sees the points of an organised cloud at their pixels.

    Parameters
    ----------
    points : (h, w, 3) ndarray
        mm, any frame; NaN where there is none.
    most_px : float
        Root mean square deviation from which no camera explains the cloud.

    Returns
    -------
    FittedCamera or None
        None where none does, as for a height map.
    """
    sample, pixels = _sample(points)
    height, width = points.shape[:2]
    found = [fit for axes in _FRAMES if (fit := _in_own_frame(sample, pixels, np.diag(axes), (width, height)))]
    best = min(found, key=lambda fit: fit.rms_px, default=None)
    if best is None or best.rms_px > most_px:
        best = _with_pose(sample, pixels, (width, height))
    return None if best is None or best.rms_px > most_px else best


def _sample(points: NDArray) -> tuple[Array, Array]:
    """Points evenly over the grid, and their pixels."""
    v, u = np.nonzero(np.isfinite(points[..., 2]))
    if len(v) < _FEWEST:
        raise SceneError(f"found {len(v)} points, expected at least {_FEWEST}")
    chosen = np.unique(np.linspace(0, len(v) - 1, _SAMPLE).astype(int))
    # Every so many in reading order would come from a few columns of an even grid.
    chosen = (chosen * 7919) % len(v)
    v, u = v[chosen], u[chosen]
    return points[v, u].astype(float), np.stack([u, v], axis=1).astype(float)


def _in_own_frame(points: Array, pixels: Array, axes: Array, size: tuple[int, int]) -> FittedCamera | None:
    """A camera at the cloud's origin; None where it would look the other way."""
    seen = points @ axes
    if not (seen[:, 2] > 0).all():
        return None
    rays = seen[:, :2] / seen[:, 2:]
    start = []
    for k in range(2):
        design = np.column_stack([rays[:, k], np.ones(len(rays))])
        start.append(np.linalg.lstsq(design, pixels[:, k], rcond=None)[0])
    (fx, cx), (fy, cy) = start
    if min(fx, fy) <= 0:
        return None
    missed = rays * [fx, fy] + [cx, cy] - pixels
    if np.sqrt(np.median(np.sum(missed**2, axis=1))) > _OWN_FRAME_PX:
        return None
    device, rms = _refined(seen, pixels, (fx, fy, cx, cy), size)
    return FittedCamera(device, axes, np.zeros(3), rms)


def _refined(seen: Array, pixels: Array, start: tuple[float, ...], size: tuple[int, int]) -> tuple[Device, float]:
    """Lens with five terms of distortion; its root mean square deviation, px, outliers left aside."""

    def device(p: Array) -> Device:
        K = np.array([[p[0], 0, p[2]], [0, p[1], p[3]], [0, 0, 1]])
        return Device(*size, K, p[4:], np.eye(3), np.zeros(3))

    def missed(p: Array) -> Array:
        return (device(p).project(seen) - pixels).ravel()

    scale = np.array([*np.abs(start), 0.1, 0.1, 0.01, 0.01, 0.1])
    solved = least_squares(missed, [*start, 0, 0, 0, 0, 0], loss="soft_l1", f_scale=_SOFT_PX, x_scale=scale).x
    off = np.sum(missed(solved).reshape(-1, 2) ** 2, axis=1)
    return device(solved), float(np.sqrt(np.mean(np.minimum(off, np.quantile(off, 0.99)))))


def _with_pose(points: Array, pixels: Array, size: tuple[int, int]) -> FittedCamera | None:
    """A camera anywhere: its pose for some focal lengths, the best of which is refined with the lens."""
    middle = points.mean(axis=0)
    objects, images = (points - middle).astype(np.float32), pixels.astype(np.float32)
    found = []
    for length in _LENGTHS:
        f = length * size[0]
        K = np.array([[f, 0, (size[0] - 1) / 2], [0, f, (size[1] - 1) / 2], [0, 0, 1]])
        good, turn, shift = cv2.solvePnP(objects, images, K, None, flags=cv2.SOLVEPNP_SQPNP)
        if good:
            off = cv2.projectPoints(objects, turn, shift, K, None)[0].reshape(-1, 2) - images
            found.append((float(np.sqrt(np.median(np.sum(off**2, axis=1)))), K))
    if not found:
        return None
    K = min(found, key=lambda one: one[0])[1]
    try:
        _, K, lens, turns, shifts = cv2.calibrateCamera(
            [objects], [images], size, K, np.zeros(5), flags=cv2.CALIB_USE_INTRINSIC_GUESS
        )
    except cv2.error:
        return None
    R = np.asarray(cv2.Rodrigues(turns[0])[0], float)
    t = np.asarray(shifts[0], float).ravel() - R @ middle
    seen = points @ R.T + t
    if not (seen[:, 2] > 0).all() or not np.isfinite(lens).all() or min(K[0, 0], K[1, 1]) <= 0:
        return None
    device = Device(*size, np.asarray(K, float), np.asarray(lens, float).ravel()[:5], np.eye(3), np.zeros(3))
    off = np.sum((device.project(seen) - pixels) ** 2, axis=1)
    return FittedCamera(device, R, t, float(np.sqrt(np.mean(np.minimum(off, np.quantile(off, 0.99))))))

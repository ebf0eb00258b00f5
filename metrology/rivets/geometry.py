"""Circles on the skin as the left camera sees them, and image ellipses laid back onto the skin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.rig import Device
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.shapes import CircleShapes
from metrology.surfaces import Frame

Array = NDArray[np.float64]

_STRIDE = 8  # pixels between the points that a normal is taken from
_MIN_SHARE = 0.3  # of a cell's pixels must have points for a normal


def image_scale(camera: Device, point: Array, normal: Array) -> Array:
    """(2, 2) Jacobian: pixels per mm along two directions on a surface, about a point."""
    frame = Frame.on_plane(point, normal)
    step = 1e-2
    ends = np.stack([point, point + step * frame.axes[0], point + step * frame.axes[1]])
    pixels = camera.project(ends)
    return np.asarray(((pixels[1:] - pixels[0]) / step).T)


def circle_shapes(reconstruction: Reconstruction, cell: int = 160) -> tuple[CircleShapes, Array]:
    """What circles on the skin look like in each cell of the left image, and how large a millimetre is.

    Each cell's plane is fitted to its points (median of differences, so that heads and seams do not tip it); cells with
    few points take the shape of the nearest one that has it.

    Returns
    -------
    shapes : CircleShapes
    pixels_per_mm : (rows, columns) ndarray
        Geometric mean over directions.
    """
    points = reconstruction.points
    height, width = points.shape[:2]
    rows, columns = -(-height // cell), -(-width // cell)
    matrices, scales = np.full((rows, columns, 3), np.nan), np.full((rows, columns), np.nan)
    for i in range(rows):
        for j in range(columns):
            # Half a cell more all round: one cell may hold little but a head.
            v, u = max(i * cell - cell // 2, 0), max(j * cell - cell // 2, 0)
            part = points[v : (i + 1) * cell + cell // 2 : _STRIDE, u : (j + 1) * cell + cell // 2 : _STRIDE].reshape(
                -1, 3
            )
            part = part[np.isfinite(part[:, 2])].astype(float)
            if len(part) < _MIN_SHARE * (cell // _STRIDE) ** 2:
                continue
            point, normal = _robust_plane(part)
            jacobian = image_scale(reconstruction.rig.left, point, normal)
            shape = jacobian @ jacobian.T
            scale = np.sqrt(np.linalg.det(shape))
            matrices[i, j] = np.array([shape[0, 0], shape[1, 1], shape[0, 1]]) / scale
            scales[i, j] = np.sqrt(scale)
    known = np.argwhere(np.isfinite(scales))
    if len(known) == 0:
        return CircleShapes.round(), np.full((1, 1), np.nan)
    for i, j in np.argwhere(~np.isfinite(scales)):
        k = known[np.argmin(((known - [i, j]) ** 2).sum(axis=1))]
        matrices[i, j], scales[i, j] = matrices[k[0], k[1]], scales[k[0], k[1]]
    return CircleShapes(matrices, float(cell)), scales


def _robust_plane(points: NDArray[np.floating]) -> tuple[Array, Array]:
    """A point on, and the normal of, the plane z(x, y) through points, outliers beyond three sigmas left out."""
    centre = points.mean(axis=0)
    design = np.column_stack([np.ones(len(points)), points[:, :2] - centre[:2]])
    depth = points[:, 2] - centre[2]
    weight = np.ones(len(points))
    for _ in range(2):
        weighted = design * weight[:, None]
        solution = np.linalg.solve(weighted.T @ design + 1e-9 * np.eye(3), weighted.T @ depth)
        residual = np.abs(depth - design @ solution)
        weight = (residual < 3 * 1.4826 * np.median(residual) + 1e-9).astype(float)
    return np.array([centre[0], centre[1], centre[2] + solution[0]]), np.array([solution[1], solution[2], -1.0])


def lay_on_plane(camera: Device, ellipse: Ellipse, frame: Frame, height: float = 0.0) -> tuple[float, float, float]:
    """The circle on the plane h = `height` of a frame that an image ellipse is the image of.

    Rays through the ellipse meet the plane in points of a circle; its centre is not where the ray through the ellipse's
    centre meets it.

    Returns
    -------
    x, y, radius : float
        Local coordinates, mm.
    """
    rays = camera.rays(ellipse.points(72)) @ frame.axes.T
    eye = frame.local(camera.centre)
    t = (height - eye[2]) / rays[:, 2]
    x, y = eye[0] + t * rays[:, 0], eye[1] + t * rays[:, 1]
    design = np.column_stack([x, y, np.ones_like(x)])
    (a, b, c), *_ = np.linalg.lstsq(design, x**2 + y**2, rcond=None)
    return float(a / 2), float(b / 2), float(np.sqrt(c + (a**2 + b**2) / 4))


def nearby_plane(reconstruction: Reconstruction, ellipse: Ellipse) -> tuple[Frame, float, float] | None:
    """Frame on the plane of the points in and about an ellipse, and the centre of its circle there, mm.

    None where there are too few points.
    """
    reach = 1.6 * ellipse.a
    height, width = reconstruction.points.shape[:2]
    u0, u1 = max(0, int(ellipse.u - reach)), min(width, int(ellipse.u + reach) + 1)
    v0, v1 = max(0, int(ellipse.v - reach)), min(height, int(ellipse.v + reach) + 1)
    stride = max(1, int(reach / 20))
    points = reconstruction.points[v0:v1:stride, u0:u1:stride].reshape(-1, 3)
    points = points[np.isfinite(points[:, 2])].astype(float)
    if len(points) < 50:
        return None
    frame = Frame.on_plane(*_robust_plane(points))
    x, y, _ = lay_on_plane(reconstruction.rig.left, ellipse, frame)
    return frame, x, y

"""Circles on the skin as the left camera sees them, and image ellipses laid back onto the skin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.rig import Device
from metrology.rivets.ellipse import Ellipse, ellipse_of_shape
from metrology.rivets.shapes import CircleShapes, log_shape
from metrology.robust import MAD, median
from metrology.surfaces import Frame, monomials

_STRIDE = 8  # pixels between the points that a normal is taken from
_STEP = 3  # of those between the ends of a difference
_CELL_TOLERANCE = 0.05  # in elongation and log size, between a cell and its surroundings
_MIN_SHARE = 0.3  # of a cell's pixels must have points for a normal


def image_scales(camera: Device, points: Array, normals: Array) -> Array:
    """(n, 2, 2) Jacobians: pixels per mm along two directions on a surface, about each of the points (n, 3)."""
    axes = np.array([Frame.on_plane(point, normal).axes for point, normal in zip(points, normals, strict=True)])
    step = 1e-2
    ends = points[:, None] + step * np.concatenate([np.zeros((len(points), 1, 3)), axes[:, :2]], axis=1)
    pixels = camera.project(ends)
    return np.asarray(((pixels[:, 1:] - pixels[:, :1]) / step).transpose(0, 2, 1))


def circle_shapes(reconstruction: Reconstruction, cell: int = 160) -> tuple[CircleShapes, Array]:
    """What circles on the skin look like in each cell of the left image, and how large a millimetre is.

    On a plane 1/z is linear over the image; each cell's slope is the median of differences, which heads, seams and the
    border of the panel hardly move. Over the image elongation and size change smoothly: cells that disagree with a
    robust quadratic through all, or have few points, take its value.

    Returns
    -------
    shapes : CircleShapes
    pixels_per_mm : (rows, columns) ndarray
        Geometric mean over directions; NaN everywhere where no cell has points enough.
    """
    camera = reconstruction.rig.left
    inverse = 1 / reconstruction.points[::_STRIDE, ::_STRIDE, 2].astype(float)
    along_u, along_v = inverse[:, _STEP:] - inverse[:, :-_STEP], inverse[_STEP:] - inverse[:-_STEP]
    height, width = reconstruction.points.shape[:2]
    rows, columns = -(-height // cell), -(-width // cell)
    seen = np.full((rows, columns, 3), np.nan)
    cells, levels, slopes = [], [], []
    for i in range(rows):
        for j in range(columns):
            # Half a cell more all round: one cell may hold little but a head.
            v, u = max(i * cell - cell // 2, 0) // _STRIDE, max(j * cell - cell // 2, 0) // _STRIDE
            part = np.s_[v : ((i + 1) * cell + cell // 2) // _STRIDE, u : ((j + 1) * cell + cell // 2) // _STRIDE]
            known = inverse[part][np.isfinite(inverse[part])]
            steps = [a[part][np.isfinite(a[part])] for a in (along_u, along_v)]
            if min(len(known), len(steps[0]), len(steps[1])) < _MIN_SHARE * (cell // _STRIDE) ** 2:
                continue
            cells.append((i, j))
            levels.append(median(known))
            slopes.append([median(s) for s in steps])
    if not cells:
        return CircleShapes.round(), np.full((1, 1), np.nan)
    # 1/z = (n · ray) / (n · point): the normal up to its length.
    level = np.array(levels)[:, None]
    slope = np.diag(camera.K)[:2] * slopes / (_STEP * _STRIDE)
    rays = camera.normalized((np.array(cells, float)[:, ::-1] + 0.5) * cell)
    normals = np.hstack([slope, level - np.sum(slope * rays, axis=1, keepdims=True)])
    jacobians = image_scales(camera, np.hstack([rays, np.ones_like(level)]) / level, normals)
    for (i, j), jacobian in zip(cells, jacobians, strict=True):
        shape = ellipse_of_shape(0.0, 0.0, jacobian @ jacobian.T)
        seen[i, j] = *log_shape(shape), np.log(shape.radius)
    smooth = _smooth_over_cells(seen)
    agrees = np.linalg.norm(seen - smooth, axis=-1, keepdims=True) < _CELL_TOLERANCE
    values = np.where(agrees, seen, smooth)
    return CircleShapes.of_elongation(values[..., :2], float(cell)), np.exp(values[..., 2])


def _smooth_over_cells(seen: Array) -> Array:
    """Robust polynomial over the cells (rows, columns, k): quadratic, linear or constant as the known cells allow."""
    rows, columns = seen.shape[:2]
    y, x = np.mgrid[0:rows, 0:columns].astype(float)
    x, y = (x - columns / 2) / columns, (y - rows / 2) / rows
    known = np.isfinite(seen[..., 0])
    order = 2 if known.sum() >= 18 else 1 if known.sum() >= 8 else 0
    design = monomials(x, y, order)
    values, at = seen[known], design[known]
    weight = np.ones(len(values))
    for _ in range(10):
        weighted = at * weight[:, None]
        model = np.linalg.solve(weighted.T @ at + 1e-9 * np.eye(at.shape[1]), weighted.T @ values)
        error = np.linalg.norm(values - at @ model, axis=1)
        # Least absolute deviations: a row of cells along a border does not tip the whole.
        weight = 1 / np.maximum(error, 0.2 * np.median(error) + 1e-6)
    return np.asarray(design @ model)


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
        weight = (residual < 3 * MAD * np.median(residual) + 1e-9).astype(float)
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
    stride = max(1, int(reach / 8))
    points = reconstruction.points[v0:v1:stride, u0:u1:stride].reshape(-1, 3)
    points = points[np.isfinite(points[:, 2])].astype(float)
    if len(points) < 50:
        return None
    frame = Frame.on_plane(*_robust_plane(points))
    x, y, _ = lay_on_plane(reconstruction.rig.left, ellipse, frame)
    return frame, x, y

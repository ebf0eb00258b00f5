"""A first projector from points and decoded coordinates: the linear equations of a pinhole, without distortion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import rq

from metrology.arrays import Array
from metrology.errors import CalibrationError
from metrology.fringe import Axis
from metrology.rig import Device

_MOST_POINTS = 4000
_FLAT = 1e-5  # second smallest over largest singular value: below, the points lie on one plane


def linear_projector(scans: Sequence[tuple[Axis, Array, Array]], size: tuple[int, int]) -> Device:
    """The pinhole P with ``u (p₃ · X) = p₁ · X`` and, for coordinates along y, ``v (p₃ · X) = p₂ · X``.

    Parameters
    ----------
    scans : sequence of (axis, points (n, 3), coordinates (n,))
    size : (width, height)
        Of the projector. Where one axis is missing its pixels are square and its middle is lit.
    """
    points = np.concatenate([p[:: max(len(p) // _MOST_POINTS, 1)] for _, p, _ in scans])
    middle, reach = points.mean(0), float(points.std())
    unit = max(size) / 2
    rows = []
    for axis, all_points, all_coordinates in scans:
        step = max(len(all_points) // _MOST_POINTS, 1)
        X = np.column_stack([(all_points[::step] - middle) / reach, np.ones(len(all_points[::step]))])
        u = all_coordinates[::step, None] / unit - 1
        zero = np.zeros_like(X)
        rows.append(np.hstack([X, zero, -u * X] if axis == "x" else [zero, X, -u * X]))
    axes = {axis for axis, _, _ in scans}
    use = [*range(4)] * ("x" in axes) + [*range(4, 8)] * ("y" in axes) + [*range(8, 12)]
    _, singular, right = np.linalg.svd(np.concatenate(rows)[:, use], full_matrices=False)
    if singular[-2] < _FLAT * singular[0]:
        raise CalibrationError(
            "found points on one plane, expected scans of something with depth, or of planes in several places"
        )
    P = np.zeros(12)
    P[use] = right[-1]
    P = P.reshape(3, 4) * unit
    P[:2] += P[2] * 1.0
    P[2] /= unit
    P[:, :3] /= reach
    P[:, 3] -= P[:, :3] @ middle
    P *= np.sign(float(P[2] @ np.append(middle, 1.0))) / np.linalg.norm(P[2, :3])
    if len(axes) == 2:
        return _both(P, size)
    return _one(P, "x" in axes, size, middle)


def _both(P: Array, size: tuple[int, int]) -> Device:
    K, R = rq(P[:, :3])
    signs = np.diag(np.sign(np.diag(K)))
    K, R = K @ signs, signs @ R
    t = np.linalg.solve(K, P[:, 3])
    K = K / K[2, 2]
    K[0, 1] = 0.0
    if np.linalg.det(R) < 0:
        raise CalibrationError(
            "found columns and rows that mirror each other, expected a projector: one of the scans' codes runs "
            "backwards (direction −1)"
        )
    return Device(*size, K, np.zeros(5), _nearest_rotation(R), t)


def _one(P: Array, columns: bool, size: tuple[int, int], middle: Array) -> Device:
    """From the pinhole's rows of one axis: `columns` tells p₁, else p₂."""
    p, p3 = P[0 if columns else 1], P[2]
    r3 = p3[:3]
    c = float(p[:3] @ r3)
    f = float(np.linalg.norm(p[:3] - c * r3))
    r = (p[:3] - c * r3) / f
    t, t3 = (p[3] - c * p3[3]) / f, p3[3]
    other = np.cross(r3, r) if columns else np.cross(r, r3)
    side = (size[1 if columns else 0] - 1) / 2
    t_other = -float(other @ middle)  # the middle of what is seen is lit by the projector's middle
    R = np.stack([r, other, r3] if columns else [other, r, r3])
    shift = np.array([t, t_other, t3] if columns else [t_other, t, t3])
    K = np.array([[f, 0, c if columns else side], [0, f, side if columns else c], [0, 0, 1.0]])
    return Device(*size, K, np.zeros(5), _nearest_rotation(R), shift)


def _nearest_rotation(R: Array) -> Array:
    u, _, vt = np.linalg.svd(R)
    return np.asarray(u @ vt)

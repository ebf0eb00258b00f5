"""A device's projection with its derivatives, for the joint adjustment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array

INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


@dataclass(frozen=True)
class Projected:
    """Pixels of points with derivatives."""

    pixels: Array
    """(n, 2)."""
    by_point: Array
    """(n, 2, 3): ∂(u, v)/∂(x, y, z), the point in the device's own frame."""
    by_lens: Array
    """(n, 2, 9): ∂(u, v)/∂ INTRINSICS."""


def project(points: Array, lens: Array) -> Projected:
    """OpenCV's model with three radial and two tangential terms.

    Parameters
    ----------
    points : (n, 3) array
        Device frame, mm.
    lens : (9,) array
        INTRINSICS.
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = lens
    z = points[:, 2]
    x, y = points[:, 0] / z, points[:, 1] / z
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)  # ∂radial/∂r²
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    xd_x = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    xd_y = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    yd_y = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    yd_x = xd_y

    by_point = np.empty((len(points), 2, 3))
    for row, f, by_x, by_y in ((by_point[:, 0], fx, xd_x, xd_y), (by_point[:, 1], fy, yd_x, yd_y)):
        row[:, 0], row[:, 1], row[:, 2] = f * by_x / z, f * by_y / z, -f * (by_x * x + by_y * y) / z

    r4, xy = r2 * r2, 2 * x * y
    by_lens = np.zeros((len(points), 2, 9))
    by_lens[:, 0, 0], by_lens[:, 1, 1] = xd, yd
    by_lens[:, 0, 2] = by_lens[:, 1, 3] = 1.0
    for column, by_xd, by_yd in (
        (4, x * r2, y * r2),
        (5, x * r4, y * r4),
        (6, xy, r2 + 2 * y * y),
        (7, r2 + 2 * x * x, xy),
        (8, x * r4 * r2, y * r4 * r2),
    ):
        by_lens[:, 0, column], by_lens[:, 1, column] = fx * by_xd, fy * by_yd
    return Projected(np.column_stack([fx * xd + cx, fy * yd + cy]), by_point, by_lens)


def skew(vectors: Array) -> Array:
    """(..., 3, 3) cross-product matrices of (..., 3) vectors."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*vectors.shape, 3)


def left_jacobian(rotation_vector: Array) -> Array:
    """(3, 3) J with exp(r + dr) ≈ exp(J dr) exp(r)."""
    angle = float(np.linalg.norm(rotation_vector))
    cross = skew(rotation_vector)
    if angle < 1e-6:
        return np.asarray(np.eye(3) + cross / 2)
    return np.asarray(
        np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross
    )

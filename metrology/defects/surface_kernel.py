"""Compiled evaluation of a plate's reference surface (see `reference`, where the model stands)."""

from __future__ import annotations

import numpy as np

from metrology.jit import kernel

PLAIN = 7
"""Terms of the paraboloid with h²: 1, x, y, x², xy, y², h²."""
_MOST_TERMS = 16


@kernel
def surface_height(u, v, c, waves, by_x, by_y):  # type: ignore[no-untyped-def]
    """Explicit height of the implicit surface h = q(x, y, h) + w(x, y), over the plate's extent.

    Parameters
    ----------
    u, v : float
        Over the plate's extents.
    c : (k,) float64
        Coefficients of the paraboloid's terms, then of the waves'.
    waves : (k − PLAIN, 2) int64
        Degrees in x and y of Legendre polynomials.
    by_x, by_y : (_MOST_TERMS,) float64
        Working space.
    """
    free = c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v
    if waves.shape[0] > 0:
        most = 1
        for k in range(waves.shape[0]):
            most = max(most, waves[k, 0], waves[k, 1])
        by_x[0], by_x[1], by_y[0], by_y[1] = 1.0, u, 1.0, v
        for d in range(2, most + 1):
            by_x[d] = ((2 * d - 1) * u * by_x[d - 1] - (d - 1) * by_x[d - 2]) / d
            by_y[d] = ((2 * d - 1) * v * by_y[d - 1] - (d - 1) * by_y[d - 2]) / d
        for k in range(waves.shape[0]):
            free += c[PLAIN + k] * by_x[waves[k, 0]] * by_y[waves[k, 1]]
    h = free
    for _ in range(5):
        h = free + c[6] * h * h
    return h


@kernel
def surface_heights(x, y, c, waves, out):  # type: ignore[no-untyped-def]
    """`surface_height` at many places: x, y, out (n,) float64."""
    by_x, by_y = np.empty(_MOST_TERMS), np.empty(_MOST_TERMS)
    for n in range(x.shape[0]):
        out[n] = surface_height(x[n], y[n], c, waves, by_x, by_y)


@kernel
def depths(points, member, origin, axes, extents, c, waves, ruled, heights, bin_mm, out):  # type: ignore[no-untyped-def]
    """How far the points of a plate lie below its reference along its normal.

    Parameters
    ----------
    points : (rows, columns, 3) float64
        Rig frame, mm.
    member : (rows, columns) bool
        Which of them are looked at.
    origin, axes : (3,), (3, 3) float64
        The plate's frame.
    extents : (2,) float64
    c, waves
        See `surface_height`.
    ruled : (m, 4) float64
        Direction x, y, start (mm) and number of heights of each profile.
    heights : (m, most) float64
        Of the profiles, mm.
    bin_mm : float
    out : (rows, columns) float64, output
        mm; written for members alone.
    """
    by_x, by_y = np.empty(_MOST_TERMS), np.empty(_MOST_TERMS)
    extent = max(extents[0], extents[1])
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            if not member[i, j]:
                continue
            dx, dy, dz = points[i, j, 0] - origin[0], points[i, j, 1] - origin[1], points[i, j, 2] - origin[2]
            x = axes[0, 0] * dx + axes[0, 1] * dy + axes[0, 2] * dz
            y = axes[1, 0] * dx + axes[1, 1] * dy + axes[1, 2] * dz
            h = axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz
            u, v = x / extents[0], y / extents[1]
            skin = surface_height(u, v, c, waves, by_x, by_y) * extent
            for k in range(ruled.shape[0]):
                place = (x * ruled[k, 0] + y * ruled[k, 1] - ruled[k, 2]) / bin_mm
                place = min(max(place, 0.0), ruled[k, 3] - 1.001)
                low = int(place)
                skin += heights[k, low] + (place - low) * (heights[k, low + 1] - heights[k, low])
            slope_x = (c[1] + 2 * c[3] * u + c[4] * v) * extent / extents[0]
            slope_y = (c[2] + c[4] * u + 2 * c[5] * v) * extent / extents[1]
            out[i, j] = (skin - h) / np.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)

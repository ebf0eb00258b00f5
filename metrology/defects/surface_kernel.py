"""Compiled evaluation of a plate's reference surface (see `reference`, where the model stands)."""

from __future__ import annotations

import numpy as np

from metrology.jit import kernel


@kernel
def surface_height(u, v, powers, bend):  # type: ignore[no-untyped-def]
    """Explicit height of the implicit surface h = p(u, v) + bend h², over the plate's extent.

    Parameters
    ----------
    u, v : float
        Over the plate's extents.
    powers : (d + 1, d + 1) float64
        Of u^i v^j in p; i + j ≤ d.
    bend : float
    """
    degree = powers.shape[0] - 1
    free = 0.0
    for i in range(degree, -1, -1):
        inner = 0.0
        for j in range(degree - i, -1, -1):
            inner = inner * v + powers[i, j]
        free = free * u + inner
    return 2.0 * free / (1.0 + np.sqrt(max(1.0 - 4.0 * bend * free, 0.0)))


@kernel
def surface_heights(x, y, powers, bend, out):  # type: ignore[no-untyped-def]
    """`surface_height` at many places: x, y, out (n,) float64."""
    for n in range(x.shape[0]):
        out[n] = surface_height(x[n], y[n], powers, bend)


@kernel
def depths(points, member, origin, axes, extents, c, powers, ruled, heights, bin_mm, out):  # type: ignore[no-untyped-def]
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
    c : (k,) float64
        Of the paraboloid: 1, x, y, x², xy, y², h², then of the waves.
    powers
        See `surface_height`.
    ruled : (m, 4) float64
        Direction x, y, start (mm) and number of heights of each profile.
    heights : (m, most) float64
        Of the profiles, mm.
    bin_mm : float
    out : (rows, columns) float64, output
        mm; written for members alone.
    """
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
            skin = surface_height(u, v, powers, c[6]) * extent
            for k in range(ruled.shape[0]):
                place = (x * ruled[k, 0] + y * ruled[k, 1] - ruled[k, 2]) / bin_mm
                place = min(max(place, 0.0), ruled[k, 3] - 1.001)
                low = int(place)
                skin += heights[k, low] + (place - low) * (heights[k, low + 1] - heights[k, low])
            slope_x = (c[1] + 2 * c[3] * u + c[4] * v) * extent / extents[0]
            slope_y = (c[2] + c[4] * u + 2 * c[5] * v) * extent / extents[1]
            out[i, j] = (skin - h) / np.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)

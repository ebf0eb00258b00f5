"""Exact epipolar matching of equal projector coordinate, and triangulation on the left camera's raw pixels.

The right view is indexed by (epipolar plane, projector coordinate): a left pixel finds the right pixel that shows the
same projector line on its epipolar plane in one look-up, whatever steps, gaps and shadows lie between. The depth along
the left pixel's viewing ray is then solved for, with the exact lens model, so that a plane fitted to the right
coordinates around that pixel equals the left coordinate: no frame and no phase map is resampled.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import DecodedView, PixelFlag
from metrology.epipolar import epipolar_geometry
from metrology.jit import kernel, over_rows
from metrology.reconstruction_settings import ReconstructionSettings
from metrology.rig import Rig

_EDGE = int(PixelFlag.EDGE)
_UNMATCHED = int(PixelFlag.UNMATCHED)
_SLOPE = int(PixelFlag.SLOPE)

# Fit window, half sizes along and across the epipolar lines.
_ALONG, _ACROSS = 2, 1
# A fit needs this many of its 15 pixels.
_LEAST_PIXELS = 9
# Farthest the solution may lie from the window's centre, pixels along either axis.
_REACH = 1.0
# How far (pixels) the left pixel found from the right one may lie from the start.
_RETURN = 2
# Misfit of the window's plane, in standard deviations, beyond which it spans a jump.
_TORN_SIGMAS = 4.0


def match(
    left: DecodedView, right: DecodedView, rig: Rig, settings: ReconstructionSettings
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint16]]:
    """Points, standard deviation of their z, and flags, on the left camera's raw pixels.

    Returns
    -------
    points : (h, w, 3) float32, mm
    sigma_z : (h, w) float32, mm
    flags : (h, w) uint16
    """
    geometry = epipolar_geometry(rig)
    height, width = left.coordinate.shape
    points = np.empty((height, width, 3), np.float32)
    sigma_z = np.empty((height, width), np.float32)
    flags = np.empty((height, width), np.uint16)
    lowest, bin_size, bins = _bins(right.coordinate)
    right_table = _index(geometry.right.row, right.coordinate, geometry.rows, lowest, bin_size, bins, settings)
    left_table = _index(geometry.left.row, left.coordinate, geometry.rows, lowest, bin_size, bins, settings)
    half_u, half_v = (_ALONG, _ACROSS) if abs(geometry.along[0]) >= abs(geometry.along[1]) else (_ACROSS, _ALONG)
    grid = (np.float32(lowest), np.float32(1 / bin_size))
    window = (half_u, half_v)
    limits = (float(settings.min_slope), *(float(z) for z in settings.depth_range_mm))
    camera = (rig.right.K, rig.right.distortion8, geometry.R, geometry.t)
    views = (left.coordinate, left.sigma, left.flags, right.coordinate, right.sigma, right.flags)
    maps = (geometry.left.xy, geometry.left.row, geometry.right.xy, geometry.right.row)

    def solve(first: int, end: int) -> None:
        tables = (left_table, right_table)
        _match_rows(views, maps, tables, grid, window, camera, limits, first, end, points, sigma_z, flags)

    over_rows(solve, height, settings.threads)
    return points, sigma_z, flags


def _bins(coordinate: NDArray[np.float32]) -> tuple[float, float, int]:
    """Lowest coordinate, size and number of the table's bins: about one pixel of the right camera per bin."""
    sample = coordinate[::8].astype(float)
    finite = sample[np.isfinite(sample)]
    if finite.size < 2:
        return 0.0, 1.0, 1
    rows = np.abs(np.diff(sample, axis=1))
    columns = np.abs(np.diff(coordinate[:, ::8].astype(float), axis=0))
    steps = [float(np.median(d[np.isfinite(d)])) for d in (rows, columns) if np.isfinite(d).any()]
    size = max([0.05, *steps])
    lowest = float(np.floor(np.nanmin(coordinate))) - size
    highest = float(np.nanmax(coordinate))
    return lowest, size, int((highest - lowest) / size) + 2


def _index(
    row: NDArray[np.float32],
    coordinate: NDArray[np.float32],
    rows: int,
    lowest: float,
    size: float,
    bins: int,
    settings: ReconstructionSettings,
) -> NDArray[np.int32]:
    """(rows, bins) table of raw pixel indices, −1 where no pixel has that row and coordinate."""
    table = np.full((rows + 1, bins), -1, np.int32)
    _fill_table(row, coordinate, np.float32(lowest), np.float32(1 / size), table)
    return table


@kernel
def _fill_table(row, coordinate, lowest, per_bin, table):  # type: ignore[no-untyped-def]
    height, width = coordinate.shape
    rows, bins = table.shape
    for y in range(height):
        for x in range(width):
            c = coordinate[y, x]
            if c == c:
                i = int(row[y, x] + np.float32(0.5))
                j = int((c - lowest) * per_bin)
                if 0 <= i < rows and 0 <= j < bins:
                    table[i, j] = y * width + x


@kernel
def _look_up(table, row, position):  # type: ignore[no-untyped-def]
    """Pixel index nearest to (row, bin position): the cell itself or the closest filled neighbour; −1 if none."""
    rows, bins = table.shape
    i = int(row + np.float32(0.5))
    j = int(position)
    if i < 0 or i >= rows or position < 0 or j >= bins:
        return -1
    found = table[i, j]
    if found >= 0:
        return found
    near = j + 1 if position - j > 0.5 else j - 1
    far = 2 * j - near
    other = i + 1 if row > i else i - 1
    for attempt in range(5):
        ii = i if attempt < 2 else other
        jj = near if attempt == 0 or attempt == 3 else (far if attempt == 1 or attempt == 4 else j)
        if 0 <= ii < rows and 0 <= jj < bins and table[ii, jj] >= 0:
            return table[ii, jj]
    return -1


@kernel
def _project(rho, a, t, K, k):  # type: ignore[no-untyped-def]
    """Raw right pixel (u, v) of the point at inverse depth `rho` on the left ray, and its derivatives by `rho`.

    The point is at ``a + rho t`` in the right camera's frame, up to scale; k are OpenCV's eight distortion terms.
    """
    X = a[0] + rho * t[0]
    Y = a[1] + rho * t[1]
    Z = a[2] + rho * t[2]
    inverse = 1.0 / Z
    x = X * inverse
    y = Y * inverse
    dx = (t[0] - x * t[2]) * inverse
    dy = (t[1] - y * t[2]) * inverse
    r2 = x * x + y * y
    dr2 = 2.0 * (x * dx + y * dy)
    top = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    dtop = (k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[4])) * dr2
    bottom = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    dbottom = (k[5] + r2 * (2.0 * k[6] + 3.0 * r2 * k[7])) * dr2
    radial = top / bottom
    dradial = (dtop - radial * dbottom) / bottom
    xd = x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x)
    yd = y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y
    cross = dx * y + x * dy
    dxd = dx * radial + x * dradial + 2.0 * k[2] * cross + k[3] * (dr2 + 4.0 * x * dx)
    dyd = dy * radial + y * dradial + k[2] * (dr2 + 4.0 * y * dy) + 2.0 * k[3] * cross
    u = K[0, 0] * xd + K[0, 1] * yd + K[0, 2]
    v = K[1, 1] * yd + K[1, 2]
    return u, v, K[0, 0] * dxd + K[0, 1] * dyd, K[1, 1] * dyd


@kernel
def _fit_plane(c, u0, v0, half_u, half_v):  # type: ignore[no-untyped-def]
    """Plane ``p0 + p1 (u − u0) + p2 (v − v0)`` through the finite values of a window.

    Returns p0 relative to the centre pixel's value, p1, p2, the elements of the inverse normal matrix
    (i00, i01, i02, i11, i12, i22), the number of pixels and the sum of squared misfits; number 0 where there is no fit.
    """
    centre = c[v0, u0]
    n = 0.0
    su = sv = suu = suv = svv = 0.0
    b0 = b1 = b2 = bb = 0.0
    for dv in range(-half_v, half_v + 1):
        for du in range(-half_u, half_u + 1):
            value = c[v0 + dv, u0 + du] - centre
            if value == value:
                e = float(value)
                n += 1.0
                su += du
                sv += dv
                suu += du * du
                suv += du * dv
                svv += dv * dv
                b0 += e
                b1 += e * du
                b2 += e * dv
                bb += e * e
    m00 = suu * svv - suv * suv
    m01 = suv * sv - su * svv
    m02 = su * suv - suu * sv
    determinant = n * m00 + su * m01 + sv * m02
    if n < _LEAST_PIXELS or determinant <= 1e-9:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    d = 1.0 / determinant
    i00 = m00 * d
    i01 = m01 * d
    i02 = m02 * d
    i11 = (n * svv - sv * sv) * d
    i12 = (su * sv - n * suv) * d
    i22 = (n * suu - su * su) * d
    p0 = i00 * b0 + i01 * b1 + i02 * b2
    p1 = i01 * b0 + i11 * b1 + i12 * b2
    p2 = i02 * b0 + i12 * b1 + i22 * b2
    misfit = max(bb - p0 * b0 - p1 * b1 - p2 * b2, 0.0)
    return p0, p1, p2, i00, i01, i02, i11, i12, i22, n, misfit


@kernel
def _match_rows(views, maps, tables, grid, window, camera, limits, first, end, points, sigma_z, flags):  # type: ignore[no-untyped-def]
    cl, sl, fl, cr, sr, fr = views
    xyl, rowl, xyr, rowr = maps
    left_table, right_table = tables
    lowest, per_bin = grid
    half_u, half_v = window
    K, k, R, t = camera
    min_slope, nearest, farthest = limits
    height, width = cr.shape
    left_width = cl.shape[1]
    nan = np.float32(np.nan)
    for y in range(first, end):
        for x in range(left_width):
            points[y, x, 0] = nan
            points[y, x, 1] = nan
            points[y, x, 2] = nan
            sigma_z[y, x] = nan
            flag = fl[y, x]
            value = cl[y, x]
            if value != value:
                flags[y, x] = flag
                continue
            flags[y, x] = flag | _UNMATCHED
            start = _look_up(right_table, rowl[y, x], (value - lowest) * per_bin)
            if start < 0:
                continue
            v0 = start // width
            u0 = start - v0 * width
            if u0 < half_u or v0 < half_v or u0 >= width - half_u or v0 >= height - half_v:
                continue
            # The left ray in the right camera's frame.
            xl = float(xyl[y, x, 0])
            yl = float(xyl[y, x, 1])
            a = (
                R[0, 0] * xl + R[0, 1] * yl + R[0, 2],
                R[1, 0] * xl + R[1, 1] * yl + R[1, 2],
                R[2, 0] * xl + R[2, 1] * yl + R[2, 2],
            )
            # Inverse depth at which the ray comes closest to the right pixel found: (a + rho t) parallel to (xr, yr, 1).
            xr = float(xyr[v0, u0, 0])
            yr = float(xyr[v0, u0, 1])
            tx = t[0] - xr * t[2]
            ty = t[1] - yr * t[2]
            rho = -((a[0] - xr * a[2]) * tx + (a[1] - yr * a[2]) * ty) / (tx * tx + ty * ty)
            if not rho > 0.0:
                continue
            u, v, du, dv = _project(rho, a, t, K, k)
            # First step with the gradient between direct neighbours, to centre the window on the solution.
            gu = 0.5 * (cr[v0, u0 + 1] - cr[v0, u0 - 1])
            gv = 0.5 * (cr[v0 + 1, u0] - cr[v0 - 1, u0])
            slope = gu * du + gv * dv
            step = (value - cr[v0, u0] - gu * (u - u0) - gv * (v - v0)) / slope
            if step * step * (du * du + dv * dv) <= 16.0:
                rho += step
                u += step * du
                v += step * dv
            uc = int(np.floor(u + 0.5))
            vc = int(np.floor(v + 0.5))
            if uc < half_u or vc < half_v or uc >= width - half_u or vc >= height - half_v:
                continue
            if cr[vc, uc] != cr[vc, uc]:
                uc = u0
                vc = v0
            p0, p1, p2, i00, i01, i02, i11, i12, i22, n, misfit = _fit_plane(cr, uc, vc, half_u, half_v)
            if n == 0.0:
                continue
            variance = float(sr[vc, uc]) ** 2
            u, v, du, dv = _project(rho, a, t, K, k)
            slope = p1 * du + p2 * dv
            # float32 differences of neighbouring values are exact; only differences enter.
            step = (float(value - cr[vc, uc]) - p0 - p1 * (u - uc) - p2 * (v - vc)) / slope
            rho += step
            u += step * du - uc
            v += step * dv - vc
            if not (abs(u) <= _REACH and abs(v) <= _REACH):
                continue
            back = _look_up(left_table, rowr[vc, uc], (cr[vc, uc] - lowest) * per_bin)
            vb = back // left_width
            ub = back - vb * left_width
            if back < 0 or abs(vb - y) > _RETURN or abs(ub - x) > _RETURN:
                continue
            z = 1.0 / rho
            gradient2 = (p1 * p1 + p2 * p2) * (du * du + dv * dv)
            if slope * slope < min_slope * min_slope * gradient2 or not nearest <= z <= farthest:
                flags[y, x] = flag | _SLOPE
                continue
            spread = i00 + i11 * u * u + i22 * v * v + 2.0 * (i01 * u + i02 * v + i12 * u * v)
            total = float(sl[y, x]) ** 2 + variance * spread
            edge = (fr[vc, uc] & _EDGE) | (_EDGE if misfit > variance * (n - 3.0) * _TORN_SIGMAS * _TORN_SIGMAS else 0)
            flags[y, x] = flag | edge
            points[y, x, 0] = xl * z
            points[y, x, 1] = yl * z
            points[y, x, 2] = z
            sigma_z[y, x] = z * z * np.sqrt(total) / abs(slope)

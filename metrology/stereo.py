"""Exact epipolar matching of equal projector coordinate, and triangulation on the left camera's raw pixels.

The right view is indexed by (epipolar plane, projector coordinate): a left pixel finds the right pixel that shows the
same projector line on its epipolar plane in one look-up, whatever steps, gaps and shadows lie between. The depth along
the left pixel's viewing ray is then solved for, with the exact lens model, so that a plane fitted to the right
coordinates around that pixel equals the left coordinate: no frame and no phase map is resampled.

The kernel works through a row in chunks, in turns of scalar loops that look up and gather, and plain arithmetic that
the compiler turns into vector instructions (see `metrology.phase.chunk` on slots and unsigned indices).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from metrology.cloud import DecodedView, PixelFlag
from metrology.epipolar import epipolar_geometry
from metrology.jit import kernel, over_rows
from metrology.reconstruction_settings import ReconstructionSettings
from metrology.rig import Rig
from metrology.window_fit import FitWindow, partial_plane, window_moments

_EDGE = int(PixelFlag.EDGE)
_UNMATCHED = int(PixelFlag.UNMATCHED)
_SLOPE = int(PixelFlag.SLOPE)

# Farthest the solution may lie from the window's centre, pixels along either axis.
_REACH = 1.0
# How far (pixels) the left pixel found from the right one may lie from the start.
_RETURN = 2
# Both reach farther where noise moves coordinates by whole pixels: so many standard deviations, at most so far.
_SLACK_SIGMAS = 4.0
_MOST_SLACK = 16.0
# Misfit of the window's plane, in standard deviations, beyond which it spans a jump.
_TORN_SIGMAS = 4.0
# First steps longer than this (pixels) come from a gradient that is noise.
_LONGEST_STEP = 4.0

_U = np.uintp
_CHUNK = _U(128)
# Left ray in the right camera's frame; coordinate sought; value and slopes of the right window's plane and its centre.
_AX, _AY, _AZ, _WANTED, _PLANE, _PLANE_U, _PLANE_V, _CENTRE_U, _CENTRE_V = (_CHUNK * _U(i) for i in range(9))
# Undistorted position of the start pixel; inverse depth and where it projects to; depth, change of depth with the
# coordinate, and the share of the coordinate's gradient along the epipolar line, squared.
_XR, _YR, _RHO, _PIXEL_U, _PIXEL_V, _DEPTH, _RATE, _SHARE2 = (_CHUNK * _U(i) for i in range(9, 17))
_SLOTS = _CHUNK * _U(17)


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
    shape = (geometry.rows + 1, bins)
    right_table = _index(geometry.right.row, right.coordinate, shape, lowest, bin_size)
    left_table = _index(geometry.left.row, left.coordinate, shape, lowest, bin_size)
    window = FitWindow.along(geometry.along)
    planes = window.planes(right, settings.threads)
    grid = (np.float32(lowest), np.float32(1 / bin_size))
    limits = (float(settings.min_slope), *(float(z) for z in settings.depth_range_mm))
    camera = (rig.with_right().K, rig.with_right().lens, geometry.R, geometry.t)
    views = (left.coordinate, left.sigma, left.flags, right.coordinate, right.sigma, right.flags)
    maps = (geometry.left.xy, geometry.left.row, geometry.right.xy, geometry.right.row)

    out = (points, sigma_z, flags)

    def solve(first: int, end: int) -> None:
        tables = (left_table, right_table)
        halves = (window.half_u, window.half_v)
        _match_rows(views, maps, tables, grid, halves, planes, camera, limits, first, end, out)

    over_rows(solve, height, settings.threads)
    return points, sigma_z, flags


def _bins(coordinate: NDArray[np.float32]) -> tuple[float, float, int]:
    """Lowest coordinate, size and number of the table's bins: about one pixel of the right camera per bin."""
    sample = coordinate[::32].astype(float)
    finite = sample[np.isfinite(sample)]
    if finite.size < 2:
        return 0.0, 1.0, 1
    rows = np.abs(np.diff(sample, axis=1))
    columns = np.abs(np.diff(coordinate[:, ::32].astype(float), axis=0))
    steps = [float(np.median(d[np.isfinite(d)])) for d in (rows, columns) if np.isfinite(d).any()]
    size = max([0.05, *steps])
    # Values beyond the sample's are few; a bin's margin of one in twenty covers them, and those left are unmatched.
    margin = 0.05 * float(np.ptp(finite)) + size
    lowest, highest = float(finite.min()) - margin, float(finite.max()) + margin
    return lowest, size, int((highest - lowest) / size) + 2


def _index(
    row: NDArray[np.float32], coordinate: NDArray[np.float32], shape: tuple[int, int], lowest: float, size: float
) -> NDArray[np.int32]:
    """(rows, bins) table of raw pixels, packed as v·65536 + u; −1 where no pixel has that row and coordinate."""
    table = np.full(shape, -1, np.int32)
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
                    table[i, j] = (y << 16) | x


@njit(inline="always")
def _look_up(table, row, position):  # type: ignore[no-untyped-def]
    """Packed pixel nearest to (row, bin position): the cell itself or the closest filled neighbour; −1 if none."""
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
def _step_towards(m, w, t, focal):  # type: ignore[no-untyped-def]
    """From a start pixel to where the coordinate sought lies on the epipolar line, to first order, without distortion.

    The inverse depth rho is where the left ray a + rho t comes closest to the direction of the start pixel's (x, y, 1).
    """
    for i in range(m):
        x = w[_XR + i]
        y = w[_YR + i]
        tx = t[0] - x * t[2]
        ty = t[1] - y * t[2]
        ax = w[_AX + i] - x * w[_AZ + i]
        ay = w[_AY + i] - y * w[_AZ + i]
        rho = -(ax * tx + ay * ty) / (tx * tx + ty * ty)
        inverse = 1.0 / (w[_AZ + i] + rho * t[2])
        du = focal[0] * tx * inverse
        dv = focal[1] * ty * inverse
        step = (w[_WANTED + i] - w[_PLANE + i]) / (w[_PLANE_U + i] * du + w[_PLANE_V + i] * dv)
        far = step * step * (du * du + dv * dv) > _LONGEST_STEP * _LONGEST_STEP
        step = 0.0 if far else step
        w[_RHO + i] = rho + step
        w[_PIXEL_U + i] = w[_CENTRE_U + i] + step * du
        w[_PIXEL_V + i] = w[_CENTRE_V + i] + step * dv


@kernel
def _solve(m, w, t, K, k):  # type: ignore[no-untyped-def]
    """Newton's step for the inverse depth with the exact projection; pixel relative to the window's centre.

    The point is at a + rho t in the right camera's frame, up to scale; k are OpenCV's distortion terms, twelve. The
    steps before leave half a pixel at most, over which the projection bends by less than 1e-4 pixels.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7]
    s1, s2, s3, s4 = k[8], k[9], k[10], k[11]
    fx, skew, cx, fy, cy = K[0, 0], K[0, 1], K[0, 2], K[1, 1], K[1, 2]
    for i in range(m):
        rho = w[_RHO + i]
        inverse = 1.0 / (w[_AZ + i] + rho * t[2])
        x = (w[_AX + i] + rho * t[0]) * inverse
        y = (w[_AY + i] + rho * t[1]) * inverse
        dx = (t[0] - x * t[2]) * inverse
        dy = (t[1] - y * t[2]) * inverse
        r2 = x * x + y * y
        dr2 = 2.0 * (x * dx + y * dy)
        bottom = 1.0 / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        dbottom = (k4 + r2 * (2.0 * k5 + 3.0 * r2 * k6)) * dr2
        radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) * bottom
        dradial = ((k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)) * dr2 - radial * dbottom) * bottom
        cross = 2.0 * (dx * y + x * dy)
        xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2)
        yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + r2 * s4)
        dxd = dx * radial + x * dradial + p1 * cross + p2 * (dr2 + 4.0 * x * dx) + dr2 * (s1 + 2.0 * r2 * s2)
        dyd = dy * radial + y * dradial + p1 * (dr2 + 4.0 * y * dy) + p2 * cross + dr2 * (s3 + 2.0 * r2 * s4)
        du = fx * dxd + skew * dyd
        dv = fy * dyd
        u = fx * xd + skew * yd + cx - w[_CENTRE_U + i]
        v = fy * yd + cy - w[_CENTRE_V + i]
        along = w[_PLANE_U + i] * du + w[_PLANE_V + i] * dv
        step = (w[_WANTED + i] - w[_PLANE + i] - w[_PLANE_U + i] * u - w[_PLANE_V + i] * v) / along
        rho += step
        depth = 1.0 / rho
        gradient2 = w[_PLANE_U + i] * w[_PLANE_U + i] + w[_PLANE_V + i] * w[_PLANE_V + i]
        w[_RHO + i] = rho
        w[_PIXEL_U + i] = u + step * du
        w[_PIXEL_V + i] = v + step * dv
        w[_DEPTH + i] = depth
        w[_RATE + i] = depth * depth / abs(along)
        w[_SHARE2 + i] = along * along / (gradient2 * (du * du + dv * dv))


@kernel
def _centre_on(i, u, v, coordinate, planes, w):  # type: ignore[no-untyped-def]
    """Take the right window about raw pixel (u, v) for the chunk's i-th pixel."""
    # float32 values differ exactly, so the plane's value stays as good as the differences it came from.
    w[_PLANE + i] = float(coordinate[v, u]) + float(planes[v, u, 0])
    w[_PLANE_U + i] = planes[v, u, 1]
    w[_PLANE_V + i] = planes[v, u, 2]
    w[_CENTRE_U + i] = u
    w[_CENTRE_V + i] = v


@kernel
def _find_starts(y, left, m, views, maps, table, grid, planes, camera, flags, w, start):  # type: ignore[no-untyped-def]
    """Right pixels that show the same coordinate on the same epipolar plane, and the left rays; flags set."""
    cl, _, fl, cr, _, _ = views
    xyl, rowl, xyr, _ = maps
    lowest, per_bin = grid
    _, _, R, _ = camera
    for i in range(m):
        x = left + int(i)
        value = cl[y, x]
        flags[y, x] = fl[y, x]
        start[i] = -1
        w[_WANTED + i] = value
        if value != value:
            continue
        flags[y, x] |= _UNMATCHED
        pixel = _look_up(table, rowl[y, x], (value - lowest) * per_bin)
        v0 = pixel >> 16
        u0 = pixel & 0xFFFF
        if pixel < 0 or planes[v0, u0, 0] != planes[v0, u0, 0]:
            continue
        start[i] = pixel
        _centre_on(i, u0, v0, cr, planes, w)
        xl = float(xyl[y, x, 0])
        yl = float(xyl[y, x, 1])
        w[_AX + i] = R[0, 0] * xl + R[0, 1] * yl + R[0, 2]
        w[_AY + i] = R[1, 0] * xl + R[1, 1] * yl + R[1, 2]
        w[_AZ + i] = R[2, 0] * xl + R[2, 1] * yl + R[2, 2]
        w[_XR + i] = xyr[v0, u0, 0]
        w[_YR + i] = xyr[v0, u0, 1]


@kernel
def _move_centres(m, coordinate, planes, w, start):  # type: ignore[no-untyped-def]
    """Windows about the pixels that the first step leads to."""
    height, width = coordinate.shape
    for i in range(m):
        if start[i] < 0:
            continue
        uc = int(np.floor(w[_PIXEL_U + i] + 0.5))
        vc = int(np.floor(w[_PIXEL_V + i] + 0.5))
        if uc < 0 or vc < 0 or uc >= width or vc >= height:
            start[i] = -1
            continue
        pixel = (vc << 16) | uc
        # Where the better centre has no plane, the start's may still reach far enough.
        if pixel != start[i] and planes[vc, uc, 0] == planes[vc, uc, 0]:
            start[i] = pixel
            _centre_on(i, uc, vc, coordinate, planes, w)


@kernel
def _accept(y, left, m, views, maps, table, grid, window, planes, limits, w, start, out):  # type: ignore[no-untyped-def]
    """Points of those solutions that lie near their window, lead back to their left pixel and are steep enough."""
    _, sl, fl, cr, sr, fr = views
    xyl, _, _, rowr = maps
    lowest, per_bin = grid
    half_u, half_v, per_window, across_u, across_v = window
    min_slope, nearest, farthest = limits
    points, sigma_z, flags = out
    for i in range(m):
        x = left + int(i)
        points[y, x] = np.float32(np.nan)
        sigma_z[y, x] = np.float32(np.nan)
        pixel = start[i]
        u = w[_PIXEL_U + i]
        v = w[_PIXEL_V + i]
        if pixel < 0 or not w[_RHO + i] > 0.0:
            continue
        vc = pixel >> 16
        uc = pixel & 0xFFFF
        left_variance, variance = float(sl[y, x]) ** 2, float(sr[vc, uc]) ** 2
        noise2 = _SLACK_SIGMAS**2 * (left_variance + variance)
        slope2 = w[_PLANE_U + i] ** 2 + w[_PLANE_V + i] ** 2
        slack = 0.0 if noise2 < slope2 else np.floor(min(np.sqrt(noise2 / slope2), _MOST_SLACK))
        reach = _REACH + 0.25 * slack
        if not (abs(u) <= reach and abs(v) <= reach):
            continue
        back = _look_up(table, rowr[vc, uc], (cr[vc, uc] - lowest) * per_bin)
        vb = back >> 16
        ub = back & 0xFFFF
        if back < 0 or abs(vb - y) > _RETURN + slack or abs(ub - x) > _RETURN + slack:
            continue
        flag = fl[y, x]
        z = w[_DEPTH + i]
        if not (w[_SHARE2 + i] >= min_slope * min_slope and nearest <= z <= farthest):
            flags[y, x] = flag | _SLOPE
            continue
        if planes[vc, uc, 3] < np.inf:
            spread = per_window + u * u * across_u + v * v * across_v
        else:
            fit = partial_plane(cr, uc, vc, half_u, half_v)
            spread = fit[3] + fit[6] * u * u + fit[8] * v * v
            spread += 2.0 * (fit[4] * u + fit[5] * v + fit[7] * u * v)
        if planes[vc, uc, 3] > variance * _TORN_SIGMAS * _TORN_SIGMAS:
            flag |= _EDGE
        total = left_variance + variance * spread
        flags[y, x] = flag | (fr[vc, uc] & _EDGE)
        points[y, x, 0] = xyl[y, x, 0] * z
        points[y, x, 1] = xyl[y, x, 1] * z
        points[y, x, 2] = z
        sigma_z[y, x] = w[_RATE + i] * np.sqrt(total)


@kernel
def _match_rows(views, maps, tables, grid, halves, planes, camera, limits, first, end, out):  # type: ignore[no-untyped-def]
    """See the module's text: rows first … end of the left picture, a chunk at a time."""
    coordinate = views[3]
    left_table, right_table = tables
    half_u, half_v = halves
    K, k, _, t = camera
    focal = (K[0, 0], K[1, 1])
    left_width = views[0].shape[1]
    across_u, across_v = window_moments(half_u, half_v)
    window = (half_u, half_v, 1.0 / ((2 * half_u + 1) * (2 * half_v + 1)), across_u, across_v)
    w = np.full(_SLOTS, np.nan)
    start = np.empty(_CHUNK, np.int64)
    for y in range(first, end):
        for left in range(0, left_width, int(_CHUNK)):
            m = _U(min(int(_CHUNK), left_width - left))
            _find_starts(y, left, m, views, maps, right_table, grid, planes, camera, out[2], w, start)
            _step_towards(m, w, t, focal)
            _move_centres(m, coordinate, planes, w, start)
            _solve(m, w, t, K, k)
            _accept(y, left, m, views, maps, left_table, grid, window, planes, limits, w, start, out)

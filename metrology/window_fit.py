"""Planes fitted to a view's projector coordinate in a small window about every pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from metrology.cloud import DecodedView
from metrology.jit import kernel, over_rows

# Half sizes along and across the epipolar lines.
_ALONG, _ACROSS = 2, 1
# A plane through an incomplete window needs this many pixels.
LEAST_PIXELS = 9


@dataclass(frozen=True)
class FitWindow:
    """Half sizes of the window in which a plane is fitted to the right view's coordinate, pixels."""

    half_u: int
    half_v: int

    @classmethod
    def along(cls, direction: NDArray[np.float64]) -> FitWindow:
        """The window that is longer in the epipolar lines' direction (u, v), as noise counts along them."""
        return cls(_ALONG, _ACROSS) if abs(direction[0]) >= abs(direction[1]) else cls(_ACROSS, _ALONG)

    def planes(self, view: DecodedView, threads: int | None) -> NDArray[np.float32]:
        """Plane about every pixel.

        Returns
        -------
        (h, w, 4) float32
            Plane's value at the pixel less the pixel's own; its slopes along u and v, projector pixels per pixel;
            variance of the values about it, projector pixels², infinite where the window is incomplete. NaN where
            there is no plane.
        """
        height, width = view.coordinate.shape
        planes = np.empty((height, width, 4), np.float32)

        def fit(first: int, end: int) -> None:
            _fit_rows(view.coordinate, self.half_u, self.half_v, first, end, planes)

        over_rows(fit, height, threads)
        return planes


@kernel
def partial_plane(c, u0, v0, half_u, half_v):  # type: ignore[no-untyped-def]
    """Plane ``p0 + p1 (u − u0) + p2 (v − v0)`` through the finite values of a window.

    Returns p0 relative to the centre pixel's value, p1, p2, the elements of the inverse normal matrix
    (i00, i01, i02, i11, i12, i22) and the number of pixels; number 0 where there is no fit.
    """
    centre = c[v0, u0]
    n = 0.0
    su = sv = suu = suv = svv = 0.0
    b0 = b1 = b2 = 0.0
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
    m00 = suu * svv - suv * suv
    m01 = suv * sv - su * svv
    m02 = su * suv - suu * sv
    determinant = n * m00 + su * m01 + sv * m02
    if n < LEAST_PIXELS or determinant <= 1e-9:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
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
    return p0, p1, p2, i00, i01, i02, i11, i12, i22, n


@njit(inline="always")
def window_moments(half_u, half_v):  # type: ignore[no-untyped-def]
    """1/Σ du² and 1/Σ dv² over a complete window."""
    nu = 2 * half_u + 1
    nv = 2 * half_v + 1
    sum_u = nv * half_u * (half_u + 1) * nu / 3.0
    sum_v = nu * half_v * (half_v + 1) * nv / 3.0
    return 1.0 / sum_u, 1.0 / sum_v


@kernel
def _add_five(row, centre, fv, s):  # type: ignore[no-untyped-def]
    """Add five neighbours of a row at once to the sums s of values, u-moments, v-moments and squares (4, inner)."""
    inner = centre.size
    a, b, c = row[:inner], row[1 : 1 + inner], row[2 : 2 + inner]
    d, e = row[3 : 3 + inner], row[4 : 4 + inner]
    total, along, across, squares = s[0], s[1], s[2], s[3]
    for x in range(inner):
        m = centre[x]
        va = a[x] - m
        vb = b[x] - m
        vc = c[x] - m
        vd = d[x] - m
        ve = e[x] - m
        sum_of_five = va + vb + vc + vd + ve
        total[x] += sum_of_five
        along[x] += (ve - va) + (ve - va) + (vd - vb)
        across[x] += fv * sum_of_five
        squares[x] += va * va + vb * vb + vc * vc + vd * vd + ve * ve


@kernel
def _fit_rows(c, half_u, half_v, first, end, planes):  # type: ignore[no-untyped-def]
    """Complete windows by plain sums, which a missing value makes NaN; then the incomplete ones."""
    height, width = c.shape
    across_u, across_v = window_moments(half_u, half_v)
    inverse_u = np.float32(across_u)
    inverse_v = np.float32(across_v)
    count = (2 * half_u + 1) * (2 * half_v + 1)
    inverse = np.float32(1.0 / count)
    freedom = np.float32(1.0 / (count - 3))
    zero = np.float32(0)
    inner = width - 2 * half_u
    s = np.empty((4, inner), np.float32)
    for y in range(first, end):
        if y < half_v or y >= height - half_v:
            planes[y] = np.nan
            continue
        planes[y, :half_u] = np.nan
        planes[y, half_u + inner :] = np.nan
        s[:] = zero
        total, along, across, squares = s[0], s[1], s[2], s[3]
        centre = c[y, half_u : half_u + inner]
        for dv in range(-half_v, half_v + 1):
            fv = np.float32(dv)
            if half_u == 2:
                _add_five(c[y + dv], centre, fv, s)
                continue
            for du in range(-half_u, half_u + 1):
                fu = np.float32(du)
                row = c[y + dv, half_u + du : half_u + du + inner]
                for x in range(inner):
                    e = row[x] - centre[x]
                    total[x] += e
                    along[x] += fu * e
                    across[x] += fv * e
                    squares[x] += e * e
        plane = planes[y, half_u : half_u + inner]
        for x in range(inner):
            p1 = along[x] * inverse_u
            p2 = across[x] * inverse_v
            rest = squares[x] - total[x] * total[x] * inverse - p1 * along[x] - p2 * across[x]
            plane[x, 0] = total[x] * inverse
            plane[x, 1] = p1
            plane[x, 2] = p2
            plane[x, 3] = max(rest, zero) * freedom
        for x in range(inner):
            if total[x] != total[x] and centre[x] == centre[x]:
                fit = partial_plane(c, x + half_u, y, half_u, half_v)
                if fit[9] > 0.0:
                    plane[x, 0] = fit[0]
                    plane[x, 1] = fit[1]
                    plane[x, 2] = fit[2]
                    plane[x, 3] = np.inf

"""Fused kernels: fringe frames of one camera to projector coordinate, its standard deviation, modulation and texture.

For each count the sinusoid ``I_i = A + B cos(φ + 2π(i−1)/N)`` is fitted as a phasor ``B e^{jφ}`` (paper eq 4 for N = 4),
exposures are added by inverse variance, wrapped phases are unwrapped and fused. All in one pass over the frames, row by
row, so that what passes between the stages stays in the processor's cache.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from metrology.cloud import PixelFlag
from metrology.jit import kernel

_SATURATED = int(PixelFlag.SATURATED)
_LOW_MODULATION = int(PixelFlag.LOW_MODULATION)
_ORDER_RESIDUAL = int(PixelFlag.ORDER_RESIDUAL)
_SATURATED_SAMPLES = int(PixelFlag.SATURATED_SAMPLES)

_TURN = np.float32(2 * np.pi)
_F0, _F1, _HALF, _QUARTER = np.float32(0), np.float32(1), np.float32(0.5), np.float32(0.25)
_TINY = np.float32(1e-12)
# Least-maximum-error odd polynomial of atan(t)/2π on [0, 1]; error below 6e-9 turns before rounding.
_ATAN = tuple(
    np.float32(a)
    for a in (
        0.1591548373, -0.05304612096, 0.03174594521, -0.02213627143,
        0.01534603364, -0.008898723142, 0.003479597787, -0.0006453044062,
    )
)  # fmt: skip
# A fit from unsaturated samples counts if its normal matrix is at least this far from singular, relative to a full one.
_LEAST_DETERMINANT = 0.02


@njit(inline="always")
def _turns(s, c):  # type: ignore[no-untyped-def]
    """atan2(s, c)/2π in [0, 1) without branches; float32."""
    a = abs(s)
    b = abs(c)
    t = min(a, b) / max(max(a, b), _TINY)
    u = t * t
    p = _ATAN[7]
    p = p * u + _ATAN[6]
    p = p * u + _ATAN[5]
    p = p * u + _ATAN[4]
    p = p * u + _ATAN[3]
    p = p * u + _ATAN[2]
    p = p * u + _ATAN[1]
    p = p * u + _ATAN[0]
    r = p * t
    r = _QUARTER - r if a > b else r
    r = _HALF - r if c < _F0 else r
    return _F1 - r if s < _F0 else r


@kernel
def _sums(frames, first_frame, row, cosines, sines, c, s, total, peak):  # type: ignore[no-untyped-def]
    """Phasor (×N/2), sum and largest sample of one count of one exposure, for a row."""
    width = frames.shape[2]
    n = cosines.size
    if n == 4:
        i1 = frames[first_frame, row]
        i2 = frames[first_frame + 1, row]
        i3 = frames[first_frame + 2, row]
        i4 = frames[first_frame + 3, row]
        for x in range(width):
            a1 = np.int32(i1[x])
            a2 = np.int32(i2[x])
            a3 = np.int32(i3[x])
            a4 = np.int32(i4[x])
            c[x] = np.float32(a1 - a3)
            s[x] = np.float32(a4 - a2)
            total[x] = np.float32(a1 + a2 + a3 + a4)
            peak[x] = np.float32(max(max(a1, a2), max(a3, a4)))
        return
    c[:] = _F0
    s[:] = _F0
    total[:] = _F0
    peak[:] = _F0
    for j in range(n):
        samples = frames[first_frame + j, row]
        cosine = cosines[j]
        sine = sines[j]
        for x in range(width):
            value = np.float32(samples[x])
            c[x] += value * cosine
            s[x] -= value * sine
            total[x] += value
            peak[x] = max(peak[x], value)


@kernel
def _solve_unsaturated(frames, k, row, x, exposures, cosines, sines, saturation, read, gain):  # type: ignore[no-untyped-def]
    """Phasor of one pixel from its unsaturated samples of all exposures, each exposure with an offset of its own.

    Returns C, S (grey levels at exposure 1), the information 1/var of the component across the phasor (which is what
    the phase depends on), the mean level and its weight; all 0 where the samples do not determine the phasor.
    """
    n = cosines.size
    m00 = 0.0
    m01 = 0.0
    m11 = 0.0
    r0 = 0.0
    r1 = 0.0
    for e in range(exposures.size):
        time = exposures[e]
        used = 0
        mean = 0.0
        mean_c = 0.0
        mean_s = 0.0
        for j in range(n):
            value = float(frames[e, k * n + j, row, x])
            if value < saturation:
                used += 1
                mean += value
                mean_c += cosines[j]
                mean_s -= sines[j]
        if used < 2:
            continue
        mean /= used
        mean_c /= used
        mean_s /= used
        weight = 1.0 / (read + gain * mean)
        for j in range(n):
            value = float(frames[e, k * n + j, row, x])
            if value < saturation:
                dc = cosines[j] - mean_c
                ds = -sines[j] - mean_s
                m00 += weight * time * time * dc * dc
                m01 += weight * time * time * dc * ds
                m11 += weight * time * time * ds * ds
                r0 += weight * time * dc * (value - mean)
                r1 += weight * time * ds * (value - mean)
    determinant = m00 * m11 - m01 * m01
    trace = m00 + m11
    if trace <= 0.0 or determinant < _LEAST_DETERMINANT * trace * trace:
        return 0.0, 0.0, 0.0
    c = (m11 * r0 - m01 * r1) / determinant
    s = (m00 * r1 - m01 * r0) / determinant
    # var(φ)·B² = nᵀ M⁻¹ n with n = (−sin φ, cos φ) across the phasor.
    across = (m11 * s * s + 2.0 * m01 * s * c + m00 * c * c) / determinant
    return c, s, (c * c + s * s) / max(across, 1e-12)


@kernel
def _fit_row(frames, row, exposures, cosines, sines, saturation, read, gain, c, s, info, texture, flags, work):  # type: ignore[no-untyped-def]
    """Phasors (n_counts, w), their information 1/var, the mean level and the saturation flags of one row."""
    n_counts, width = c.shape
    n = cosines.size
    step_info = np.float32(0.5 * n)
    per_sample = np.float32(1.0 / n)
    e_c, e_s, e_total, e_peak, texture_info, partial = work
    single = exposures.size == 1
    texture[:] = _F0
    texture_info[:] = _F0
    partial[:] = _F0
    limit = np.float32(saturation)
    read32 = np.float32(read)
    gain32 = np.float32(gain)
    for k in range(n_counts):
        for e in range(exposures.size):
            time = np.float32(exposures[e])
            _sums(frames[e], k * n, row, cosines, sines, e_c, e_s, e_total, e_peak)
            scale = _F1 / (step_info * time)
            first = e == 0
            for x in range(width):
                mean = e_total[x] * per_sample
                weight = time * time / (read32 + gain32 * mean)
                good = e_peak[x] < limit
                partial[x] = partial[x] if good else _F1
                weight = weight if good else _F0
                texture[x] += weight * mean / time
                texture_info[x] += weight
                if single:
                    c[k, x] = scale * e_c[x]
                    s[k, x] = scale * e_s[x]
                    info[k, x] = weight * step_info
                else:
                    held = _F0 if first else info[k, x]
                    c[k, x] = (_F0 if first else c[k, x]) + weight * scale * e_c[x]
                    s[k, x] = (_F0 if first else s[k, x]) + weight * scale * e_s[x]
                    info[k, x] = held + weight
        if not single:
            for x in range(width):
                inverse = _F1 / max(info[k, x], _TINY)
                c[k, x] *= inverse
                s[k, x] *= inverse
                info[k, x] *= step_info
    for x in range(width):
        texture[x] /= max(texture_info[x], _TINY)
        flags[x] = 0
        if partial[x] > _F0:
            flags[x] = _SATURATED_SAMPLES
    if not partial.any():
        return
    for x in range(width):
        if partial[x] > _F0:
            if texture_info[x] == _F0:
                texture[x] = _clipped_texture(frames, row, x, exposures)
            for k in range(n_counts):
                solved = _solve_unsaturated(frames, k, row, x, exposures, cosines, sines, saturation, read, gain)
                c[k, x] = solved[0]
                s[k, x] = solved[1]
                info[k, x] = solved[2]
                if solved[2] == 0.0:
                    flags[x] |= _SATURATED


@kernel
def _clipped_texture(frames, row, x, exposures):  # type: ignore[no-untyped-def]
    """Mean of all samples of the shortest exposure, scaled to exposure 1: a lower bound where every exposure clips."""
    shortest = np.argmin(exposures)
    total = 0.0
    for j in range(frames.shape[1]):
        total += frames[shortest, j, row, x]
    return total / (frames.shape[1] * exposures[shortest])


@kernel
def _lattice_row(q, basis, to_lattice, gram):  # type: ignore[no-untyped-def]
    """Take the nearest wrap-count lattice point off the wrapped phases q (n, w), in turns, in place.

    What is left is, but for noise, a multiple of the count vector. Rounding the lattice coordinates and trying the other
    corners of the cell finds the nearest point (exactly in one and two dimensions with a reduced basis).
    """
    n, width = q.shape
    m = n - 1
    if m == 2:
        _lattice_row_3(q, basis, to_lattice, gram)
        return
    near = np.empty(m, np.float32)
    off = np.empty(m, np.float32)
    for x in range(width):
        for i in range(m):
            t = _F0
            for k in range(n):
                t += to_lattice[i, k] * q[k, x]
            near[i] = np.rint(t)
            off[i] = t - near[i]
        best = np.float32(np.inf)
        chosen = 0
        for corner in range(1 << m):
            distance = _F0
            for i in range(m):
                di = off[i] - (np.copysign(_F1, off[i]) if (corner >> i) & 1 else _F0)
                for j in range(m):
                    dj = off[j] - (np.copysign(_F1, off[j]) if (corner >> j) & 1 else _F0)
                    distance += gram[i, j] * di * dj
            if distance < best:
                best = distance
                chosen = corner
        for i in range(m):
            step = near[i] + (np.copysign(_F1, off[i]) if (chosen >> i) & 1 else _F0)
            for k in range(n):
                q[k, x] -= basis[k, i] * step


@kernel
def _lattice_row_3(q, basis, to_lattice, gram):  # type: ignore[no-untyped-def]
    """`_lattice_row` for three counts, written out so that it runs in the processor's vector units."""
    d00, d01, d02 = to_lattice[0, 0], to_lattice[0, 1], to_lattice[0, 2]
    d10, d11, d12 = to_lattice[1, 0], to_lattice[1, 1], to_lattice[1, 2]
    b00, b10, b20 = basis[0, 0], basis[1, 0], basis[2, 0]
    b01, b11, b21 = basis[0, 1], basis[1, 1], basis[2, 1]
    g00 = gram[0, 0]
    g01 = np.float32(2) * gram[0, 1]
    g11 = gram[1, 1]
    q0, q1, q2 = q[0], q[1], q[2]
    for x in range(q.shape[1]):
        t0 = d00 * q0[x] + d01 * q1[x] + d02 * q2[x]
        t1 = d10 * q0[x] + d11 * q1[x] + d12 * q2[x]
        n0 = np.rint(t0)
        n1 = np.rint(t1)
        u = t0 - n0
        v = t1 - n1
        su = _F1 if u >= _F0 else -_F1
        sv = _F1 if v >= _F0 else -_F1
        uu = u - su
        vv = v - sv
        here = g00 * u * u + g01 * u * v + g11 * v * v
        along = g00 * uu * uu + g01 * uu * v + g11 * v * v
        aside = g00 * u * u + g01 * u * vv + g11 * vv * vv
        both = g00 * uu * uu + g01 * uu * vv + g11 * vv * vv
        step_u = min(along, both) < min(here, aside)
        step_v = min(aside, both) < min(here, along)
        n0 = n0 + su if step_u else n0
        n1 = n1 + sv if step_v else n1
        q0[x] -= b00 * n0 + b01 * n1
        q1[x] -= b10 * n0 + b11 * n1
        q2[x] -= b20 * n0 + b21 * n1


@kernel
def _heterodyne_row(q, counts, beats):  # type: ignore[no-untyped-def]
    """Unwrap the phases q (n, w), in turns, in place, from the coarsest beat down (multi-frequency heterodyne)."""
    n, width = q.shape
    level = np.empty(n, np.float32)
    first = np.empty(n, np.float32)
    for x in range(width):
        for k in range(n):
            level[k] = q[k, x]
        first[0] = level[0]
        for depth in range(1, n):
            for k in range(n - depth):
                beat = level[k] - level[k + 1]
                level[k] = beat - np.floor(beat)
            first[depth] = level[0]
        position = first[n - 1] * beats[n - 1]
        position -= np.floor(position)
        for depth in range(n - 2, -1, -1):
            wraps = np.rint(beats[depth] * position - first[depth])
            position = (first[depth] + wraps) / beats[depth]
        for k in range(n):
            q[k, x] += np.rint(counts[k] * position - q[k, x])


@kernel
def _fuse_row(q, c, s, info, counts, size, snr2, least2, chi2, far2, coordinate, sigma, modulation, flags, work):  # type: ignore[no-untyped-def]
    """Maximum-likelihood position from the unwrapped phases q (n, w), weights ∝ (N·B)²/var; flags of what failed.

    A pixel fails as ORDER_RESIDUAL where its phases miss a common position by far more than noise explains
    (chi2, far2 = chi-square limit and squared distance in turns²), or by nearly half a lattice step (far2[1]).
    """
    n, width = q.shape
    top, bottom, amplitude2, weakest, misfit, distance = work
    top[:] = _F0
    bottom[:] = _TINY
    amplitude2[:] = _F0
    weakest[:] = np.float32(np.inf)
    misfit[:] = _F0
    distance[:] = _F0
    for k in range(n):
        f = counts[k]
        for x in range(width):
            b2 = c[k, x] * c[k, x] + s[k, x] * s[k, x]
            snr = b2 * info[k, x]
            top[x] += snr * f * q[k, x]
            bottom[x] += snr * f * f
            amplitude2[x] += b2
            weakest[x] = min(weakest[x], snr)
            c[k, x] = snr
    for x in range(width):
        top[x] /= bottom[x]
    for k in range(n):
        f = counts[k]
        for x in range(width):
            e = q[k, x] - f * top[x]
            misfit[x] += c[k, x] * e * e
            distance[x] += e * e
    per_count = _F1 / np.float32(n)
    scale = size / _TURN
    nan = np.float32(np.nan)
    for x in range(width):
        b2 = amplitude2[x] * per_count
        faint = (weakest[x] < snr2) | (b2 < least2)
        torn = ((misfit[x] * (_TURN * _TURN) > chi2) & (distance[x] > far2[0])) | (distance[x] > far2[1])
        bits = np.uint16(_LOW_MODULATION if faint else 0)
        bits |= np.uint16(_ORDER_RESIDUAL if torn & (not faint) else 0)
        flags[x] |= bits
        good = not (faint | torn)
        modulation[x] = np.sqrt(b2)
        position = top[x] - np.floor(top[x])
        coordinate[x] = position * size - _HALF if good else nan
        sigma[x] = scale / np.sqrt(bottom[x]) if good else nan


@kernel
def decode_rows(frames, exposures, cosines, sines, sensor, unwrap, limits, size, first, end, out):  # type: ignore[no-untyped-def]
    """Decode rows first … end − 1.

    Parameters
    ----------
    frames : (exposures, n·steps, h, w) uint8 or uint16
    exposures : (exposures,) float64, relative exposure times
    cosines, sines : (steps,) float32 of the phase steps
    sensor : (saturation, read variance, gain), floats in grey levels
    unwrap : (heterodyne?, counts, beats, basis, to_lattice, gram), arrays float32
    limits : (least squared signal-to-noise, least squared modulation, chi-square limit, (2,) squared distances)
    size : float, projector pixels along the fringe axis
    out : (coordinate, sigma, modulation, texture, flags), arrays (h, w)
    """
    saturation, read, gain = sensor
    heterodyne, counts, beats, basis, to_lattice, gram = unwrap
    snr2, least2, chi2, far2 = limits
    coordinate, sigma, modulation, texture, flags = out
    width = frames.shape[3]
    n = counts.size
    c = np.empty((n, width), np.float32)
    s = np.empty((n, width), np.float32)
    info = np.empty((n, width), np.float32)
    q = np.empty((n, width), np.float32)
    w = np.empty((6, width), np.float32)
    work = (w[0], w[1], w[2], w[3], w[4], w[5])
    row_flags = np.empty(width, np.uint16)
    for row in range(first, end):
        _fit_row(
            frames, row, exposures, cosines, sines, saturation, read, gain,
            c, s, info, texture[row], row_flags, work,
        )  # fmt: skip
        for k in range(n):
            for x in range(width):
                q[k, x] = _turns(s[k, x], c[k, x])
        if heterodyne:
            _heterodyne_row(q, counts, beats)
        else:
            _lattice_row(q, basis, to_lattice, gram)
        _fuse_row(
            q, c, s, info, counts, size, snr2, least2, chi2, far2,
            coordinate[row], sigma[row], modulation[row], row_flags, work,
        )  # fmt: skip
        flags[row] = row_flags

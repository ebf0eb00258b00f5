"""Fused kernels: fringe frames of one camera to projector coordinate, its standard deviation, modulation and texture.

For each count the sinusoid ``I_i = A + B cos(φ + 2π(i−1)/N)`` is fitted as a phasor ``B e^{jφ}`` (paper eq 4 for
N = 4), exposures are added by inverse variance, wrapped phases are unwrapped and fused: one pass over the frames, in
chunks of a row whose intermediate values stay in the processor's first cache.

The usual scan (three counts of four steps, one exposure) has a kernel of its own that keeps everything in registers.
In the general one all intermediate values of a chunk lie in one scratch array, each in a slot of
`_CHUNK` pixels: first the slots of the whole pixel, then a block of slots for every fringe count, at last a block for
the exposure at hand.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from metrology.cloud import PixelFlag
from metrology.jit import kernel

_SATURATED = int(PixelFlag.SATURATED)
_LOW_MODULATION = int(PixelFlag.LOW_MODULATION)
_ORDER_RESIDUAL = int(PixelFlag.ORDER_RESIDUAL)
_SATURATED_SAMPLES = int(PixelFlag.SATURATED_SAMPLES)

LATTICE, HETERODYNE, COARSE = range(3)


class StepTables(NamedTuple):
    """What the frames of every count show.

    Attributes
    ----------
    first : (n + 1,) int64
        First frame of each of n counts, and the end of the last one.
    cosines, sines : (fringe frames,) float32
        Of the phase steps.
    offsets : (n,) float32
        Phase offset of each count, turns.
    """

    first: NDArray[np.int64]
    cosines: NDArray[np.float32]
    sines: NDArray[np.float32]
    offsets: NDArray[np.float32]


# Pixels per chunk: with three counts the 33 slots take 33 kB. Sizes and indices are unsigned: a negative index would
# count from the end, and to look for one keeps the compiler from using vectors.
_U = np.uintp
_CHUNK = _U(256)
# Slots of the whole pixel …
_TEXTURE, _TEXTURE_INFO, _PARTIAL, _TOP, _BOTTOM, _POWER, _WEAKEST, _MISFIT, _DISTANCE = (
    _CHUNK * _U(slot) for slot in range(9)
)
_FRONT = _CHUNK * _U(9)
# … and those of a count's block: phasor, its information 1/var, phase in turns, sum and largest of the samples.
_C, _S, _INFO, _Q, _SUM, _PEAK = (_CHUNK * _U(slot) for slot in range(6))
_BLOCK = _CHUNK * _U(6)

_TURN = np.float32(2 * np.pi)
_F0, _F1, _TWO = np.float32(0), np.float32(1), np.float32(2)
_HALF, _QUARTER = np.float32(0.5), np.float32(0.25)
_TINY = np.float32(1e-12)
_INFINITE = np.float32(np.inf)
_NAN = np.float32(np.nan)
# Least-maximum-error odd polynomial of atan(t)/2π on [0, 1]; error below 4e-8 turns before rounding.
_ATAN = tuple(
    np.float32(a)
    for a in (
        0.1591543242, -0.05302623816, 0.03152511756, -0.02106151798,
        0.01267250087, -0.005348277659, 0.001084130523,
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
    p = _ATAN[6]
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


@njit(inline="always")
def _unwrap_three(q0, q1, q2, lattice):  # type: ignore[no-untyped-def]
    """Three wrapped phases in turns less the nearest wrap-count lattice point.

    What is left is, but for noise, a multiple of the count vector.
    Rounding the lattice coordinates and trying the other corners of the cell finds the nearest point exactly.
    """
    d00, d01, d02, d10, d11, d12, b00, b01, b10, b11, b20, b21, g00, g01, g11 = lattice
    t0 = d00 * q0 + d01 * q1 + d02 * q2
    t1 = d10 * q0 + d11 * q1 + d12 * q2
    n0 = np.rint(t0)
    n1 = np.rint(t1)
    u = t0 - n0
    v = t1 - n1
    su = _F1 if u >= _F0 else -_F1
    sv = _F1 if v >= _F0 else -_F1
    # Squared distance of the cell's other corners less that of the rounded one.
    along = g00 * (_F1 - _TWO * abs(u)) - g01 * v * su
    aside = g11 * (_F1 - _TWO * abs(v)) - g01 * u * sv
    both = along + aside + g01 * su * sv
    n0 = n0 + su if min(along, both) < min(_F0, aside) else n0
    n1 = n1 + sv if min(aside, both) < min(_F0, along) else n1
    return q0 - b00 * n0 - b01 * n1, q1 - b10 * n0 - b11 * n1, q2 - b20 * n0 - b21 * n1


@njit(inline="always")
def _numbers_of_three(lattice):  # type: ignore[no-untyped-def]
    """The lattice's arrays as plain numbers, which stay in registers."""
    basis, to_lattice, gram = lattice
    return (
        to_lattice[0, 0], to_lattice[0, 1], to_lattice[0, 2], to_lattice[1, 0], to_lattice[1, 1], to_lattice[1, 2],
        basis[0, 0], basis[0, 1], basis[1, 0], basis[1, 1], basis[2, 0], basis[2, 1],
        gram[0, 0], gram[0, 1] + gram[1, 0], gram[1, 1],
    )  # fmt: skip


@kernel
def _decode_usual(frames, exposure, sensor, counts, lattice, limits, size, first, end, out, mend):  # type: ignore[no-untyped-def]
    """Three counts of four steps, one exposure; `mend` (h,) becomes True for rows with a saturated sample.

    A sample is ``I_i = r [a cos(φ + (i−1)π/2) + b + b₁]`` (paper eqs 2 and 3), so that per count
    ``φ = atan2(I₄ − I₂, I₁ − I₃)`` (eq 4), whatever reflectivity r and ambient light b₁ are.
    """
    saturation, read, gain = sensor
    snr2, least2, chi2, far2, torn2 = limits
    coordinates, sigmas, modulations, textures, flagses = out
    f0, f1, f2 = counts[0], counts[1], counts[2]
    three = _numbers_of_three(lattice)
    read32 = np.float32(read)
    gain32 = np.float32(gain)
    scale = size / _TURN
    chi2_turns = chi2 / (_TURN * _TURN)
    # The phasors stay doubled (differences of samples): twice the variance of a sample each, power four times B².
    least_power = np.float32(12) * least2 * np.float32(exposure * exposure)
    to_modulation = np.float32(np.sqrt(1.0 / 12.0) / exposure)
    to_texture = np.float32(1.0 / exposure)
    per_sample = np.float32(1.0 / 12.0)
    limit = np.int32(np.ceil(saturation))
    for row in range(first, end):
        a1, a2, a3, a4 = frames[0, row], frames[1, row], frames[2, row], frames[3, row]
        b1, b2, b3, b4 = frames[4, row], frames[5, row], frames[6, row], frames[7, row]
        c1, c2, c3, c4 = frames[8, row], frames[9, row], frames[10, row], frames[11, row]
        coordinate, sigma, flags = coordinates[row], sigmas[row], flagses[row]
        modulation, texture = modulations[row], textures[row]
        for x in range(frames.shape[2]):
            i1, i2, i3, i4 = np.int32(a1[x]), np.int32(a2[x]), np.int32(a3[x]), np.int32(a4[x])
            j1, j2, j3, j4 = np.int32(b1[x]), np.int32(b2[x]), np.int32(b3[x]), np.int32(b4[x])
            k1, k2, k3, k4 = np.int32(c1[x]), np.int32(c2[x]), np.int32(c3[x]), np.int32(c4[x])
            peak = max(max(max(i1, i2), max(i3, i4)), max(max(j1, j2), max(j3, j4)))
            peak = max(peak, max(max(k1, k2), max(k3, k4)))
            mean = np.float32((i1 + i2 + i3 + i4) + (j1 + j2 + j3 + j4) + (k1 + k2 + k3 + k4)) * per_sample
            # Numerator and denominator of eq 4, for each count; `_turns` is its arc tangent.
            ca, sa = np.float32(i1 - i3), np.float32(i4 - i2)
            cb, sb = np.float32(j1 - j3), np.float32(j4 - j2)
            cc, sc = np.float32(k1 - k3), np.float32(k4 - k2)
            q0, q1, q2 = _unwrap_three(_turns(sa, ca), _turns(sb, cb), _turns(sc, cc), three)
            power0 = ca * ca + sa * sa
            power1 = cb * cb + sb * sb
            power2 = cc * cc + sc * sc
            weight0 = power0 * f0
            weight1 = power1 * f1
            weight2 = power2 * f2
            bottom = weight0 * f0 + weight1 * f1 + weight2 * f2 + _TINY
            position = (weight0 * q0 + weight1 * q1 + weight2 * q2) / bottom
            e0 = q0 - f0 * position
            e1 = q1 - f1 * position
            e2 = q2 - f2 * position
            distance = e0 * e0 + e1 * e1 + e2 * e2
            misfit = power0 * e0 * e0 + power1 * e1 * e1 + power2 * e2 * e2
            variance = np.float32(2) * (read32 + gain32 * mean)
            power = power0 + power1 + power2
            faint = (min(min(power0, power1), power2) < snr2 * variance) | (power < least_power)
            torn = ((misfit > chi2_turns * variance) & (distance > far2)) | (distance > torn2)
            bad = faint | torn
            coordinate[x] = _NAN if bad else (position - np.floor(position)) * size - _HALF
            sigma[x] = _NAN if bad else scale * np.sqrt(variance / bottom)
            modulation[x] = to_modulation * np.sqrt(power)
            texture[x] = to_texture * mean
            why = np.int32((_LOW_MODULATION if faint else _ORDER_RESIDUAL) if bad else 0)
            flags[x] = np.uint16(why | np.int32(_SATURATED_SAMPLES if peak >= limit else 0))
        saturated = np.uint16(0)
        for x in range(frames.shape[2]):
            saturated |= flags[x]
        mend[row] = saturated & _SATURATED_SAMPLES != 0


@kernel
def _sums(frames, first_frame, n, row, left, m, cosines, sines, w, block):  # type: ignore[no-untyped-def]
    """Phasor (×N/2), sum and largest sample of one count of one exposure into a block of the scratch array."""
    right = left + int(m)
    if n == 4:
        i1 = frames[first_frame, row, left:right]
        i2 = frames[first_frame + 1, row, left:right]
        i3 = frames[first_frame + 2, row, left:right]
        i4 = frames[first_frame + 3, row, left:right]
        for x in range(m):
            a1 = np.int32(i1[x])
            a2 = np.int32(i2[x])
            a3 = np.int32(i3[x])
            a4 = np.int32(i4[x])
            w[block + _C + x] = np.float32(a1 - a3)
            w[block + _S + x] = np.float32(a4 - a2)
            w[block + _SUM + x] = np.float32(a1 + a2 + a3 + a4)
            w[block + _PEAK + x] = np.float32(max(max(a1, a2), max(a3, a4)))
        return
    for j in range(n):
        samples = frames[first_frame + j, row, left:right]
        cosine = cosines[first_frame + j]
        sine = sines[first_frame + j]
        # The first step starts the sums.
        keep = _F0 if j == 0 else _F1
        if j == 0:
            w[block : block + _BLOCK] = _F0
        for x in range(m):
            value = np.float32(samples[x])
            w[block + _C + x] = keep * w[block + _C + x] + value * cosine
            w[block + _S + x] = keep * w[block + _S + x] - value * sine
            w[block + _SUM + x] = keep * w[block + _SUM + x] + value
            w[block + _PEAK + x] = max(keep * w[block + _PEAK + x], value)


@kernel
def _add_unsaturated(frames, begin, end, row, x, exposures, cosines, sines, sensor, c, s, info):  # type: ignore[no-untyped-def]
    """Add to one pixel's phasor the unsaturated samples of those exposures that have saturated ones as well.

    Each exposure has an offset of its own. Takes the phasor (c, s) and its information 1/var from the whole exposures
    and returns them anew; the information is that of the component across the phasor, which the phase depends on;
    0 where the samples do not determine the phasor.
    """
    saturation, read, gain = sensor
    n = end - begin
    m00 = info
    m01 = 0.0
    m11 = info
    r0 = info * c
    r1 = info * s
    for e in range(exposures.size):
        time = exposures[e]
        used = 0
        mean = 0.0
        mean_c = 0.0
        mean_s = 0.0
        for j in range(begin, end):
            value = float(frames[e, j, row, x])
            if value < saturation:
                used += 1
                mean += value
                mean_c += cosines[j]
                mean_s -= sines[j]
        if used < 2 or used == n:
            continue
        mean /= used
        mean_c /= used
        mean_s /= used
        weight = time / (read + gain * mean)
        for j in range(begin, end):
            value = float(frames[e, j, row, x])
            if value < saturation:
                dc = cosines[j] - mean_c
                ds = -sines[j] - mean_s
                m00 += weight * time * dc * dc
                m01 += weight * time * dc * ds
                m11 += weight * time * ds * ds
                r0 += weight * dc * (value - mean)
                r1 += weight * ds * (value - mean)
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
def _fit_exposures(frames, row, left, m, n_counts, exposures, steps, sensor, w):  # type: ignore[no-untyped-def]
    """Phasors, their information 1/var and the mean level of a chunk; True if a sample of it is saturated.

    A count's exposures are added by inverse variance, those left out in which one of its samples is saturated.
    """
    saturation, read, gain = sensor
    limit = np.float32(saturation)
    read32 = np.float32(read)
    gain32 = np.float32(gain)
    spare = _FRONT + _U(n_counts) * _BLOCK
    w[:spare] = _F0
    some_partial = 0
    for k in range(n_counts):
        block = _FRONT + _U(k) * _BLOCK
        n = steps.first[k + 1] - steps.first[k]
        step_info = np.float32(0.5 * n)
        per_sample = np.float32(1.0 / n)
        for e in range(exposures.size):
            time = np.float32(exposures[e])
            inverse_time = _F1 / time
            scale = inverse_time / step_info
            _sums(frames[e], steps.first[k], n, row, left, m, steps.cosines, steps.sines, w, spare)
            for x in range(m):
                mean = w[spare + _SUM + x] * per_sample
                good = w[spare + _PEAK + x] < limit
                weight = time * time / (read32 + gain32 * mean) if good else _F0
                partial = _F0 if good else _F1
                some_partial += np.int32(partial)
                w[_PARTIAL + x] = max(w[_PARTIAL + x], partial)
                w[_TEXTURE + x] += weight * mean * inverse_time
                w[_TEXTURE_INFO + x] += weight
                w[spare + _INFO + x] = weight
            for x in range(m):
                weight = w[spare + _INFO + x]
                w[block + _C + x] += weight * scale * w[spare + _C + x]
                w[block + _S + x] += weight * scale * w[spare + _S + x]
                w[block + _INFO + x] += weight
        for x in range(m):
            inverse = _F1 / max(w[block + _INFO + x], _TINY)
            w[block + _C + x] *= inverse
            w[block + _S + x] *= inverse
            w[block + _INFO + x] *= step_info
    for x in range(m):
        w[_TEXTURE + x] /= max(w[_TEXTURE_INFO + x], _TINY)
    return some_partial > 0


@kernel
def _mend_saturated(frames, row, left, m, n_counts, exposures, steps, sensor, w, flags):  # type: ignore[no-untyped-def]
    """Use what unsaturated samples there are beside saturated ones, and set the flags."""
    for x in range(m):
        if w[_PARTIAL + x] == _F0:
            continue
        flags[x] |= _SATURATED_SAMPLES
        if w[_TEXTURE_INFO + x] == _F0:
            w[_TEXTURE + x] = _clipped_texture(frames, row, left + int(x), exposures)
        for k in range(n_counts):
            block = _FRONT + _U(k) * _BLOCK
            solved = _add_unsaturated(
                frames, steps.first[k], steps.first[k + 1], row, left + int(x), exposures,
                steps.cosines, steps.sines, sensor,
                float(w[block + _C + x]), float(w[block + _S + x]), float(w[block + _INFO + x]),
            )  # fmt: skip
            w[block + _C + x] = solved[0]
            w[block + _S + x] = solved[1]
            w[block + _INFO + x] = solved[2]
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
def _wrap(m, n, offsets, w):  # type: ignore[no-untyped-def]
    """Wrapped phases in turns (paper eq 4) from the phasors, less the code's phase offsets."""
    for k in range(n):
        block = _FRONT + _U(k) * _BLOCK
        offset = offsets[k]
        for x in range(m):
            q = _turns(w[block + _S + x], w[block + _C + x]) - offset
            w[block + _Q + x] = q - np.floor(q)


@kernel
def _unwrap_lattice(m, n, lattice, w):  # type: ignore[no-untyped-def]
    """Take the nearest wrap-count lattice point off the wrapped phases, in place (see `_unwrap_three`)."""
    if n == 3:
        three = _numbers_of_three(lattice)
        for x in range(m):
            at0 = _FRONT + _Q + x
            at1 = at0 + _BLOCK
            at2 = at1 + _BLOCK
            w[at0], w[at1], w[at2] = _unwrap_three(w[at0], w[at1], w[at2], three)
        return
    basis, to_lattice, gram = lattice
    near = np.empty(n - 1, np.float32)
    off = np.empty(n - 1, np.float32)
    for x in range(m):
        for i in range(n - 1):
            t = _F0
            for k in range(n):
                t += to_lattice[i, k] * w[_FRONT + _U(k) * _BLOCK + _Q + x]
            near[i] = np.rint(t)
            off[i] = t - near[i]
        best = _INFINITE
        chosen = 0
        for corner in range(1 << (n - 1)):
            distance = _F0
            for i in range(n - 1):
                di = off[i] - (np.copysign(_F1, off[i]) if (corner >> i) & 1 else _F0)
                for j in range(n - 1):
                    dj = off[j] - (np.copysign(_F1, off[j]) if (corner >> j) & 1 else _F0)
                    distance += gram[i, j] * di * dj
            if distance < best:
                best = distance
                chosen = corner
        for i in range(n - 1):
            step = near[i] + (np.copysign(_F1, off[i]) if (chosen >> i) & 1 else _F0)
            for k in range(n):
                w[_FRONT + _U(k) * _BLOCK + _Q + x] -= basis[k, i] * step


@kernel
def _unwrap_heterodyne(m, n, counts, beats, w):  # type: ignore[no-untyped-def]
    """Unwrap the phases in place from the coarsest beat down (multi-frequency heterodyne)."""
    levels = beats.size
    level = np.empty(n, np.float32)
    first = np.empty(levels, np.float32)
    for x in range(m):
        for k in range(n):
            level[k] = w[_FRONT + _U(k) * _BLOCK + _Q + x]
        first[0] = level[0]
        for depth in range(1, levels):
            for k in range(n - depth):
                beat = level[k] - level[k + 1]
                level[k] = beat - np.floor(beat)
            first[depth] = level[0]
        position = first[levels - 1] * beats[levels - 1]
        position -= np.floor(position)
        for depth in range(levels - 2, -1, -1):
            wraps = np.rint(beats[depth] * position - first[depth])
            position = (first[depth] + wraps) / beats[depth]
        for k in range(n):
            at = _FRONT + _U(k) * _BLOCK + _Q + x
            w[at] += np.rint(counts[k] * position - w[at])


@kernel
def _unwrap_from_coarse(m, counts, order, coarse, w):  # type: ignore[no-untyped-def]
    """Unwrap the phases in place from a coarse position in [0, 1), the counts in rising `order`."""
    for x in range(m):
        position = coarse[x]
        for k in order:
            at = _FRONT + _U(k) * _BLOCK + _Q + x
            w[at] += np.rint(counts[k] * position - w[at])
            position = w[at] / counts[k]


@kernel
def _fuse(m, n, counts, w):  # type: ignore[no-untyped-def]
    """Maximum-likelihood position from the unwrapped phases, weights ∝ (N·B)²/var, and how far they miss it."""
    for x in range(m):
        w[_TOP + x] = _F0
        w[_BOTTOM + x] = _TINY
        w[_POWER + x] = _F0
        w[_WEAKEST + x] = _INFINITE
        w[_MISFIT + x] = _F0
        w[_DISTANCE + x] = _F0
    for k in range(n):
        f = counts[k]
        block = _FRONT + _U(k) * _BLOCK
        for x in range(m):
            power = w[block + _C + x] * w[block + _C + x] + w[block + _S + x] * w[block + _S + x]
            snr = power * w[block + _INFO + x]
            w[block + _C + x] = snr
            w[_TOP + x] += snr * f * w[block + _Q + x]
            w[_BOTTOM + x] += snr * f * f
            w[_POWER + x] += power
            w[_WEAKEST + x] = min(w[_WEAKEST + x], snr)
    for x in range(m):
        w[_TOP + x] /= w[_BOTTOM + x]
    for k in range(n):
        f = counts[k]
        block = _FRONT + _U(k) * _BLOCK
        for x in range(m):
            e = w[block + _Q + x] - f * w[_TOP + x]
            w[_MISFIT + x] += w[block + _C + x] * e * e
            w[_DISTANCE + x] += e * e


@kernel
def _judge(m, n, size, limits, w):  # type: ignore[no-untyped-def]
    """Coordinate, σ and modulation into the slots top, bottom and power; flags as numbers into the slot misfit.

    Phases contradict each other where they miss a common position by more than noise explains (chi-square limit) and
    by more than the first distance, or by more than the second one, close to half a lattice step.
    """
    snr2, least2, chi2, far2, torn2 = limits
    per_count = _F1 / np.float32(n)
    scale = size / _TURN
    chi2_turns = chi2 / (_TURN * _TURN)
    for x in range(m):
        power = w[_POWER + x] * per_count
        faint = (w[_WEAKEST + x] < snr2) | (power < least2)
        distance = w[_DISTANCE + x]
        torn = ((w[_MISFIT + x] > chi2_turns) & (distance > far2)) | (distance > torn2)
        top = w[_TOP + x]
        bad = faint | torn
        w[_TOP + x] = _NAN if bad else (top - np.floor(top)) * size - _HALF
        w[_BOTTOM + x] = _NAN if bad else scale / np.sqrt(w[_BOTTOM + x])
        w[_POWER + x] = np.sqrt(power)
        why = np.float32(_LOW_MODULATION) if faint else np.float32(_ORDER_RESIDUAL)
        w[_MISFIT + x] = why if bad else _F0


@kernel
def _store(m, w, slot, target):  # type: ignore[no-untyped-def]
    for x in range(m):
        target[x] = w[slot + x]


@kernel
def decode_rows(frames, exposures, steps, sensor, unwrap, coarse, limits, size, first, end, out):  # type: ignore[no-untyped-def]
    """Decode rows first … end − 1.

    Parameters
    ----------
    frames : (exposures, fringe frames, h, w) uint8 or uint16
    exposures : (exposures,) float64, relative exposure times
    steps : StepTables
    sensor : (saturation, read variance, gain), floats in grey levels
    unwrap : (method, counts, beats, order, basis, to_lattice, gram), arrays float32 but for order, int64;
        method is LATTICE, HETERODYNE or COARSE
    coarse : (h, w) float32, coarse position in [0, 1) for the method COARSE
    limits : (least squared signal-to-noise, least squared modulation, chi-square limit, two squared distances in
        turns²), float32
    size : float32, projector pixels along the fringe axis
    out : (coordinate, sigma, modulation, texture, flags), arrays (h, w)
    """
    method, counts, beats, order, basis, to_lattice, gram = unwrap
    lattice = (basis, to_lattice, gram)
    coordinate, sigma, modulation, texture, flags = out
    width = frames.shape[3]
    n = counts.size
    w = np.zeros(_FRONT + _U(n + 1) * _BLOCK, np.float32)
    to_do = np.ones(end, np.bool_)
    four = True
    for k in range(n):
        four = four and steps.first[k + 1] - steps.first[k] == 4 and steps.offsets[k] == _F0
    if n == 3 and four and exposures.size == 1 and method == LATTICE:
        _decode_usual(frames[0], exposures[0], sensor, counts, lattice, limits, size, first, end, out, to_do)
    for row in range(first, end):
        if not to_do[row]:
            continue
        for left in range(0, width, int(_CHUNK)):
            right = min(left + int(_CHUNK), width)
            m = _U(right - left)
            bits = flags[row, left:right]
            bits[:] = 0
            if _fit_exposures(frames, row, left, m, n, exposures, steps, sensor, w):
                _mend_saturated(frames, row, left, m, n, exposures, steps, sensor, w, bits)
            _wrap(m, n, steps.offsets, w)
            if method == LATTICE:
                _unwrap_lattice(m, n, lattice, w)
            elif method == HETERODYNE:
                _unwrap_heterodyne(m, n, counts, beats, w)
            else:
                _unwrap_from_coarse(m, counts, order, coarse[row, left:right], w)
            _fuse(m, n, counts, w)
            _judge(m, n, size, limits, w)
            _store(m, w, _TOP, coordinate[row, left:right])
            _store(m, w, _BOTTOM, sigma[row, left:right])
            _store(m, w, _POWER, modulation[row, left:right])
            _store(m, w, _TEXTURE, texture[row, left:right])
            for x in range(m):
                bits[x] |= np.uint16(np.int32(w[_MISFIT + x]))

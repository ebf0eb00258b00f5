"""Phasors of a chunk from the frames of one exposure or several, with what is left of saturated samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import PixelFlag
from metrology.jit import kernel
from metrology.phase.chunk import (
    BLOCK,
    COSINE,
    FRONT,
    INFO,
    ONE,
    PARTIAL,
    PEAK,
    SINE,
    SUM,
    TEXTURE,
    TEXTURE_INFO,
    TINY,
    ZERO,
    Index,
)

_SATURATED = int(PixelFlag.SATURATED)
_SATURATED_SAMPLES = int(PixelFlag.SATURATED_SAMPLES)
# A fit from unsaturated samples counts if its normal matrix is at least this far from singular, relative to a full one.
_LEAST_DETERMINANT = 0.02


class StepTables(NamedTuple):
    """What the frames of every count show."""

    first: NDArray[np.int64]
    """(n + 1,) int64: first frame of each of n counts, and the end of the last one."""
    cosines: NDArray[np.float32]
    sines: NDArray[np.float32]
    """cosines, sines: (fringe frames,) float32: of the phase steps."""
    offsets: NDArray[np.float32]
    """(n,) float32: phase offset of each count, turns."""


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
            w[block + COSINE + x] = np.float32(a1 - a3)
            w[block + SINE + x] = np.float32(a4 - a2)
            w[block + SUM + x] = np.float32(a1 + a2 + a3 + a4)
            w[block + PEAK + x] = np.float32(max(max(a1, a2), max(a3, a4)))
        return
    for j in range(n):
        samples = frames[first_frame + j, row, left:right]
        cosine = cosines[first_frame + j]
        sine = sines[first_frame + j]
        # The first step starts the sums.
        keep = ZERO if j == 0 else ONE
        if j == 0:
            w[block : block + BLOCK] = ZERO
        for x in range(m):
            value = np.float32(samples[x])
            w[block + COSINE + x] = keep * w[block + COSINE + x] + value * cosine
            w[block + SINE + x] = keep * w[block + SINE + x] - value * sine
            w[block + SUM + x] = keep * w[block + SUM + x] + value
            w[block + PEAK + x] = max(keep * w[block + PEAK + x], value)


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
def fit_exposures(frames, row, left, m, n_counts, exposures, steps, sensor, w):  # type: ignore[no-untyped-def]
    """Phasors, their information 1/var and the mean level of a chunk; True if a sample of it is saturated.

    A count's exposures are added by inverse variance, those left out in which one of its samples is saturated.
    """
    saturation, read, gain = sensor
    limit = np.float32(saturation)
    read32 = np.float32(read)
    gain32 = np.float32(gain)
    spare = FRONT + Index(n_counts) * BLOCK
    w[:spare] = ZERO
    some_partial = 0
    for k in range(n_counts):
        block = FRONT + Index(k) * BLOCK
        n = steps.first[k + 1] - steps.first[k]
        step_info = np.float32(0.5 * n)
        per_sample = np.float32(1.0 / n)
        for e in range(exposures.size):
            time = np.float32(exposures[e])
            inverse_time = ONE / time
            scale = inverse_time / step_info
            _sums(frames[e], steps.first[k], n, row, left, m, steps.cosines, steps.sines, w, spare)
            for x in range(m):
                mean = w[spare + SUM + x] * per_sample
                good = w[spare + PEAK + x] < limit
                weight = time * time / (read32 + gain32 * mean) if good else ZERO
                partial = ZERO if good else ONE
                some_partial += np.int32(partial)
                w[PARTIAL + x] = max(w[PARTIAL + x], partial)
                w[TEXTURE + x] += weight * mean * inverse_time
                w[TEXTURE_INFO + x] += weight
                w[spare + INFO + x] = weight
            for x in range(m):
                weight = w[spare + INFO + x]
                w[block + COSINE + x] += weight * scale * w[spare + COSINE + x]
                w[block + SINE + x] += weight * scale * w[spare + SINE + x]
                w[block + INFO + x] += weight
        for x in range(m):
            inverse = ONE / max(w[block + INFO + x], TINY)
            w[block + COSINE + x] *= inverse
            w[block + SINE + x] *= inverse
            w[block + INFO + x] *= step_info
    for x in range(m):
        w[TEXTURE + x] /= max(w[TEXTURE_INFO + x], TINY)
    return some_partial > 0


@kernel
def mend_saturated(frames, row, left, m, n_counts, exposures, steps, sensor, w, flags):  # type: ignore[no-untyped-def]
    """Use what unsaturated samples there are beside saturated ones, and set the flags."""
    for x in range(m):
        if w[PARTIAL + x] == ZERO:
            continue
        flags[x] |= _SATURATED_SAMPLES
        if w[TEXTURE_INFO + x] == ZERO:
            w[TEXTURE + x] = _clipped_texture(frames, row, left + int(x), exposures)
        for k in range(n_counts):
            block = FRONT + Index(k) * BLOCK
            solved = _add_unsaturated(
                frames, steps.first[k], steps.first[k + 1], row, left + int(x), exposures,
                steps.cosines, steps.sines, sensor,
                float(w[block + COSINE + x]), float(w[block + SINE + x]), float(w[block + INFO + x]),
            )  # fmt: skip
            w[block + COSINE + x] = solved[0]
            w[block + SINE + x] = solved[1]
            w[block + INFO + x] = solved[2]
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

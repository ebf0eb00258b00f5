"""The usual scan: three counts of four steps, one exposure, decoded in registers."""

from __future__ import annotations

import numpy as np

from metrology.cloud import PixelFlag
from metrology.jit import kernel
from metrology.phase.chunk import HALF, NAN, TINY, TURN, turns
from metrology.phase.unwrapping import numbers_of_three, unwrap_three

_LOW_MODULATION = int(PixelFlag.LOW_MODULATION)
_ORDER_RESIDUAL = int(PixelFlag.ORDER_RESIDUAL)
_SATURATED_SAMPLES = int(PixelFlag.SATURATED_SAMPLES)


@kernel
def decode_usual(frames, exposure, sensor, counts, lattice, limits, size, first, end, out, mend):  # type: ignore[no-untyped-def]
    """Three counts of four steps, one exposure; `mend` (h,) becomes True for rows with a saturated sample.

    A sample is ``I_i = r [a cos(φ + (i−1)π/2) + b + b₁]`` (paper eqs 2 and 3), so that per count
    ``φ = atan2(I₄ − I₂, I₁ − I₃)`` (eq 4), whatever reflectivity r and ambient light b₁ are.
    """
    saturation, read, gain = sensor
    snr2, least2, chi2, far2, torn2 = limits
    coordinates, sigmas, modulations, textures, flagses = out
    f0, f1, f2 = counts[0], counts[1], counts[2]
    three = numbers_of_three(lattice)
    read32 = np.float32(read)
    gain32 = np.float32(gain)
    scale = size / TURN
    chi2_turns = chi2 / (TURN * TURN)
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
            # Numerator and denominator of eq 4, for each count; `turns` is its arc tangent.
            ca, sa = np.float32(i1 - i3), np.float32(i4 - i2)
            cb, sb = np.float32(j1 - j3), np.float32(j4 - j2)
            cc, sc = np.float32(k1 - k3), np.float32(k4 - k2)
            q0, q1, q2 = unwrap_three(turns(sa, ca), turns(sb, cb), turns(sc, cc), three)
            power0 = ca * ca + sa * sa
            power1 = cb * cb + sb * sb
            power2 = cc * cc + sc * sc
            weight0 = power0 * f0
            weight1 = power1 * f1
            weight2 = power2 * f2
            bottom = weight0 * f0 + weight1 * f1 + weight2 * f2 + TINY
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
            coordinate[x] = NAN if bad else (position - np.floor(position)) * size - HALF
            sigma[x] = NAN if bad else scale * np.sqrt(variance / bottom)
            modulation[x] = to_modulation * np.sqrt(power)
            texture[x] = to_texture * mean
            why = np.int32((_LOW_MODULATION if faint else _ORDER_RESIDUAL) if bad else 0)
            flags[x] = np.uint16(why | np.int32(_SATURATED_SAMPLES if peak >= limit else 0))
        saturated = np.uint16(0)
        for x in range(frames.shape[2]):
            saturated |= flags[x]
        mend[row] = saturated & _SATURATED_SAMPLES != 0

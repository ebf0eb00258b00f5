"""Rows of a camera's frames to coordinate, standard deviation, modulation, texture and flags."""

from __future__ import annotations

import numpy as np

from metrology.cloud import PixelFlag
from metrology.jit import kernel
from metrology.phase.chunk import (
    BLOCK,
    BOTTOM,
    CHUNK,
    COSINE,
    DISTANCE,
    FRONT,
    HALF,
    INFINITE,
    INFO,
    MISFIT,
    NAN,
    ONE,
    PHASE,
    POWER,
    SINE,
    TEXTURE,
    TINY,
    TOP,
    TURN,
    WEAKEST,
    ZERO,
    Index,
)
from metrology.phase.exposures import fit_exposures, mend_saturated
from metrology.phase.unwrapping import HETERODYNE, LATTICE, unwrap_from_coarse, unwrap_heterodyne, unwrap_lattice, wrap
from metrology.phase.usual import decode_usual

_LOW_MODULATION = int(PixelFlag.LOW_MODULATION)
_ORDER_RESIDUAL = int(PixelFlag.ORDER_RESIDUAL)


@kernel
def _fuse(m, n, counts, w):  # type: ignore[no-untyped-def]
    """Maximum-likelihood position from the unwrapped phases, weights ∝ (N·B)²/var, and how far they miss it."""
    for x in range(m):
        w[TOP + x] = ZERO
        w[BOTTOM + x] = TINY
        w[POWER + x] = ZERO
        w[WEAKEST + x] = INFINITE
        w[MISFIT + x] = ZERO
        w[DISTANCE + x] = ZERO
    for k in range(n):
        f = counts[k]
        block = FRONT + Index(k) * BLOCK
        for x in range(m):
            power = w[block + COSINE + x] * w[block + COSINE + x] + w[block + SINE + x] * w[block + SINE + x]
            snr = power * w[block + INFO + x]
            w[block + COSINE + x] = snr
            w[TOP + x] += snr * f * w[block + PHASE + x]
            w[BOTTOM + x] += snr * f * f
            w[POWER + x] += power
            w[WEAKEST + x] = min(w[WEAKEST + x], snr)
    for x in range(m):
        w[TOP + x] /= w[BOTTOM + x]
    for k in range(n):
        f = counts[k]
        block = FRONT + Index(k) * BLOCK
        for x in range(m):
            e = w[block + PHASE + x] - f * w[TOP + x]
            w[MISFIT + x] += w[block + COSINE + x] * e * e
            w[DISTANCE + x] += e * e


@kernel
def _judge(m, n, size, limits, w):  # type: ignore[no-untyped-def]
    """Coordinate, σ and modulation into the slots top, bottom and power; flags as numbers into the slot misfit.

    Phases contradict each other where they miss a common position by more than noise explains (chi-square limit) and
    by more than the first distance, or by more than the second one, close to half a lattice step.
    """
    snr2, least2, chi2, far2, torn2 = limits
    per_count = ONE / np.float32(n)
    scale = size / TURN
    chi2_turns = chi2 / (TURN * TURN)
    for x in range(m):
        power = w[POWER + x] * per_count
        faint = (w[WEAKEST + x] < snr2) | (power < least2)
        distance = w[DISTANCE + x]
        torn = ((w[MISFIT + x] > chi2_turns) & (distance > far2)) | (distance > torn2)
        top = w[TOP + x]
        bad = faint | torn
        w[TOP + x] = NAN if bad else (top - np.floor(top)) * size - HALF
        w[BOTTOM + x] = NAN if bad else scale / np.sqrt(w[BOTTOM + x])
        w[POWER + x] = np.sqrt(power)
        why = np.float32(_LOW_MODULATION) if faint else np.float32(_ORDER_RESIDUAL)
        w[MISFIT + x] = why if bad else ZERO


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
    w = np.zeros(FRONT + Index(n + 1) * BLOCK, np.float32)
    to_do = np.ones(end, np.bool_)
    four = True
    for k in range(n):
        four = four and steps.first[k + 1] - steps.first[k] == 4 and steps.offsets[k] == ZERO
    if n == 3 and four and exposures.size == 1 and method == LATTICE:
        decode_usual(frames[0], exposures[0], sensor, counts, lattice, limits, size, first, end, out, to_do)
    for row in range(first, end):
        if not to_do[row]:
            continue
        for left in range(0, width, int(CHUNK)):
            right = min(left + int(CHUNK), width)
            m = Index(right - left)
            bits = flags[row, left:right]
            bits[:] = 0
            if fit_exposures(frames, row, left, m, n, exposures, steps, sensor, w):
                mend_saturated(frames, row, left, m, n, exposures, steps, sensor, w, bits)
            wrap(m, n, steps.offsets, w)
            if method == LATTICE:
                unwrap_lattice(m, n, lattice, w)
            elif method == HETERODYNE:
                unwrap_heterodyne(m, n, counts, beats, w)
            else:
                unwrap_from_coarse(m, counts, order, coarse[row, left:right], w)
            _fuse(m, n, counts, w)
            _judge(m, n, size, limits, w)
            _store(m, w, TOP, coordinate[row, left:right])
            _store(m, w, BOTTOM, sigma[row, left:right])
            _store(m, w, POWER, modulation[row, left:right])
            _store(m, w, TEXTURE, texture[row, left:right])
            for x in range(m):
                bits[x] |= np.uint16(np.int32(w[MISFIT + x]))

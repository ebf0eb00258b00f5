"""Wrapped phases of several counts to unwrapped ones: by wrap counts' lattice, by beats, or from a coarse position."""

from __future__ import annotations

import numpy as np
from numba import njit

from metrology.jit import kernel
from metrology.phase.chunk import BLOCK, COSINE, FRONT, INFINITE, ONE, PHASE, SINE, TWO, ZERO, Index, turns

LATTICE, HETERODYNE, COARSE = range(3)


@njit(inline="always")
def unwrap_three(q0, q1, q2, lattice):  # type: ignore[no-untyped-def]
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
    su = ONE if u >= ZERO else -ONE
    sv = ONE if v >= ZERO else -ONE
    # Squared distance of the cell's other corners less that of the rounded one.
    along = g00 * (ONE - TWO * abs(u)) - g01 * v * su
    aside = g11 * (ONE - TWO * abs(v)) - g01 * u * sv
    both = along + aside + g01 * su * sv
    n0 = n0 + su if min(along, both) < min(ZERO, aside) else n0
    n1 = n1 + sv if min(aside, both) < min(ZERO, along) else n1
    return q0 - b00 * n0 - b01 * n1, q1 - b10 * n0 - b11 * n1, q2 - b20 * n0 - b21 * n1


@njit(inline="always")
def numbers_of_three(lattice):  # type: ignore[no-untyped-def]
    """The lattice's arrays as plain numbers, which stay in registers."""
    basis, to_lattice, gram = lattice
    return (
        to_lattice[0, 0], to_lattice[0, 1], to_lattice[0, 2], to_lattice[1, 0], to_lattice[1, 1], to_lattice[1, 2],
        basis[0, 0], basis[0, 1], basis[1, 0], basis[1, 1], basis[2, 0], basis[2, 1],
        gram[0, 0], gram[0, 1] + gram[1, 0], gram[1, 1],
    )  # fmt: skip


@kernel
def wrap(m, n, offsets, w):  # type: ignore[no-untyped-def]
    """Wrapped phases in turns (paper eq 4) from the phasors, less the code's phase offsets."""
    for k in range(n):
        block = FRONT + Index(k) * BLOCK
        offset = offsets[k]
        for x in range(m):
            q = turns(w[block + SINE + x], w[block + COSINE + x]) - offset
            w[block + PHASE + x] = q - np.floor(q)


@kernel
def unwrap_lattice(m, n, lattice, w):  # type: ignore[no-untyped-def]
    """Take the nearest wrap-count lattice point off the wrapped phases, in place (see `unwrap_three`)."""
    if n == 3:
        three = numbers_of_three(lattice)
        for x in range(m):
            at0 = FRONT + PHASE + x
            at1 = at0 + BLOCK
            at2 = at1 + BLOCK
            w[at0], w[at1], w[at2] = unwrap_three(w[at0], w[at1], w[at2], three)
        return
    basis, to_lattice, gram = lattice
    near = np.empty(n - 1, np.float32)
    off = np.empty(n - 1, np.float32)
    for x in range(m):
        for i in range(n - 1):
            t = ZERO
            for k in range(n):
                t += to_lattice[i, k] * w[FRONT + Index(k) * BLOCK + PHASE + x]
            near[i] = np.rint(t)
            off[i] = t - near[i]
        best = INFINITE
        chosen = 0
        for corner in range(1 << (n - 1)):
            distance = ZERO
            for i in range(n - 1):
                di = off[i] - (np.copysign(ONE, off[i]) if (corner >> i) & 1 else ZERO)
                for j in range(n - 1):
                    dj = off[j] - (np.copysign(ONE, off[j]) if (corner >> j) & 1 else ZERO)
                    distance += gram[i, j] * di * dj
            if distance < best:
                best = distance
                chosen = corner
        for i in range(n - 1):
            step = near[i] + (np.copysign(ONE, off[i]) if (chosen >> i) & 1 else ZERO)
            for k in range(n):
                w[FRONT + Index(k) * BLOCK + PHASE + x] -= basis[k, i] * step


@kernel
def unwrap_heterodyne(m, n, counts, beats, w):  # type: ignore[no-untyped-def]
    """Unwrap the phases in place from the coarsest beat down (multi-frequency heterodyne)."""
    levels = beats.size
    level = np.empty(n, np.float32)
    first = np.empty(levels, np.float32)
    for x in range(m):
        for k in range(n):
            level[k] = w[FRONT + Index(k) * BLOCK + PHASE + x]
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
            at = FRONT + Index(k) * BLOCK + PHASE + x
            w[at] += np.rint(counts[k] * position - w[at])


@kernel
def unwrap_from_coarse(m, counts, order, coarse, w):  # type: ignore[no-untyped-def]
    """Unwrap the phases in place from a coarse position in [0, 1), the counts in rising `order`."""
    for x in range(m):
        position = coarse[x]
        for k in order:
            at = FRONT + Index(k) * BLOCK + PHASE + x
            w[at] += np.rint(counts[k] * position - w[at])
            position = w[at] / counts[k]

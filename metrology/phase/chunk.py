"""What the kernels of a chunk share: where its intermediate values lie, single-precision numbers, an arc tangent.

All intermediate values of a chunk lie in one scratch array, each in a slot of `CHUNK` pixels: first the slots of the
whole pixel, then a block of slots for every fringe count, at last a block for the exposure at hand.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# Pixels per chunk: with three counts the 33 slots take 33 kB. Sizes and indices are unsigned: a negative index would
# count from the end, and to look for one keeps the compiler from using vectors.
Index = np.uintp
CHUNK = Index(256)
# Slots of the whole pixel …
TEXTURE, TEXTURE_INFO, PARTIAL, TOP, BOTTOM, POWER, WEAKEST, MISFIT, DISTANCE = (
    CHUNK * Index(slot) for slot in range(9)
)
FRONT = CHUNK * Index(9)
# … and those of a count's block: phasor, its information 1/var, phase in turns, sum and largest of the samples.
COSINE, SINE, INFO, PHASE, SUM, PEAK = (CHUNK * Index(slot) for slot in range(6))
BLOCK = CHUNK * Index(6)

TURN = np.float32(2 * np.pi)
ZERO, ONE, TWO = np.float32(0), np.float32(1), np.float32(2)
HALF, QUARTER = np.float32(0.5), np.float32(0.25)
TINY = np.float32(1e-12)
INFINITE = np.float32(np.inf)
NAN = np.float32(np.nan)
# Least-maximum-error odd polynomial of atan(t)/2π on [0, 1]; error below 4e-8 turns before rounding.
_ATAN = tuple(
    np.float32(a)
    for a in (
        0.1591543242, -0.05302623816, 0.03152511756, -0.02106151798,
        0.01267250087, -0.005348277659, 0.001084130523,
    )
)  # fmt: skip


@njit(inline="always")
def turns(s, c):  # type: ignore[no-untyped-def]
    """atan2(s, c)/2π in [0, 1) without branches; float32."""
    a = abs(s)
    b = abs(c)
    t = min(a, b) / max(max(a, b), TINY)
    u = t * t
    p = _ATAN[6]
    p = p * u + _ATAN[5]
    p = p * u + _ATAN[4]
    p = p * u + _ATAN[3]
    p = p * u + _ATAN[2]
    p = p * u + _ATAN[1]
    p = p * u + _ATAN[0]
    r = p * t
    r = QUARTER - r if a > b else r
    r = HALF - r if c < ZERO else r
    return ONE - r if s < ZERO else r

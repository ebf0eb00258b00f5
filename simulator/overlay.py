"""Kernels of what lies on the smooth plates or deforms them: dents and scratches, and coats of paint."""

from __future__ import annotations

import math

from simulator.compiled import kernel
from simulator.defects import POINTED

# Columns of Relief.dents. U and V: rows that carry (dx, dy) into the tangent plane, in half axes (a groove: in half
# widths both). DEPTH: measured along z. END: where it ends, along u; a groove's half length. REACH: radius in x-y, mm.
(
    D_X, D_Y, D_UX, D_UY, D_VX, D_VY, D_DEPTH, D_SHAPE, D_BLUNT, D_END, D_LIP, D_REACH, D_SHARP, D_SIZE,
) = range(14)  # fmt: skip
SMOOTH, POINT, FOLD, GROOVE = range(4)
COAT_TEXEL_MM = 0.1


@kernel
def _pointed(rho, blunt):  # type: ignore[no-untyped-def]
    """(1 − ρ/r)², its point rounded."""
    q = 1.0 - (math.sqrt((1.0 + 2.0 * blunt) * rho * rho + blunt * blunt) - blunt) / POINTED
    return q * q if q > 0.0 else 0.0


@kernel
def _bowl(rho):  # type: ignore[no-untyped-def]
    """cos²(π ρ / 4) up to ρ = 2."""
    if rho >= 2.0:
        return 0.0
    c = math.cos(0.25 * math.pi * rho)
    return c * c


@kernel
def near_dent(dents, k, x, y):  # type: ignore[no-untyped-def]
    """Whether a dent reaches (x, y)."""
    dx, dy = x - dents[k, D_X], y - dents[k, D_Y]
    return dx * dx + dy * dy < dents[k, D_REACH] * dents[k, D_REACH]


@kernel
def dent_drop(dents, k, x, y):  # type: ignore[no-untyped-def]
    """How far a dent lowers the plate at (x, y), mm along z."""
    if not near_dent(dents, k, x, y):
        return 0.0
    dx, dy = x - dents[k, D_X], y - dents[k, D_Y]
    u = abs(dents[k, D_UX] * dx + dents[k, D_UY] * dy)
    v = abs(dents[k, D_VX] * dx + dents[k, D_VY] * dy)
    shape, depth, blunt = dents[k, D_SHAPE], dents[k, D_DEPTH], dents[k, D_BLUNT]
    if shape == SMOOTH:
        return depth * _bowl(math.sqrt(u * u + v * v))
    if shape == POINT:
        return depth * _pointed(math.sqrt(u * u + v * v), blunt)
    if shape == FOLD:
        return depth * _bowl(u) * _pointed(v, blunt)
    along = _bowl(max(u - dents[k, D_END] + 1.0, 0.0))
    drop = depth * _bowl(v)
    if 2.0 < v < 4.0:
        s = math.sin(0.5 * math.pi * (v - 2.0))
        drop -= dents[k, D_LIP] * s * s
    return along * drop


@kernel
def coat_height(coat, x_min, y_min, x, y):  # type: ignore[no-untyped-def]
    """Thickness of paint, bilinear in a map whose origin is a texel outside the panel's corner; 0 without a map."""
    if coat.shape[0] == 0:
        return 0.0
    u = min(max((x - x_min) / COAT_TEXEL_MM + 1.0, 0.0), coat.shape[1] - 1.001)
    v = min(max((y - y_min) / COAT_TEXEL_MM + 1.0, 0.0), coat.shape[0] - 1.001)
    i, j = int(v), int(u)
    a, b = v - i, u - j
    top = (1.0 - b) * coat[i, j] + b * coat[i, j + 1]
    bottom = (1.0 - b) * coat[i + 1, j] + b * coat[i + 1, j + 1]
    return (1.0 - a) * top + a * bottom

"""How a camera blurs a straight edge: lens, pixel aperture, and light that spills into neighbouring pixels.

A border's position is as good as this model where another border (a chamfer's) lies within the blur. The point spread
is taken as a Gaussian (lens) folded with the pixel's square aperture and with the spill into neighbouring
pixels along rows and columns (halation, sensor cross-talk; a diffusion, so a Gaussian's shares). An edge in any
direction sees its projection.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array
from metrology.jit import kernel

_NODES_PER_PIXEL = 24
_TAIL_SIGMAS = 4.5
# An aperture's side is taken for at least this share of the other one: differences over nothing lose all digits.
_THIN = 0.01
# Standard deviations beyond which a Gaussian's tail (1e-12) is nothing.
_SATURATED = 7.0
# Change of the spill by which the step's is taken.
_SPILL_DIFFERENCE = 1e-4


@dataclass(frozen=True)
class PixelBlur:
    """A camera's blur."""

    lens_px: float = 0.45
    """Standard deviation of the lens's Gaussian, px."""
    spill: float = 0.05
    """Share q of a pixel's light that goes to each neighbour in its row, and likewise in its column; of what stays, r =
    q / (1 − 2q), each next but one gets r⁴ times as much, as a Gaussian has it."""


@dataclass(frozen=True)
class EdgeResponse:
    """A blurred unit step, tabulated: S(x) from 0 to 1 and its derivative at ``x = step · (i − n // 2)``."""

    step: float
    """In the unit of x."""
    values: Array
    slopes: Array
    """values, slopes: (n,): S, and dS/dx."""

    @classmethod
    def along(cls, gradient: tuple[float, float], blur: PixelBlur) -> EdgeResponse:
        """Response in a coordinate x that changes by `gradient` per pixel in u and in v."""
        side_u, side_v = abs(gradient[0]), abs(gradient[1])
        pixel = float(np.hypot(side_u, side_v))
        sigma = blur.lens_px * pixel
        reach = 2.5 * (side_u + side_v) + _TAIL_SIGMAS * sigma
        half = int(np.ceil(reach * _NODES_PER_PIXEL / pixel))
        step = pixel / _NODES_PER_PIXEL
        thin = _THIN * max(side_u, side_v)
        table = np.zeros((6, 2 * half + 1))
        _tabulate(half, step, max(side_u, thin), max(side_v, thin), sigma, blur.spill, table)
        return cls(step, table[0], table[1])


@kernel
def blurred_steps(normals, lenses, spill, nodes_per_px, reach_px):  # type: ignore[no-untyped-def]
    """(k, 6, n) blurred unit steps across edges with the unit `normals` (k, 2), for |x| ≤ reach, x in px.

    Rows: the step, its change with the spill, and that with the lens, each with its slope.
    """
    half = int(np.ceil(reach_px * nodes_per_px))
    tables = np.zeros((lenses.size, 6, 2 * half + 1))
    for k in range(lenses.size):
        side_u, side_v = max(abs(normals[k, 0]), _THIN), max(abs(normals[k, 1]), _THIN)
        _tabulate(half, 1.0 / nodes_per_px, side_u, side_v, lenses[k], spill, tables[k])
    return tables


@kernel
def _shares(spill):  # type: ignore[no-untyped-def]
    """Differences of a pixel's light between its neighbours along one axis, at ±½, ±1½ and ±2½ pixels."""
    stays = 1.0 - 2.0 * spill
    far = stays * (spill / stays) ** 4
    stays -= 2.0 * far
    return -far, far - spill, spill - stays, stays - spill, spill - far, far


@kernel
def _tabulate(half, step, side_u, side_v, sigma, spill, table):  # type: ignore[no-untyped-def]
    """Add to `table` (6, n) a Gaussian edge folded with two boxes (differences of its second antiderivative) and spill.

    Rows: the step, its change with the spill, and that with sigma, each with its slope. The second antiderivative
    ``σ² (t φ + (t² + 1) Φ) / 2``, t = x/σ, changes with sigma by ``σ Φ``.
    """
    shares, changed = _shares(spill), _shares(spill + _SPILL_DIFFERENCE)
    for i in range(6):
        for j in range(6):
            weight = shares[i] * shares[j] / (side_u * side_v)
            change = (changed[i] * changed[j] / (side_u * side_v) - weight) / _SPILL_DIFFERENCE
            offset = (i - 2.5) * side_u + (j - 2.5) * side_v
            for k in range(half + 1):
                t = ((k - half) * step + offset) / sigma
                # Nothing has come yet, or all of it.
                phi, cdf = 0.0, 0.0 if t < 0.0 else 1.0
                if abs(t) < _SATURATED:
                    phi = 0.3989422804014327 * np.exp(-0.5 * t * t)
                    cdf = 0.5 * (1.0 + math.erf(t * 0.7071067811865476))
                second, first = 0.5 * sigma * sigma * ((t * t + 1.0) * cdf + t * phi), sigma * (t * cdf + phi)
                table[0, k] += weight * second
                table[1, k] += weight * first
                table[2, k] += change * second
                table[3, k] += change * first
                table[4, k] += weight * sigma * cdf
                table[5, k] += weight * phi
    # The point spread is even.
    for k in range(half):
        for row in range(0, 6, 2):
            table[row, 2 * half - k] = (1.0 if row == 0 else 0.0) - table[row, k]
            table[row + 1, 2 * half - k] = table[row + 1, k]

"""How a camera blurs a straight edge: lens, pixel aperture, and light that spills into neighbouring pixels.

A border's position is as good as this model where another border (a chamfer's) lies within the blur. The point spread is
taken as a Gaussian (lens) folded with the pixel's square aperture and with ``[q, 1 − 2q, q]`` along rows and columns
(spill: halation, sensor cross-talk, sharpening if negative). An edge in any direction sees its projection.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

Array = NDArray[np.float64]

_NODES_PER_PIXEL = 24
_TAIL_SIGMAS = 4.5
# Below this share of the other one, an aperture's side does not count.
_THIN = 1e-3


@dataclass(frozen=True)
class PixelBlur:
    """A camera's blur.

    Attributes
    ----------
    lens_px : float
        Standard deviation of the lens's Gaussian, px.
    spill : float
        Share of a pixel's light that goes to each neighbour in its row, and likewise in its column.
    """

    lens_px: float = 0.45
    spill: float = 0.05


@dataclass(frozen=True)
class EdgeResponse:
    """A blurred unit step, tabulated: S(x) from 0 to 1 and its derivative at ``x = step · (i − n // 2)``.

    Attributes
    ----------
    step : float
        In the unit of x.
    values, slopes : (n,) ndarray
        S, and dS/dx.
    """

    step: float
    values: Array
    slopes: Array

    @classmethod
    def along(cls, gradient: tuple[float, float], blur: PixelBlur) -> EdgeResponse:
        """Response in a coordinate x that changes by `gradient` per pixel in u and in v."""
        side_u, side_v = abs(gradient[0]), abs(gradient[1])
        pixel = float(np.hypot(side_u, side_v))
        sigma = blur.lens_px * pixel
        reach = 1.5 * (side_u + side_v) + _TAIL_SIGMAS * sigma
        half = int(np.ceil(reach * _NODES_PER_PIXEL / pixel))
        x = pixel / _NODES_PER_PIXEL * np.arange(-half, half + 1)
        taps = ((-1, blur.spill), (0, 1 - 2 * blur.spill), (1, blur.spill))
        values, slopes = np.zeros_like(x), np.zeros_like(x)
        for i, weight_u in taps:
            for j, weight_v in taps:
                moved = x - i * side_u - j * side_v
                weight = weight_u * weight_v
                values += weight * _folded(moved, side_u, side_v, sigma, 0)
                slopes += weight * _folded(moved, side_u, side_v, sigma, 1)
        return cls(pixel / _NODES_PER_PIXEL, values, slopes)


def _folded(x: Array, side_u: float, side_v: float, sigma: float, derivative: int) -> Array:
    """A Gaussian edge folded with two boxes: differences of its antiderivatives."""
    sides = [side for side in (side_u, side_v) if side > _THIN * max(side_u, side_v)]
    total = np.zeros_like(x)
    for signs in np.ndindex(*(2,) * len(sides)):
        offset = sum((0.5 - sign) * side for sign, side in zip(signs, sides, strict=True))
        total += (-1) ** sum(signs) * _antiderivative(x + offset, sigma, len(sides) - derivative)
    return np.asarray(total / np.prod(sides))


def _antiderivative(x: Array, sigma: float, order: int) -> Array:
    """Φ(x/σ), integrated 0, 1 or 2 times."""
    density = np.exp(-0.5 * (x / sigma) ** 2) / np.sqrt(2 * np.pi)
    step = 0.5 * (1 + erf(x / (np.sqrt(2) * sigma)))
    if order == 0:
        return np.asarray(step)
    if order == 1:
        return np.asarray(x * step + sigma * density)
    return np.asarray(0.5 * ((x**2 + sigma**2) * step + x * sigma * density))

"""Pixels of one image around a place, in coordinates across and along a line."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrology.arrays import Array
from metrology.jit import kernel

_GRID = np.stack(np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5)), axis=-1).reshape(-1, 2)


@dataclass(frozen=True)
class LocalMap:
    """Where pixels near a place lie: ``(x, z) = C · (1, a, b, a², ab, b²)`` with (a, b) = pixel − centre."""

    centre: Array
    """(2,): u, v, px."""
    coefficients: Array
    """(2, 6): rows for x (across the line) and z (along it), in the unit of those."""

    @classmethod
    def in_image(cls, centre: ArrayLike, normal: ArrayLike) -> LocalMap:
        """x along the unit `normal`, z across it, both in pixels: for work in one image alone."""
        nu, nv = np.asarray(normal, float)
        return cls(np.asarray(centre, float), np.array([[0, nu, nv, 0, 0, 0], [0, -nv, nu, 0, 0, 0.0]]))

    @property
    def px_per_unit(self) -> float:
        """Pixels per unit of x, across the line."""
        du, dv = self._inverse[:, 0]
        return math.hypot(du, dv)

    @property
    def gradient(self) -> tuple[float, float]:
        """Change of x per pixel in u and in v."""
        return float(self.coefficients[0, 1]), float(self.coefficients[0, 2])

    @property
    def _inverse(self) -> Array:
        """(2, 2) change of u and of v with x and z."""
        (a, b), (c, d) = self.coefficients[:, 1:3].tolist()
        return np.array([[d, -b], [-c, a]]) / (a * d - b * c)


def grid_offsets(half_x: Array, half_z: float) -> Array:
    """(n, 25, 2) x, z of grids over ±half_x, ±half_z: project the points there and hand the pixels to `fit_maps`."""
    return np.asarray(_GRID * np.stack([half_x, np.full(len(half_x), half_z)], axis=-1)[:, None])


def fit_maps(offsets: Array, pixels: Array) -> list[LocalMap]:
    """The maps that take `pixels` (n, m, 2) to their `offsets` (n, m, 2): exact to third order in the patch's size."""
    centres = pixels.mean(axis=1)
    relative = pixels - centres[:, None]
    scales = np.abs(relative).max(axis=(1, 2))
    a, b = np.moveaxis(relative / scales[:, None, None], -1, 0)
    design = np.stack([np.ones_like(a), a, b, a * a, a * b, b * b], axis=-1)
    turned = design.transpose(0, 2, 1)
    coefficients = np.linalg.solve(turned @ design, turned @ offsets).transpose(0, 2, 1)
    coefficients = np.ascontiguousarray(coefficients / scales[:, None, None] ** np.array([0, 1, 1, 2, 2, 2]))
    return [LocalMap(centre, own) for centre, own in zip(centres, coefficients, strict=True)]


def sample(
    image: NDArray[np.float32], local: LocalMap, low_x: float, high_x: float, half_z: float
) -> tuple[Array, Array, Array]:
    """Pixels with low_x ≤ x ≤ high_x and |z| ≤ half_z.

    Returns
    -------
    x, z, grey : (n,) ndarray
    """
    corners = np.array([[low_x, -half_z], [low_x, half_z], [high_x, -half_z], [high_x, half_z]])
    reach = np.abs((corners - local.coefficients[:, 0]) @ local._inverse.T).max(axis=0) + 1.5
    return _sample(image, local.centre, local.coefficients, reach, low_x, high_x, half_z)


def binned(x: Array, grey: Array, size: float) -> tuple[Array, Array, Array]:
    """Mean x, mean grey level and number of the pixels in each bin of `size`, empty ones left out."""
    bins = np.floor(x / size).astype(np.int64)
    bins -= bins.min()
    counts = np.bincount(bins)
    held = counts > 0
    counts = counts[held]
    return np.bincount(bins, x)[held] / counts, np.bincount(bins, grey)[held] / counts, counts.astype(float)


@kernel
def _sample(image, centre, coefficients, reach, low_x, high_x, half_z):  # type: ignore[no-untyped-def]
    """Collect the pixels of a rectangle in (x, z)."""
    height, width = image.shape
    u0, u1 = max(0, int(centre[0] - reach[0])), min(width - 1, int(centre[0] + reach[0] + 1))
    v0, v1 = max(0, int(centre[1] - reach[1])), min(height - 1, int(centre[1] + reach[1] + 1))
    room = max(0, u1 - u0 + 1) * max(0, v1 - v0 + 1)
    xs, zs, grey = np.empty(room), np.empty(room), np.empty(room)
    count = 0
    for v in range(v0, v1 + 1):
        b = v - centre[1]
        for u in range(u0, u1 + 1):
            a = u - centre[0]
            x = coefficients[0, 0] + coefficients[0, 1] * a + coefficients[0, 2] * b
            x += coefficients[0, 3] * a * a + coefficients[0, 4] * a * b + coefficients[0, 5] * b * b
            if x < low_x or x > high_x:
                continue
            z = coefficients[1, 0] + coefficients[1, 1] * a + coefficients[1, 2] * b
            z += coefficients[1, 3] * a * a + coefficients[1, 4] * a * b + coefficients[1, 5] * b * b
            value = image[v, u]
            if abs(z) > half_z or not np.isfinite(value):
                continue
            xs[count], zs[count], grey[count] = x, z, value
            count += 1
    return xs[:count], zs[:count], grey[:count]

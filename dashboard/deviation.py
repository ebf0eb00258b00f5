"""How the whole field deviates from its own smooth skin: for the map and the 3-D view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.surfaces import Frame, fit_surface, monomials
from storage.cloud import StoredCloud

_ORDER: Literal[2] = 2
_FIT_POINTS = 20_000
_FEWEST = 200


@dataclass(frozen=True)
class FieldDeviation:
    """A decimated cloud against its smooth skin."""

    u: NDArray[np.int64]
    v: NDArray[np.int64]
    """u, v: (w,), (h,): pixels of the columns and rows kept."""
    x: NDArray[np.float32]
    y: NDArray[np.float32]
    """x, y: (h, w) float32: along the skin, mm; NaN where there is no point."""
    deviation: NDArray[np.float32]
    """(h, w) float32: above a quadric through the field, mm."""

    @property
    def scale_mm(self) -> float:
        """A range that shows the skin's texture: the 99th percentile of |deviation|, at least 0.02 mm."""
        present = self.deviation[np.isfinite(self.deviation)]
        return max(0.02, float(np.percentile(np.abs(present), 99))) if present.size else 0.02


def field_deviation(cloud: StoredCloud, most: int) -> FieldDeviation | None:
    """Decimate a cloud to about `most` points and take its smooth skin off; None where there are too few."""
    height, width = cloud.flags.shape
    stride = max(1, int(np.ceil(np.sqrt(height * width / most))))
    v, u = np.arange(0, height, stride), np.arange(0, width, stride)
    points = cloud.points[::stride, ::stride].astype(float)
    valid = np.isfinite(points[..., 2])
    if valid.sum() < _FEWEST:
        return None
    flat = points[valid]
    middle = flat.mean(axis=0)
    frame = Frame.on_plane(middle, np.linalg.svd(_some(flat - middle), full_matrices=False)[2][2])
    x, y, h = frame.local(flat).T
    sigma = np.full(len(x), 0.005)
    chosen = np.linspace(0, len(x) - 1, min(len(x), _FIT_POINTS)).astype(int)
    skin = fit_surface(x[chosen], y[chosen], h[chosen], sigma[chosen], _ORDER, np.random.default_rng(0))
    if skin is None:
        return None
    deviation = h - monomials(x, y, _ORDER) @ skin.coefficients

    def grid(values: Array) -> NDArray[np.float32]:
        image = np.full(valid.shape, np.nan, np.float32)
        image[valid] = values
        return image

    return FieldDeviation(u, v, grid(x), grid(y), grid(deviation))


def _some(points: Array) -> Array:
    return points[:: max(1, len(points) // _FIT_POINTS)]

"""Images at places between pixels, without the 1/32-pixel steps of cv2.remap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array


def sample_image(image: NDArray[np.float32], pixels: Array) -> Array:
    """(…) bilinear values of an image at (…, 2) pixels u, v; NaN beyond the border."""
    height, width = image.shape
    u, v = pixels[..., 0], pixels[..., 1]
    inside = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    x, y = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
    i, j = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    p, q = x - i, y - j
    above = image[j, i] * (1 - p) + image[j, i + 1] * p
    below = image[j + 1, i] * (1 - p) + image[j + 1, i + 1] * p
    return np.asarray(np.where(inside, above * (1 - q) + below * q, np.nan))

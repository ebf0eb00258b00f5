"""The kernel that samples patches, against SciPy."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from metrology.texture_offset import sample_patches


def test_patches_are_sampled_as_scipy_does_it() -> None:
    rng = np.random.default_rng(3)
    image = rng.normal(size=(40, 60)).astype(np.float32)
    count = 30
    origin = rng.uniform([-5, -5], [65, 45], (count, 2))  # some beyond the border
    matrix = np.eye(2) + 0.2 * rng.normal(size=(count, 2, 2))
    shift = rng.normal(size=(count, 2))
    offset = rng.integers(-6, 7, (50, 2))
    values = np.empty((count, len(offset)))
    sample_patches(image, origin, matrix, shift, offset, values)
    places = origin[:, None] + (offset[None] + shift[:, None]) @ np.swapaxes(matrix, 1, 2)
    expected = map_coordinates(image.astype(float), [places[..., 1], places[..., 0]], order=1, mode="nearest")
    np.testing.assert_allclose(values, expected, atol=1e-5)

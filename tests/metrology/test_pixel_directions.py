"""Directions of all pixels at once, against OpenCV's solver for one pixel, and through the lens and back."""

from __future__ import annotations

import numpy as np
import pytest

from metrology.pixel_directions import pixel_directions
from metrology.rig import Device

WIDTH, HEIGHT = 321, 203


def _camera(focal: float, *distortion: float) -> Device:
    K = np.array([[focal, 0, 158.0], [0, 1.01 * focal, 99.0], [0, 0, 1]])
    return Device(width=WIDTH, height=HEIGHT, K=K, distortion=np.array(distortion), R=np.eye(3), t=np.zeros(3))


def _pixels() -> np.ndarray:
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    return np.stack([u, v], axis=-1)


@pytest.mark.parametrize(
    "distortion",
    [
        (),
        (-0.3, 0.1, 1e-3, -2e-3),
        (0.2, 0.1, 1e-3, 1e-3, 0.01, 0.3, 0.1, 0.02),
        (-0.1, 0.1, 1e-3, 1e-3, 0.01, 0, 0, 0, 6e-3, -2e-3, -4e-3, 1e-3),
    ],
    ids=["no distortion", "barrel and tangential", "rational", "thin prism"],
)
def test_every_pixel_as_opencv_has_it(distortion: tuple[float, ...]) -> None:
    camera = _camera(300.0, *distortion)
    found = pixel_directions(camera)
    np.testing.assert_allclose(found, camera.normalized(_pixels()), rtol=0, atol=1e-12)
    np.testing.assert_allclose(camera.through_lens(found[..., 0], found[..., 1]), _pixels(), rtol=0, atol=1e-9)


def test_a_strong_lens_is_solved_where_opencv_stops_early() -> None:
    camera = _camera(60.0, -0.3, 0.1, 1e-3, -2e-3)
    found = pixel_directions(camera)
    np.testing.assert_allclose(camera.through_lens(found[..., 0], found[..., 1]), _pixels(), rtol=0, atol=1e-9)
    theirs = np.moveaxis(camera.normalized(_pixels()), -1, 0)
    assert np.abs(camera.through_lens(*theirs) - _pixels()).max() > 1e-3


def test_rows_of_a_lens_that_folds_the_corners_are_opencvs() -> None:
    camera = _camera(180.0, -0.3, 0.0, 0.0, 0.0)
    found, theirs = pixel_directions(camera), camera.normalized(_pixels())
    np.testing.assert_array_equal(found[0], theirs[0])
    np.testing.assert_allclose(found[HEIGHT // 2], theirs[HEIGHT // 2], rtol=0, atol=1e-12)

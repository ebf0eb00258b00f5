"""Devices: many points are projected as OpenCV projects them one by one."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from metrology.rig import Device
from tests.support.calibration_bench import bench_rig

LENSES = ((), (-0.1, 0.08, 1e-3, -2e-3), (-0.1, 0.08, 1e-3, -2e-3, 0.03), (0.2, -0.1, 1e-3, 2e-3, 0.05, 0.1, -0.2, 0.3),
          (-0.1, 0.08, 1e-3, -2e-3, 0.03, 0, 0, 0, 8e-3, -4e-3, 6e-3, 1e-3))  # fmt: skip


def by_opencv(device: Device, points: np.ndarray) -> np.ndarray:
    turn, lens = cv2.Rodrigues(device.R)[0], device.lens
    return cv2.projectPoints(points.reshape(-1, 1, 3), turn, device.t, device.K, lens)[0].reshape(-1, 2)


@pytest.mark.parametrize("lens", LENSES, ids=len)
def test_many_points_fall_where_opencv_has_them(lens: tuple[float, ...], rng: np.random.Generator) -> None:
    right = bench_rig().with_right()
    device = replace(right, distortion=np.array(lens), R=right.R.round(5))  # as files have it that round
    points = rng.normal((0, 0, 700), 60, (20_000, 3))
    points[:2] = (-device.R.T @ device.t, (np.nan, 0, 700))
    expected = by_opencv(device, points)
    np.testing.assert_allclose(device.project(points[1:]), expected[1:], atol=1e-9)
    np.testing.assert_allclose(device.project(points[1:101].reshape(10, 10, 3)).reshape(-1, 2), expected[1:101])


def test_a_point_in_the_middle_of_the_lens_is_no_error(rng: np.random.Generator) -> None:
    left = bench_rig().left
    points = rng.normal((0, 0, 700), 60, (1000, 3))
    points[:2] = (0, 0, 0), (1e200, 0, 1e-200)
    of_numbers = [0, *range(2, 1000)]
    np.testing.assert_allclose(left.project(points)[of_numbers], by_opencv(left, points)[of_numbers])


def test_no_points_have_no_pixels() -> None:
    assert bench_rig().left.project(np.empty((0, 5, 3))).shape == (0, 5, 2)

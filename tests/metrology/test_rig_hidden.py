"""What two cameras would not show of their calibration, against epipolar distances and lengths computed another way."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.rig import Rig
from metrology.rig_hidden import hidden_errors
from tests.support.rendered_fringes import PLANE_DISTANCE, PLANE_NORMAL, plane_depth, small_rig

LIMIT_PX = 0.05


def cloud(rig: Rig) -> Reconstruction:
    """A plane with waves, so that depths differ."""
    points = plane_depth(rig.left, PLANE_NORMAL, PLANE_DISTANCE)
    points = points * (1 + 0.02 * np.sin(np.arange(rig.left.width) / 20))[:, None]
    nothing = np.zeros(points.shape[:2], np.uint16)
    return Reconstruction(rig, None, None, points.astype(np.float32), nothing.astype(np.float32), nothing)  # type: ignore[arg-type]


def off_the_lines(rig: Rig, left: Array, right: Array) -> float:
    """RMS distance, pixels, of (n, 3) rays of the right camera from the epipolar planes of the left one's."""
    second = rig.with_right()
    normals = np.cross(left @ second.R.T, second.R @ second.centre)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return float(np.sqrt(np.mean(((right @ second.R.T * normals).sum(1) * second.K[0, 0]) ** 2)))


def triangulated(rig: Rig, pixels: list[Array]) -> Array:
    """OpenCV's, of undistorted directions."""
    cameras = (rig.left, rig.with_right())
    seen = [cv2.undistortPoints(p[:, None], d.K, d.distortion)[:, 0].T for p, d in zip(pixels, cameras, strict=True)]
    poses = [np.column_stack([d.R, d.t]) for d in cameras]
    found = cv2.triangulatePoints(poses[0], poses[1], seen[0], seen[1])
    return np.asarray((found[:3] / found[3]).T)


def test_amounts_leave_the_limit_and_change_lengths_as_said() -> None:
    rig = replace(small_rig(), projector=None)
    seen = cloud(rig)
    yaw, focal = hidden_errors(seen, LIMIT_PX)
    points = seen.points.reshape(-1, 3)[::37].astype(float)
    pixels = [device.project(points) for device in (rig.left, rig.with_right())]
    turn = np.asarray(cv2.Rodrigues(np.array([0.0, yaw.amount, 0.0]))[0]) @ rig.with_right().R
    grown = np.array([[1 + focal.amount, 1, 1], [1, 1 + focal.amount, 1], [1, 1, 1]])
    turned = replace(rig, right=replace(rig.with_right(), R=turn, t=-turn @ rig.with_right().centre))
    zoomed = replace(
        rig, left=replace(rig.left, K=rig.left.K * grown), right=replace(rig.with_right(), K=rig.with_right().K * grown)
    )
    assert yaw.name == "yaw"
    assert focal.name == "focal lengths"
    for found, wrong in ((yaw, turned), (focal, zoomed)):
        rays = [device.rays(p) for p, device in zip(pixels, (wrong.left, wrong.with_right()), strict=True)]
        assert off_the_lines(wrong, *rays) == pytest.approx(LIMIT_PX, rel=0.15)
        moved = triangulated(wrong, pixels)
        ratio = np.linalg.norm(moved - moved.mean(0)) / np.linalg.norm(points - points.mean(0))
        assert abs(ratio - 1) == pytest.approx(found.lengths, rel=0.35)
        assert found.lengths > 0.001


def test_twice_the_limit_hides_twice_as_much() -> None:
    seen = cloud(replace(small_rig(), projector=None))
    for one, other in zip(hidden_errors(seen, LIMIT_PX), hidden_errors(seen, 2 * LIMIT_PX), strict=True):
        assert other.amount == pytest.approx(2 * one.amount, rel=1e-6)
    assert hidden_errors(replace(seen, points=np.full_like(seen.points, np.nan)), LIMIT_PX) == []

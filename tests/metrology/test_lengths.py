"""Lengths between points, faces and features of a board in one cloud: true to within their U95; a rig's scale shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrology.arrays import Array
from metrology.calibration.board import Board
from metrology.calibration.detect_board import BoardView
from metrology.cloud import Reconstruction
from metrology.errors import SceneError
from metrology.rig import Rig
from metrology.verification.lengths import board_in_scan, face_lengths, point_lengths, sphere_lengths
from tests.support.rendered_fringes import plane_depth, small_rig

SIGMA = 0.02
NORMAL = np.array([0.2, -0.1, -1.0]) / np.linalg.norm([0.2, -0.1, -1.0])
MIDDLE = np.array([0.0, 0.0, 700.0])


def plane(rig: Rig, ahead: float = 0.0) -> Array:
    """(h, w, 3) where the left camera sees a plane, `ahead` mm nearer than the usual one."""
    return plane_depth(rig.left, NORMAL, float(NORMAL @ MIDDLE) + ahead)


def cloud(rig: Rig, points: Array, rng: np.random.Generator) -> Reconstruction:
    noise = rng.normal(0, SIGMA, points.shape[:2])
    seen = (points + noise[..., None] * points / points[..., 2:]).astype(np.float32)
    sigma = np.full(points.shape[:2], SIGMA, np.float32)
    return Reconstruction(rig, None, None, seen, sigma, np.zeros(points.shape[:2], np.uint16))  # type: ignore[arg-type]


def test_points_and_faces_are_true_to_within_their_u95() -> None:
    rig, rng = small_rig(), np.random.default_rng(2)
    far, near = plane(rig), plane(rig, 1.5)
    points = np.where(np.arange(rig.left.width)[:, None] < 160, far, near)
    length = float(np.linalg.norm(near[150, 260] - far[90, 40]))
    apart, steps, angles = [], [], []
    for _ in range(60):
        seen = cloud(rig, points, rng)
        (one,) = point_lengths(seen, [(40.0, 90.0), (260.0, 150.0)])
        step, angle = face_lengths(seen, [(20, 40, 100, 150), (180, 60, 90, 90)])
        apart.append(abs(one.value - length) <= one.u95)
        steps.append(abs(step.value - 1.5) <= step.u95)
        angles.append(angle.value <= 2 * angle.u95)
    assert np.mean(apart) >= 0.9
    assert np.mean(steps) >= 0.88
    assert np.mean(angles) >= 0.9
    assert step.u95 < 0.01


def test_a_wall_behind_spheres_is_none() -> None:
    rig, rng = small_rig(), np.random.default_rng(3)
    points, rays = plane(rig), plane(rig) / np.linalg.norm(plane(rig), axis=-1, keepdims=True)
    middles = np.array([[-75.0, 10.0, 640.0], [75.0, -8.0, 650.0]])
    for middle in middles:
        along = rays @ middle
        inside = 30.0**2 - middle @ middle + along**2
        points = np.where((inside > 0)[..., None], (along - np.sqrt(np.maximum(inside, 0)))[..., None] * rays, points)
    found = sphere_lengths(cloud(rig, points, rng), 60.0)
    assert [one.name for one in found] == ["diameter of sphere 1", "diameter of sphere 2", "centre 1 to centre 2"]
    for one, value in zip(found, (60.0, 60.0, float(np.linalg.norm(middles[1] - middles[0]))), strict=True):
        assert abs(one.value - value) <= one.u95
    pixel = 645.0 / rig.left.K[0, 0]
    assert 10 * pixel**2 / 60 < found[0].u95 < 40 * pixel**2 / 60  # a window smooths by so much


def test_a_board_tells_the_rig_s_scale() -> None:
    """The same pixels and a cloud 1 % too large; and the true one."""
    rig, rng = small_rig(), np.random.default_rng(4)
    board = Board("chessboard", 9, 6, 12.0)
    across = np.cross([0.0, 1.0, 0.0], NORMAL)
    axes = np.stack([across, np.cross(NORMAL, across)]) / np.linalg.norm(across)
    centred = board.points[:, :2] - board.points[:, :2].mean(0)
    pixels = rig.left.project(MIDDLE + centred @ axes) + rng.normal(0, 0.03, centred.shape)
    view = BoardView(np.arange(54), pixels, np.full(54, 0.03), 1.0, (rig.left.width, rig.left.height))
    for factor, expected in ((1.0, 0.0), (1.01, 1.0)):
        found = {one.name: one for one in board_in_scan(cloud(rig, factor * plane(rig), rng), board, view)}
        assert found["scale"].value == pytest.approx(expected, abs=max(found["scale"].u95, 0.02))
        row = found["longest row"]
        assert row.nominal == pytest.approx(96.0)
        assert row.value == pytest.approx(96.0 * factor, abs=row.u95)
    assert found["scale"].u95 < 0.05
    pixels[0] += 5.0  # a corner in a reflection
    moved = {one.name: one for one in board_in_scan(cloud(rig, plane(rig), rng), board, replace(view, pixels=pixels))}
    assert abs(moved["scale"].value) <= moved["scale"].u95 < 0.05


def test_where_nothing_is_seen_nothing_is_measured() -> None:
    rig, rng = small_rig(), np.random.default_rng(4)
    seen = cloud(rig, plane(rig), rng)
    empty = replace(seen, points=np.full_like(seen.points, np.nan))
    with pytest.raises(SceneError, match="found 0 points at pixel 40,90"):
        point_lengths(empty, [(40.0, 90.0), (260.0, 150.0)])
    with pytest.raises(SceneError, match="found 0 points at the box 50,40,9,9"):
        face_lengths(empty, [(50, 40, 9, 9), (1, 1, 9, 9)])
    for box in ((500, 40, 9, 9), (40, -60, 9, 20), (40, 60, -3, 9)):  # rows -60 to -40 are not counted from below
        with pytest.raises(SceneError, match=f"found the box {','.join(map(str, box))}, expected a place in the left"):
            face_lengths(seen, [box, (1, 1, 9, 9)])
    with pytest.raises(SceneError, match="found pixel 40,-20, expected a place in the left image of 320×240"):
        point_lengths(seen, [(40.0, -20.0), (260.0, 150.0)])
    with pytest.raises(SceneError, match="found no sphere of 20 mm"):
        sphere_lengths(seen, 20.0)

"""Simulated calibration captures: every feature is where the rig puts it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from metrology.fringe import FringeCode
from simulator.board import PrintedBoard, _pack, _printed
from simulator.calibration import CaptureSettings, DotGrid, board_poses, render_calibration
from simulator.rig import RigDesign, virtual_rig
from simulator.sensor import Sensor

# A quarter of the resolution: the board fills the picture as on the full-size rig.
QUARTER = RigDesign(camera_width=406, camera_height=308, camera_focal_px=910.0)
QUIET = CaptureSettings(poses=1, tilt_deg=10.0, samples=64, sensor=Sensor(gain=0, read_noise=0, bits=16))


@pytest.fixture(scope="module")
def rig():
    return virtual_rig(np.random.default_rng(2), QUARTER)


def centroid(light, at, half):
    """Centre of what differs from the surroundings' level in a window."""
    u0, v0 = np.rint(at).astype(int) - half
    part = light[v0 : v0 + 2 * half + 1, u0 : u0 + 2 * half + 1].astype(float)
    rim = np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]])
    weight = np.abs(part - np.median(rim))
    weight[weight < 0.15 * weight.max()] = 0
    v, u = np.mgrid[v0 : v0 + 2 * half + 1, u0 : u0 + 2 * half + 1]
    return np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()


def test_printed_dots_are_where_the_pose_puts_them(rig):
    capture = render_calibration(rig, np.random.default_rng(4), settings=QUIET)
    (shot,) = capture.poses
    r, c = np.mgrid[:11, :7]
    dots = np.stack([(2 * c + r % 2) * 15.0, r * 15.0, 0.0 * r], axis=-1).reshape(-1, 3)
    for side in ("left", "right"):
        frames = shot.frames[side]
        light = frames["white"].astype(float) - frames["dark"]
        expected = getattr(rig, side).project(shot.pose.to_rig(dots))
        found = np.array([centroid(light, at, 9) for at in expected])
        # A dot's centre and the centre of its image differ a little; light is uneven.
        assert np.abs(found - expected).max() < 0.06
        assert np.abs((found - expected).mean(axis=0)).max() < 0.03


def test_projected_dots_are_where_the_projector_puts_them(rig):
    board = PrintedBoard(ink=0.8)
    capture = render_calibration(rig, np.random.default_rng(4), board, settings=QUIET)
    (shot,) = capture.poses
    grid = DotGrid()
    R, t = shot.pose.R, shot.pose.t
    used = 0
    for row, col in ((6, 5), (8, 6), (9, 7), (10, 5), (7, 4)):
        pixel = np.array([grid.origin_px[0] + (2 * col + row % 2) * 48.0, grid.origin_px[1] + row * 48.0])
        ray = rig.projector.rays(pixel)
        centre = rig.projector.centre
        point = centre + ray * ((t - centre) @ R[:, 2]) / (ray @ R[:, 2])
        for side in ("left", "right"):
            light = shot.frames[side]["dots"].astype(float) - shot.frames[side]["dark"]
            at = getattr(rig, side).project(point)
            np.testing.assert_allclose(centroid(light, at, 6), at, atol=0.06)
            used += 1
    assert used == 10


def test_fringes_replace_dots(rig):
    settings = CaptureSettings(poses=1, samples=16, fringe=FringeCode("x", 4, (7, 6, 5)), rows_counts=(5, 4, 3))
    capture = render_calibration(rig, np.random.default_rng(1), settings=settings)
    frames = capture.poses[0].frames["left"]
    assert capture.dots is None
    assert frames["fringes_x"].shape == frames["fringes_y"].shape == (12, 308, 406)
    assert set(frames) == {"white", "dark", "fringes_x", "fringes_y"}


def test_poses_are_varied_and_in_view(rig, rng):
    board, settings = PrintedBoard(), CaptureSettings(poses=12)
    poses = board_poses(rig, board, settings, rng)
    x0, x1, y0, y1 = board.corners_mm
    corners = np.array([[x0, y0, 0], [x1, y0, 0], [x0, y1, 0], [x1, y1, 0.0]])
    for pose in poses:
        for device in (rig.left, rig.right):
            assert device.inside(device.project(pose.to_rig(corners))).all()
    tilts = [np.degrees(np.arccos(abs(p.R[2, 2]))) for p in poses]
    assert np.ptp(tilts) > 5


def test_capture_describes_itself_as_the_format_wants():
    assert PrintedBoard().as_dict() == {
        "type": "asymmetric_circles", "cols": 7, "rows": 11, "spacing_mm": 15.0, "dot_diameter_mm": 8.0,
    }  # fmt: skip
    assert set(DotGrid().as_dict()) == {
        "type", "cols", "rows", "spacing_px", "origin_px", "diameter_px", "marker_diameter_px", "markers",
    }  # fmt: skip
    assert "marker_mm" in PrintedBoard("charuco", 8, 6, 20.0).as_dict()


def test_markers_are_larger():
    picture = DotGrid().image(1280, 800)
    column, row = 40 + (2 * 6 + 1) * 48, 40 + 7 * 48
    assert picture[row, column] == 1
    assert picture[row, column + 16] == 1
    assert picture[row, column + 2 * 48 + 16] == 1
    assert picture[row - 3 * 48 + 0, column - 48 + 16] == 0
    assert 0 < np.sort(np.unique(picture))[1] < 1


@pytest.mark.parametrize(("kind", "layout"), [("chessboard", "new"), ("charuco", "new"), ("charuco", "old")])
def test_other_boards_are_what_opencv_finds(kind, layout):
    # Draw the print straight on at 5 px per mm and let OpenCV find its corners.
    board = PrintedBoard(kind, 7, 6, 12.0, marker_mm=9.0, border_mm=12.0, layout=layout)
    packed = _pack(board)
    x0, x1, y0, y1 = board.corners_mm
    x, y = np.arange(x0 + 0.1, x1, 0.2), np.arange(y0 + 0.1, y1, 0.2)
    picture = np.array([[_printed.py_func(packed, a, b) for a in x] for b in y])
    grey = cv2.GaussianBlur((255 * picture).astype(np.uint8), (0, 0), 1.5)
    if kind == "chessboard":
        found, corners = cv2.findChessboardCornersSB(grey, (7, 6))
        assert found
        corners = corners.reshape(-1, 2)
        first, last = np.array([0.0, 0.0]), np.array([6 * 12.0, 5 * 12.0])
    else:
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
        printed = cv2.aruco.CharucoBoard((7, 6), 12.0, 9.0, dictionary)
        printed.setLegacyPattern(layout == "old")
        detector = cv2.aruco.CharucoDetector(printed)
        corners, ids, _, _ = detector.detectBoard(grey)
        assert len(ids) == 6 * 5
        corners = corners.reshape(-1, 2)
        first, last = np.array([12.0, 12.0]), np.array([6 * 12.0, 5 * 12.0])
    mm = corners * 0.2 + [x0 + 0.1, y0 + 0.1]
    ends = {tuple(np.rint(mm[0]).astype(int)), tuple(np.rint(mm[-1]).astype(int))}
    assert ends == {tuple(first.astype(int)), tuple(last.astype(int))}

"""Boards in pictures: all kinds are found where they are, and what is wrong with a picture is said."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.calibration.board import Board
from metrology.calibration.calibrate import calibrate
from metrology.calibration.corner_edge import fit_corner
from metrology.calibration.detect import Detection, detect
from metrology.calibration.detect_board import BoardView, detect_board
from metrology.calibration.detect_projection import detect_projected_dots
from metrology.calibration.eccentricity import eccentricity
from metrology.calibration.frames import CAMERAS, BoardFrames
from metrology.calibration.fringe_features import coded_features
from metrology.calibration.homography import apply_homography
from metrology.calibration.placing import symmetries
from metrology.calibration.projected_dots import ProjectedDots
from metrology.calibration.sightings import of_one_layout
from metrology.errors import CalibrationError

CIRCLES = Board("asymmetric_circles", 5, 7, 15.0, 8.0)
CHESSBOARD = Board("chessboard", 7, 6, 20.0)
CHARUCO = Board("charuco", 8, 6, 20.0, marker_mm=14.0, dictionary="DICT_5X5_100")
PATTERN = ProjectedDots(9, 12, 40.0, (24.0, 24.0), 20.0, 30.0, ((5, 4), (5, 5), (7, 4)))
SHAPE = (620, 760)
# Board mm, and projector pixels, to camera pixels: two views of one tilted plane.
FROM_BOARD = np.array([[3.9, 0.35, 90.0], [-0.25, 3.6, 110.0], [4e-4, -3e-4, 1.0]])
FROM_PROJECTOR = np.array([[0.95, 0.10, 30.0], [-0.06, 0.98, 45.0], [8e-5, 1e-4, 1.0]])


FINE = 3  # samples per pixel and axis


def plane_points(homography: NDArray[np.float64]) -> NDArray[np.float64]:
    """(h·FINE, w·FINE, 2) points of the plane that a camera's samples see."""
    v, u = (np.mgrid[: FINE * SHAPE[0], : FINE * SHAPE[1]] + 0.5) / FINE - 0.5
    flat = apply_homography(np.linalg.inv(homography), np.stack([u, v], -1).reshape(-1, 2))
    return flat.reshape(FINE * SHAPE[0], FINE * SHAPE[1], 2)


def in_discs(plane: NDArray[np.float64], spacing: float, radii: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether points lie in discs of an asymmetric grid that begins at the origin; radii are (rows, cols)."""
    inside = np.zeros(plane.shape[:2], bool)
    row = np.clip(np.rint(plane[..., 1] / spacing), 0, len(radii) - 1).astype(int)
    for near in (row - 1, row, row + 1):
        r = np.clip(near, 0, len(radii) - 1)
        c = np.clip(np.rint((plane[..., 0] / spacing - r % 2) / 2), 0, radii.shape[1] - 1).astype(int)
        away = np.hypot(plane[..., 0] - (2 * c + r % 2) * spacing, plane[..., 1] - r * spacing)
        inside |= away < radii[r, c]
    return inside


@cache
def board_plane() -> NDArray[np.float64]:
    return plane_points(FROM_BOARD)


@cache
def projected_discs() -> NDArray[np.float64]:
    """1 at the samples that a dot of the pattern lights."""
    radii = PATTERN.radii.reshape(PATTERN.rows, PATTERN.cols)
    return in_discs(plane_points(FROM_PROJECTOR) - PATTERN.origin_px, PATTERN.spacing_px, radii).astype(float)


def reflectance(board: Board, old_layout: bool = False) -> NDArray[np.float64]:
    """The print on paper with a margin, at every sample; nothing beyond."""
    plane = board_plane()
    x, y = plane[..., 0], plane[..., 1]
    s = board.spacing_mm
    low, high = board.points[:, :2].min(0) - 1.6 * s, board.points[:, :2].max(0) + 1.6 * s
    paper = (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
    image = np.where(paper, 0.8, 0.02)
    if board.has_dots:
        image[in_discs(plane, s, np.full((board.rows, board.cols), board.radius_mm))] = 0.06
    elif board.kind == "chessboard":
        squares = (x > -s) & (x < board.cols * s) & (y > -s) & (y < board.rows * s)
        image[squares & ((np.floor(x / s) + np.floor(y / s)) % 2 == 0)] = 0.06
    else:
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
        printed = cv2.aruco.CharucoBoard((board.cols, board.rows), s, float(board.marker_mm or 0), dictionary)
        printed.setLegacyPattern(old_layout)
        drawing = printed.generateImage((board.cols * 200, board.rows * 200))
        j, i = np.floor(y / s * 200).astype(int), np.floor(x / s * 200).astype(int)
        on = (i >= 0) & (j >= 0) & (i < drawing.shape[1]) & (j < drawing.shape[0])
        image[on] = np.where(drawing[j[on], i[on]] > 127, 0.8, 0.06)
    return image


@cache
def frames(board: Board, seed: int = 1, blur_px: float = 0.7, old_layout: bool = False) -> BoardFrames:
    rng = np.random.default_rng(seed)
    print_ = reflectance(board, old_layout)

    def taken(light: NDArray[np.float64] | float) -> NDArray[np.uint8]:
        seen = (print_ * (20.0 + 180.0 * light)).reshape(SHAPE[0], FINE, SHAPE[1], FINE).mean((1, 3))
        blurred = cv2.GaussianBlur(seen, (0, 0), blur_px)
        return np.clip(np.rint(blurred + rng.normal(0, 1.0, SHAPE)), 0, 255).astype(np.uint8)

    return BoardFrames(taken(1.0), taken(0.0), taken(projected_discs()))


@pytest.fixture(scope="module")
def circles() -> BoardFrames:
    return frames(CIRCLES)


def true_centres(board: Board, view: BoardView) -> NDArray[np.float64]:
    return apply_homography(FROM_BOARD, board.points[view.index, :2])


def test_dots_are_found_within_three_hundredths_of_a_pixel(circles: BoardFrames) -> None:
    view = detect_board(circles, CIRCLES)
    assert len(view.index) == len(CIRCLES.points)
    offset = eccentricity(lambda p: apply_homography(FROM_BOARD, p), CIRCLES.points[view.index, :2], CIRCLES.radius_mm)
    assert np.abs(view.pixels - offset - true_centres(CIRCLES, view)).max() < 0.03


def test_projected_dots_are_told_apart_from_the_print(circles: BoardFrames) -> None:
    view = detect_projected_dots(circles, PATTERN)
    assert len(view.index) > 25
    centres, radii = PATTERN.centres[view.index], PATTERN.radii[view.index]
    offset = eccentricity(lambda p: apply_homography(FROM_PROJECTOR, p), centres, radii)
    error = np.linalg.norm(view.pixels - offset - apply_homography(FROM_PROJECTOR, centres), axis=1)
    assert np.median(error) < 0.03
    assert error.max() < 0.15


@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO])
def test_corners_are_found_within_three_hundredths_of_a_pixel(board: Board) -> None:
    view = detect_board(frames(board), board)
    assert len(view.index) >= 0.9 * len(board.points)
    error = view.pixels - true_centres(board, view)
    assert np.sqrt(np.mean(error**2)) < 0.03


@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO])
@pytest.mark.parametrize("brighter", [1.6, 2.5])
def test_corners_are_found_as_well_where_white_is_clipped(board: Board, brighter: float) -> None:
    sound = frames(board)
    clipped = BoardFrames(np.clip(np.rint(brighter * sound.white), 0, 255).astype(np.uint8), sound.dark)
    assert clipped.saturated.mean() > 0.25
    view = detect_board(clipped, board)
    assert len(view.index) >= 0.9 * len(board.points)
    error = view.pixels - true_centres(board, view)
    assert np.sqrt(np.mean(error**2)) < 0.03


def test_a_corner_is_found_from_a_start_that_a_detector_has_off() -> None:
    image = frames(CHESSBOARD).lit
    true = apply_homography(FROM_BOARD, CHESSBOARD.points[[17], :2])[0]
    ahead = apply_homography(FROM_BOARD, CHESSBOARD.points[17, :2] + np.eye(2)) - true
    along = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    for off in ((1.9, 0.0), (-1.2, 1.4)):
        found = fit_corner(
            image, true + np.array(off), along, 0.4 * CHESSBOARD.spacing_mm * float(np.linalg.norm(ahead[0]))
        )
        assert found is not None
        assert np.abs(found.centre - true).max() < 0.05


def turned_labels(of: BoardFrames, board: Board, quarters: int) -> tuple[BoardView, NDArray[np.intp]]:
    """The board in a picture turned by quarters of a turn, and which features it truly shows."""
    assert of.dark is not None
    view = detect_board(BoardFrames(np.rot90(of.white, quarters).copy(), np.rot90(of.dark, quarters).copy()), board)
    rows, columns = np.rot90(np.mgrid[: SHAPE[0], : SHAPE[1]], quarters, (1, 2))
    u, v = np.rint(view.pixels).astype(int).T
    on_board = apply_homography(np.linalg.inv(FROM_BOARD), np.column_stack([columns[v, u], rows[v, u]]))
    away = np.linalg.norm(on_board[:, None] - board.points[None, :, :2], axis=-1)
    assert away.min(1).max() < 0.1 * board.spacing_mm
    return view, np.argmin(away, axis=1)


@pytest.mark.parametrize(
    ("board", "quarters"),
    [
        (CHESSBOARD, 1),
        (CHESSBOARD, 2),
        (Board("chessboard", 6, 6, 20.0), 1),
        (Board("asymmetric_circles", 5, 8, 14.0, 8.0), 1),
        (CHARUCO, 1),
    ],
)
def test_turned_pictures_show_the_board_up_to_its_symmetry(board: Board, quarters: int) -> None:
    view, shown = turned_labels(frames(board), board, quarters)
    assert len(view.index) >= 0.9 * len(board.points)
    assert any(np.array_equal(turn[shown], view.index) for turn in symmetries(board))


@pytest.mark.parametrize("quarters", [0, 3])
def test_a_charuco_board_of_the_old_layout_is_read_and_said(quarters: int) -> None:
    view, shown = turned_labels(frames(CHARUCO, old_layout=True), CHARUCO, quarters)
    assert view.layout == "old"
    assert len(view.index) >= 0.9 * len(CHARUCO.points)
    assert np.array_equal(shown, view.index)
    assert detect_board(frames(CHARUCO), CHARUCO).layout == "new"


def test_another_layout_in_one_picture_is_another_board() -> None:
    new, old = (detect_board(frames(CHARUCO, old_layout=of), CHARUCO) for of in (False, True))
    seen = [
        Detection(pose, camera, (760, 620), old if (pose, camera) == (1, "left") else new, None, None, ())
        for pose in range(3)
        for camera in CAMERAS
    ]
    with pytest.raises(CalibrationError, match=r"in 2 of 3 poses.*pose 1: left: found the old layout.*another board"):
        calibrate(seen, CHARUCO)


def test_a_picture_that_fits_both_layouts_is_read_as_the_others_are() -> None:
    board = Board("charuco", 7, 6, 20.0, marker_mm=14.0, dictionary="DICT_5X5_100")
    whole = frames(board, old_layout=True)
    sure = detect_board(whole, board)
    assert (sure.layout, sure.otherwise) == ("old", None)
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    x = apply_homography(np.linalg.inv(FROM_BOARD), np.stack([u, v], -1).reshape(-1, 2))[:, 0].reshape(SHAPE)
    cut = (x < 21) | (x > 119)  # without the outer columns nothing tells which squares the markers are counted from
    hidden = BoardFrames(
        np.where(cut, 90, whole.white).astype(np.uint8), np.where(cut, 10, whole.dark).astype(np.uint8)
    )
    part = detect_board(hidden, board)
    assert part.otherwise is not None
    assert {part.layout, part.otherwise.layout} == {"new", "old"}
    seen = [Detection(pose, "left", (760, 620), of, None, None, ()) for pose, of in enumerate((sure, part))]
    layout, kept = of_one_layout(seen, {0: [], 1: []})
    assert layout == "old"
    assert [detection.board.layout for detection in kept if detection.board] == ["old", "old"]


def test_every_feature_gets_the_projector_coordinate_of_the_fringes(circles: BoardFrames) -> None:
    view = detect_board(circles, CIRCLES)
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    coordinate = apply_homography(np.linalg.inv(FROM_PROJECTOR), np.stack([u, v], -1).reshape(-1, 2)).reshape(*SHAPE, 2)
    coordinate += np.random.default_rng(2).normal(0, 0.05, coordinate.shape)
    coordinate[circles.lit < 60] = np.nan  # nothing is decoded on print
    coded = coded_features(view, coordinate, CIRCLES)
    assert len(coded.index) == len(view.index)
    seen = apply_homography(FROM_BOARD, CIRCLES.points[coded.index, :2])
    truth = apply_homography(np.linalg.inv(FROM_PROJECTOR), seen)
    assert np.abs(coded.projector_px - truth).max() < 0.03


def with_all(change: object, of: BoardFrames) -> BoardFrames:
    return BoardFrames(*(change(image) for image in (of.white, of.dark, of.dots)))  # type: ignore[operator]


def half_hidden(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    hidden = image.copy()
    hidden[:, : SHAPE[1] // 2] = 2
    return hidden


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (half_hidden, "half in view"),
        (lambda image: cv2.GaussianBlur(image, (0, 0), 7.0), "blurred"),
        (lambda image: np.full_like(image, 3), "dark"),
        (lambda image: np.minimum(image.astype(int) * 3, 255).astype(np.uint8), "overexposed"),
    ],
)
def test_what_is_wrong_with_a_picture_is_said(circles: BoardFrames, change: object, said: str) -> None:
    with pytest.raises(CalibrationError, match=said):
        detect_board(with_all(change, circles), CIRCLES)


@pytest.mark.parametrize(
    ("board", "said"),
    [
        (replace(CIRCLES, cols=4), "wrong board size"),
        (replace(CIRCLES, rows=6), "wrong board size"),
        (replace(CIRCLES, cols=6), "another one"),
        (replace(CIRCLES, rows=9), "another one"),
        (replace(CIRCLES, dot_diameter_mm=11.0), "wrong sizes"),
        (CHESSBOARD, "did not find"),
        (CHARUCO, "found 0 of"),
    ],
)
def test_another_board_than_described_is_refused(circles: BoardFrames, board: Board, said: str) -> None:
    with pytest.raises(CalibrationError, match=said):
        detect_board(circles, board)


def test_a_larger_chessboard_than_described_is_refused() -> None:
    with pytest.raises(CalibrationError, match="wrong board size"):
        detect_board(frames(CHESSBOARD), replace(CHESSBOARD, cols=6))


def test_a_smaller_chessboard_than_described_is_named() -> None:
    with pytest.raises(CalibrationError, match=r"found one of (7 × 6|6 × 7) inner corners"):
        detect_board(frames(CHESSBOARD), replace(CHESSBOARD, cols=9))


def test_lost_dots_leave_the_board_and_a_reason(circles: BoardFrames) -> None:
    found = detect(4, "left", replace(circles, dots=circles.dark), CIRCLES, PATTERN)
    assert found.board is not None
    assert found.projected is None
    assert "0 projected dots" in found.reasons[0]


def test_without_markers_dots_are_not_guessed(circles: BoardFrames) -> None:
    elsewhere = replace(PATTERN, markers=((0, 0), (0, 1), (2, 0)))
    with pytest.raises(CalibrationError, match="markers"):
        detect_projected_dots(circles, elsewhere)


def test_a_capture_without_a_board_says_so_for_every_pose() -> None:
    nothing = [
        Detection(pose, camera, (760, 620), None, None, None, ("found 0 dots, expected 35",))
        for pose in range(5)
        for camera in ("left", "right")
    ]
    with pytest.raises(CalibrationError, match=r"found by every camera in 0 of 5 poses.*pose 0: left: found 0 dots"):
        calibrate(nothing, CIRCLES, PATTERN, (1280, 800))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Board("circles", 5, 7, 15.0), "dot diameter"),
        (lambda: Board("circles", 5, 7, 15.0, 16.0), "dot diameter"),
        (lambda: Board("chessboard", 2, 7, 15.0), "at least 3 × 3"),
        (lambda: Board("charuco", 5, 7, 15.0), "ChArUco"),
        (lambda: replace(PATTERN, markers=((0, 0),)), "markers"),
        (lambda: replace(PATTERN, marker_diameter_px=10.0), "markers larger than dots"),
    ],
)
def test_impossible_boards_and_patterns_are_refused(make: object, said: str) -> None:
    with pytest.raises(CalibrationError, match=said):
        make()  # type: ignore[operator]

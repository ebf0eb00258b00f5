"""Boards turned in their own plane, cameras rolled: both cameras name a feature alike, and the rig stays the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from metrology.calibration.board import Board
from metrology.calibration.calibrate import calibrate
from metrology.calibration.detect import Detection
from metrology.calibration.detect_board import BoardView
from metrology.calibration.frames import CAMERAS
from metrology.calibration.fringe_features import CodedView
from metrology.calibration.initial import start_values
from metrology.calibration.placing import Placement, place, symmetries, upright
from metrology.calibration.sightings import sightings_of
from metrology.calibration.turned_boards import labelled_alike
from metrology.errors import CalibrationError
from metrology.rig import Rig
from tests.support.calibration_bench import SIZES, bench_rig, bench_state, turn

SIGMA_PX = 0.01
BOARDS = (
    (Board("asymmetric_circles", 7, 11, 15.0, 8.0), 1),
    (Board("asymmetric_circles", 7, 10, 15.0, 8.0), 2),
    (Board("circles", 9, 7, 20.0, 8.0), 2),
    (Board("circles", 7, 7, 22.0, 8.0), 4),
    (Board("chessboard", 9, 6, 20.0), 1),
    (Board("chessboard", 8, 6, 20.0), 2),
    (Board("chessboard", 9, 7, 20.0), 2),
    (Board("chessboard", 7, 7, 20.0), 2),
    (Board("chessboard", 6, 6, 22.0), 4),
    (Board("charuco", 7, 7, 20.0, marker_mm=14.0, dictionary="DICT_5X5_100"), 1),
)


def rolled_rig(roll_deg: float) -> Rig:
    """The bench's rig with its right camera rolled about its own axis."""
    rig = bench_rig()
    roll = turn(0, 0, roll_deg)
    return replace(rig, right=replace(rig.right, R=roll @ rig.right.R, t=roll @ rig.right.t))


def detections(
    rig: Rig, board: Board, turns_deg: Sequence[float], exchanged: int | None = None, poses: int = 6
) -> list[Detection]:
    """What the detector finds: features of boards turned by `turns_deg`, labelled upright in each picture by itself."""
    rng = np.random.default_rng(5)
    state = bench_state(rig, poses)
    found = []
    for pose, rotation in state.rotations.items():
        turned_board = rotation @ turn(0, 0, turns_deg[pose % len(turns_deg)])
        middle = rotation @ np.append(np.ptp(board.points[:, :2], axis=0) / 2, 0) + state.translations[pose]
        points = (board.points - board.points.mean(0)) @ turned_board.T + middle + [30.0, 20.0, 0.0]
        columns = rig.projector.project(points) + rng.normal(0, 0.02, (len(points), 2))
        for camera in CAMERAS:
            seen = camera if pose != exchanged else ("right" if camera == "left" else "left")
            pixels = getattr(rig, seen).project(points) + rng.normal(0, SIGMA_PX, (len(points), 2))
            # The lattice by itself is known up to a turn only; its rows stay in the board's order.
            placed = upright(_ways(board), pixels, board)
            order = placed.on_board
            sigma = np.full(len(order), SIGMA_PX)
            found.append(
                Detection(
                    pose,
                    camera,
                    SIZES[camera],
                    BoardView(placed.index, pixels[order], sigma, 0.7, SIZES[camera]),
                    None,
                    CodedView(placed.index, columns[order], sigma),
                    (),
                )
            )
    return found


def _ways(board: Board) -> list[Placement]:
    """Placements of the board's own lattice, of the colours that a picture shows."""
    alike = [tuple(turn) for turn in symmetries(board)]
    if board.kind == "charuco":
        return [fit for fit in place(board.grid, board) if tuple(fit.index) == alike[0]]
    return [fit for fit in place(board.grid, board) if tuple(fit.index) in alike]


@pytest.mark.parametrize(("board", "turns"), BOARDS)
def test_the_turns_after_which_a_board_looks_the_same(board: Board, turns: int) -> None:
    found = symmetries(board)
    assert len(found) == turns
    assert np.array_equal(found[0], np.arange(len(board.grid)))
    for index in found:
        assert np.array_equal(np.sort(index), np.arange(len(board.grid)))


@pytest.mark.parametrize("board", [board for board, _ in BOARDS], ids=lambda b: f"{b.kind}-{b.cols}x{b.rows}")
@pytest.mark.parametrize(
    ("turns_deg", "roll_deg"), [((0, 92, 178, 271), 0), ((90, 0), 88), ((0, 45, 90), 180), ((91,), -90), ((3, 183), 45)]
)
def test_both_cameras_name_a_feature_alike(board: Board, turns_deg: tuple[float, ...], roll_deg: float) -> None:
    seen = detections(rolled_rig(roll_deg), board, turns_deg)
    views = {(d.pose, d.camera): d for d in labelled_alike(seen, board)}
    for pose in range(6):
        left, right = views[pose, "left"], views[pose, "right"]
        # Features are listed in the order in which they stand on the board, whatever they are called.
        assert np.array_equal(left.board.index, right.board.index)  # type: ignore[union-attr]
        assert np.array_equal(left.coded.index, right.coded.index)  # type: ignore[union-attr]
        assert sorted(left.board.index) == list(range(len(board.grid)))  # type: ignore[union-attr]


def test_turned_boards_give_the_rig() -> None:
    rig, board = rolled_rig(90), Board("chessboard", 6, 6, 22.0)
    found = calibrate(detections(rig, board, (0, 92, 178, 271)), board, None, SIZES["projector"])
    assert all(use.used and not use.reasons for use in found.poses)
    v, u = np.mgrid[300:1000:200, 300:1400:200]
    points = rig.left.rays(np.stack([u, v], -1)) * 720
    calibrated = found.rig("found", rig.calibrated_at)
    seen = calibrated.left.rays(rig.left.project(points)) * 720
    for name in ("right", "projector"):
        off = getattr(calibrated, name).project(seen) - getattr(rig, name).project(points)
        assert np.sqrt(np.mean(np.sum(off**2, axis=-1))) < 0.2


def test_exchanged_frames_are_still_called_that_on_a_symmetric_board() -> None:
    board = Board("asymmetric_circles", 7, 10, 15.0, 8.0)
    seen = labelled_alike(detections(bench_rig(), board, (0, 90), exchanged=2, poses=7), board)
    state, refused = start_values(sightings_of(seen, board, None), SIZES)
    assert refused == {2: "left and right frames are swapped"}
    assert sorted(state.rotations) == [0, 1, 3, 4, 5, 6]


def test_an_even_grid_held_upright_is_no_board_out_of_view() -> None:
    board = Board("asymmetric_circles", 7, 10, 15.0, 8.0)
    pixels = np.column_stack([-board.grid[:, 1], board.grid[:, 0]]).astype(float) * 20
    assert len(upright(place(board.grid, board), pixels, board).index) == len(board.grid)
    columns_lost = board.grid[board.grid[:, 0] < board.grid[:, 0].max() - 1]
    with pytest.raises(CalibrationError, match="more than one place"):
        upright(place(columns_lost, board), columns_lost.astype(float) * 20, board)


def test_a_chessboards_quarter_turn_is_told_by_its_colours() -> None:
    """7 × 7 corners lie alike after a quarter turn, its squares do not; those of 6 × 6 do."""
    seven, six = symmetries(Board("chessboard", 7, 7, 20.0)), symmetries(Board("chessboard", 6, 6, 20.0))
    assert np.array_equal(seven[1], np.arange(49)[::-1])
    assert any(index[0] == 5 for index in six)

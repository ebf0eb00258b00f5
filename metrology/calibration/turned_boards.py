"""Boards that look the same after a turn: both cameras must call the same feature by the same name.

Each picture by itself leaves such a board's labels open up to the board's own symmetries. The left camera's choice is
as good as any, since the board's frame is free in each pose. The right camera's must then be the one with which it
stands where it stands in the other poses: a wrong choice turns it about the board's normal, another way in every tilt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.calibration.board import Board
from metrology.calibration.detect import Detection
from metrology.calibration.initial import LEAST_POSES, PlaneView, SingleDevice, same_place, single_cameras, turn_deg
from metrology.calibration.observations import DeviceName
from metrology.calibration.placing import symmetries
from metrology.errors import CalibrationError

Motion = tuple[Array, Array]


def labelled_alike(detections: Sequence[Detection], board: Board) -> list[Detection]:
    """The detections, the right camera's features renamed where it read the board another way round than the left."""
    turns = symmetries(board)
    seen: dict[DeviceName, dict[int, PlaneView]] = {"left": {}, "right": {}}
    sizes: dict[DeviceName, tuple[int, int]] = {}
    for d in detections:
        sizes[d.camera] = d.size
        if d.board is not None:
            seen[d.camera][d.pose] = PlaneView(board.points[d.board.index, :2], d.board.pixels)
    if len(turns) == 1 or min(len(of) for of in seen.values()) < LEAST_POSES:
        return list(detections)
    try:
        cameras, _ = single_cameras(seen, sizes)
    except CalibrationError:  # said again, and with all that is known, where the rig is solved for
        return list(detections)
    chosen = _choose(cameras["left"], cameras["right"], [_motion(board, turn) for turn in turns])
    return [_renamed(d, turns[chosen.get(d.pose, 0)]) if d.camera == "right" else d for d in detections]


def _motion(board: Board, turn: NDArray[np.intp]) -> Motion:
    """Rotation and translation of the board's plane that carry every feature to the one it is renamed to."""
    points = board.points
    design = np.column_stack([points[:, :2], np.ones(len(points))])
    affine = np.linalg.lstsq(design, points[turn, :2], rcond=None)[0]
    rotation = np.eye(3)
    rotation[:2, :2] = affine[:2].T
    return rotation, np.append(affine[2], 0.0)


def _choose(left: SingleDevice, right: SingleDevice, turns: Sequence[Motion]) -> dict[int, int]:
    """For each pose the turn with which the right camera stands where most poses can have it."""
    poses = sorted(set(left.rotations) & set(right.rotations))
    options = {p: [_relative(left, right, p, turn) for turn in turns] for p in poses}
    reach = {p: float(np.linalg.norm(left.translations[p])) for p in poses}

    def agreeing(place: Motion) -> int:
        return sum(any(same_place(*option, *place, reach[p]) for option in options[p]) for p in poses)

    places = [option for p in poses for option in options[p]]
    R = max(places, key=agreeing)[0]
    # Of a pose whose cameras are exchanged, the turn with which that can be seen.
    meant = [R, R.T]
    return {
        p: min(range(len(turns)), key=lambda k: min(turn_deg(options[p][k][0], turn) for turn in meant)) for p in poses
    }


def _relative(left: SingleDevice, right: SingleDevice, pose: int, turn: Motion) -> Motion:
    """The right camera in the left one's frame, had its features been renamed by a turn of the board."""
    rotation = right.rotations[pose] @ turn[0].T
    translation = right.translations[pose] - rotation @ turn[1]
    R = rotation @ left.rotations[pose].T
    return R, translation - R @ left.translations[pose]


def _renamed(detection: Detection, turn: NDArray[np.intp]) -> Detection:
    board = replace(detection.board, index=turn[detection.board.index]) if detection.board else None
    coded = replace(detection.coded, index=turn[detection.coded.index]) if detection.coded else None
    return replace(detection, board=board, coded=coded)

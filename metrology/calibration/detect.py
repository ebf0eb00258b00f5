"""Everything that one camera tells about one pose, or why it tells nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrology.calibration.board import Board
from metrology.calibration.detect_board import BoardView, detect_board
from metrology.calibration.detect_projection import ProjectionView, detect_projected_dots
from metrology.calibration.frames import BoardFrames, CameraName
from metrology.calibration.fringe_features import CodedView, coded_features
from metrology.calibration.projected_dots import ProjectedDots
from metrology.errors import CalibrationError


@dataclass(frozen=True)
class Detection:
    """What was found in one camera's pictures of one pose."""

    pose: int
    camera: CameraName
    size: tuple[int, int]
    """Width and height of the image."""
    board: BoardView | None
    projected: ProjectionView | None
    coded: CodedView | None
    reasons: tuple[str, ...]
    """Why something that was asked for is None."""


def detect(
    pose: int, camera: CameraName, frames: BoardFrames, board: Board, pattern: ProjectedDots | None
) -> Detection:
    """Find the board, and on it the projected dots or the decoded fringes, whichever the frames have."""
    try:
        view = detect_board(frames, board)
    except CalibrationError as problem:
        return Detection(pose, camera, frames.size, None, None, None, (str(problem),))
    projected: ProjectionView | None = None
    coded: CodedView | None = None
    reasons: list[str] = []
    if pattern is not None and frames.dots is not None:
        try:
            projected = detect_projected_dots(frames, pattern)
        except CalibrationError as problem:
            reasons.append(str(problem))
    if frames.coordinate is not None:
        try:
            coded = coded_features(view, np.asarray(frames.coordinate), board)
        except CalibrationError as problem:
            reasons.append(str(problem))
    return Detection(pose, camera, frames.size, view, projected, coded, tuple(reasons))

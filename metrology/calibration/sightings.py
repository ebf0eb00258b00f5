"""From what was detected to the adjustment's input: pictures that cannot be used are left out, with the reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrology.calibration.board import Board
from metrology.calibration.detect import Detection
from metrology.calibration.detect_board import Layout
from metrology.calibration.observations import Sighting
from metrology.calibration.projected_dots import ProjectedDots

_FIRST_SIGMA_PX = {"board": 0.02, "dots": 0.03}
_BLUR_PX = 2.0
_BLUR_TIMES = 3.0  # the median of the capture


def refuse_blurred(detections: Sequence[Detection], reasons: dict[int, list[str]]) -> list[Detection]:
    """Leave out what is much more blurred than the rest: shaken, or out of the camera's depth of field."""
    blurs = [d.board.blur_px for d in detections if d.board is not None and np.isfinite(d.board.blur_px)]
    limit = max(_BLUR_TIMES * float(np.median(blurs)), _BLUR_PX) if blurs else np.inf
    kept = []
    for detection in detections:
        if detection.board is not None and detection.board.blur_px > limit:
            reasons[detection.pose].append(
                f"{detection.camera}: blurred: edges have σ {detection.board.blur_px:.1f} px, not over {limit:.1f}"
            )
        else:
            kept.append(detection)
    return kept


def of_one_layout(
    detections: Sequence[Detection], reasons: dict[int, list[str]]
) -> tuple[Layout | None, list[Detection]]:
    """The layout of the ChArUco board in most pictures, and the pictures of it."""
    boards = [d.board for d in detections if d.board is not None and d.board.layout is not None]
    if not boards:
        return None, list(detections)
    layouts = [board.layout for board in boards if board.otherwise is None] or [board.layout for board in boards]
    layout = max(set(layouts), key=layouts.count)
    detections = [_read_as(detection, layout) for detection in detections]
    kept = []
    for detection in detections:
        if detection.board is not None and detection.board.layout != layout:
            reasons[detection.pose].append(
                f"{detection.camera}: found the {detection.board.layout} layout of the ChArUco board, expected the "
                f"{layout} one as in most pictures: another board"
            )
        else:
            kept.append(detection)
    return layout, kept


def _read_as(detection: Detection, layout: Layout | None) -> Detection:
    """A picture that fits both layouts of the ChArUco board, read by the one of most pictures."""
    board = detection.board
    if board is None or board.layout == layout or board.otherwise is None:
        return detection
    return replace(detection, board=board.otherwise)


def sightings_of(detections: Sequence[Detection], board: Board, pattern: ProjectedDots | None) -> list[Sighting]:
    """The adjustment's input from what was detected."""
    sightings: list[Sighting] = []
    coded: dict[int, list[Sighting]] = {}
    for d in detections:
        if d.board is not None:
            radius = np.full(len(d.board.index), board.radius_mm)
            xy = board.points[d.board.index, :2]
            sightings.append(
                Sighting("board", d.camera, d.pose, d.board.index, xy, radius, d.board.pixels, _FIRST_SIGMA_PX["board"])
            )
        if d.projected is not None and pattern is not None:
            index, pixels = d.projected.index, d.projected.pixels
            known, radius = pattern.centres[index], pattern.radii[index]
            sightings.append(Sighting("dots", d.camera, d.pose, index, known, radius, pixels, _FIRST_SIGMA_PX["dots"]))
        if d.coded is not None:
            xy, none = board.points[d.coded.index, :2], np.zeros(len(d.coded.index))
            coded.setdefault(d.pose, []).append(
                Sighting("board", "projector", d.pose, d.coded.index, xy, none, d.coded.projector_px, 0.05)
            )
    return sightings + [_merged(of) for of in coded.values()]


def _merged(views: Sequence[Sighting]) -> Sighting:
    """One sighting of the projector from what both cameras decoded at the features: their mean."""
    index = np.unique(np.concatenate([v.index for v in views]))
    total, count = np.zeros((len(index), 2)), np.zeros(len(index))
    known = np.zeros((len(index), 2))
    for view in views:
        at = np.searchsorted(index, view.index)
        total[at] += view.pixels
        count[at] += 1
        known[at] = view.known
    return replace(views[0], index=index, known=known, radius=np.zeros(len(index)), pixels=total / count[:, None])

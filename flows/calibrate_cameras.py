"""Cameras alone, without a projector: from pairs of pictures of a board, or from lists of points."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from flows.calibrate import Calibrated
from flows.calibration_report import write_report
from metrology.calibration.board import Board
from metrology.calibration.calibrate import Calibration, calibrate, calibrate_sightings
from metrology.calibration.detect import detect
from metrology.calibration.frames import BoardFrames
from metrology.errors import CalibrationError
from storage.board_pictures import picture_pairs, read_picture, read_points
from storage.documents import utc_text
from storage.rig import save_rig

_JPEG = "the pictures are JPEG: its compression moves edges by hundredths of a pixel; PNG or TIFF keep them"


def calibrate_pictures(
    folder: Path,
    pattern: str,
    board: Board,
    left: str | None,
    out: Path,
    rig_id: str | None,
    on_step: Callable[[float, str], None] = lambda _done, _text: None,
) -> tuple[Calibrated, list[str]]:
    """A rig of two cameras from pairs of pictures of a board, and notes about the pictures."""
    pairs = picture_pairs(folder, pattern, left)
    detections = []
    for pose, pair in enumerate(pairs):
        for camera, path in pair.items():
            on_step(0.8 * pose / len(pairs), path.name)
            detections.append(detect(pose, camera, BoardFrames(read_picture(path)), board, None))
    notes = [_JPEG] if any(path.suffix.lower() in (".jpg", ".jpeg") for pair in pairs for path in pair.values()) else []
    try:
        found = calibrate(detections, board)
        called = {use.pose: pairs[use.pose]["left"].name for use in found.poses if use.reasons}
        notes += [f"pose {pose} is {name}" for pose, name in called.items()]
        return _kept(found, out, rig_id), notes
    except CalibrationError as problem:
        raise CalibrationError(f"{folder}: {problem}") from None


def calibrate_points(path: Path, size: tuple[int, int], out: Path, rig_id: str | None) -> Calibrated:
    """A rig of two cameras of `size` (width, height) from a list of points."""
    try:
        found = calibrate_sightings(read_points(path), {"left": size, "right": size})
        return _kept(found, out, rig_id)
    except CalibrationError as problem:
        text = str(problem)
        raise CalibrationError(text if text.startswith(str(path)) else f"{path}: {text}") from None


def _kept(calibration: Calibration, out: Path, rig_id: str | None) -> Calibrated:
    now = datetime.now(UTC).replace(microsecond=0)
    rig = calibration.rig(rig_id or f"rig-{now:%Y-%m-%d}", utc_text(now))
    save_rig(rig, out)
    write_report(calibration, rig, out.with_suffix(".html"))
    return Calibrated(rig, calibration)

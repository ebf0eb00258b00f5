"""The steps of a calibration, each a plain function. `flows.calibrate` orders them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metrology.calibration.calibrate import Calibration, calibrate
from metrology.calibration.detect import Detection, detect
from metrology.calibration.frames import BoardFrames, CameraName
from metrology.decode import decode_phase
from metrology.errors import CalibrationError
from metrology.rig import Rig
from storage.calibration import CalibrationCapture, CaptureModel, PoseImages, load_capture
from storage.documents import utc_text
from storage.rig import save_rig


def load_calibration_capture(folder: Path) -> CalibrationCapture:
    """Read and check a calibration capture's manifest."""
    return load_capture(folder)


def detect_pose(capture: CalibrationCapture, pose: int, camera: CameraName) -> Detection:
    """Find the board, and the projector's dots or fringes on it, in one camera's pictures of one pose."""
    images = capture.images(pose, camera)
    frames = BoardFrames(images.white, images.dark, images.dots, _coordinate(capture, images))
    return detect(pose, camera, frames, capture.board, capture.dots)


def solve_rig(capture: CalibrationCapture, detections: Sequence[Detection]) -> Calibration:
    """Cameras and projector from all detections."""
    try:
        calibration = calibrate(detections, capture.board, capture.dots, capture.projector_size)
        return replace(calibration, warnings=(*calibration.warnings, *certificate_warnings(capture.model)))
    except CalibrationError as problem:
        raise CalibrationError(f"{capture.folder}: {problem}") from None


def certificate_warnings(capture: CaptureModel) -> list[str]:
    """What is wrong with the certificate of the board, which carries the scale of every length."""
    certificate = capture.board.certificate
    moment = capture.captured_at or datetime.now(UTC)
    if certificate and certificate.overdue(moment):
        return [f"the board's certificate {certificate} did not hold any more on {moment:%Y-%m-%d}"]
    return []


def name_rig(capture: CalibrationCapture, calibration: Calibration, rig_id: str | None) -> Rig:
    """The rig with its id (by default that of the capture, or its date) and time (that of the capture, or now)."""
    moment = capture.model.captured_at or datetime.now(UTC)
    rig = calibration.rig(rig_id or capture.model.rig or f"rig-{moment:%Y-%m-%d}", utc_text(moment))
    kept: dict[str, object] = {"board": capture.model.board.model_dump(mode="json", exclude_none=True)}
    kept |= {"due_at": utc_text(capture.model.due_at)} if capture.model.due_at else {}
    return replace(rig, extra={"calibration": {**calibration.summary(), **kept}})


def write_rig(rig: Rig, path: Path) -> None:
    """Keep the rig."""
    save_rig(rig, path)


def _coordinate(capture: CalibrationCapture, images: PoseImages) -> NDArray[np.float32] | None:
    """(h, w, 2) projector column and row at every pixel."""
    if not images.fringes:
        return None
    width, height = capture.projector_size
    views = [
        decode_phase(images.fringes[axis][None], capture.codes[axis], capture.codes[axis].size(width, height))
        for axis in ("x", "y")
    ]
    return np.stack([view.coordinate for view in views], -1)

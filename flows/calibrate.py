"""The order of steps that makes a rig of a calibration capture: run in process or as Prefect tasks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from flows.calibration_report import write_report
from flows.inspect_scene import Call, directly
from metrology.calibration.calibrate import Calibration
from metrology.rig import Rig
from storage.calibration import CalibrationCapture
from tasks import calibration as steps


@dataclass(frozen=True)
class Calibrated:
    """A rig and how it was found."""

    rig: Rig
    calibration: Calibration


def calibrate_capture(
    folder: Path,
    out: Path,
    report: Path,
    rig_id: str | None = None,
    call: Call = directly,
    on_step: Callable[[float, str], None] = lambda _done, _text: None,
) -> Calibrated:
    """Calibrate, and write the rig file and its report.

    Parameters
    ----------
    folder : Path
        Calibration capture.
    out, report : Path
        Rig file (JSON) and report (HTML) to write.
    rig_id : str, optional
        By default the id that the capture names, or one made of its date.
    call : callable
        Runs a step.
    on_step : callable
        Told the part that is done and what comes next.
    """
    return calibrate_loaded(call(steps.load_calibration_capture, folder), out, report, rig_id, call, on_step)


def calibrate_loaded(
    capture: CalibrationCapture,
    out: Path,
    report: Path,
    rig_id: str | None = None,
    call: Call = directly,
    on_step: Callable[[float, str], None] = lambda _done, _text: None,
) -> Calibrated:
    """As `calibrate_capture`, of a capture whose manifest is read."""
    views = [(pose, camera) for pose in range(len(capture)) for camera in capture.model.cameras]
    detections = []
    for done, (pose, camera) in enumerate(views):
        on_step(0.8 * done / len(views), f"pose {pose}, {camera} camera")
        detections.append(call(steps.detect_pose, capture, pose, camera))
    on_step(0.8, "adjusting")
    calibration = call(steps.solve_rig, capture, detections)
    rig = steps.name_rig(capture, calibration, rig_id)
    on_step(0.95, "writing")
    call(steps.write_rig, rig, out)
    write_report(calibration, rig, report)
    return Calibrated(rig, calibration)

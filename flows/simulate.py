"""Scene folders and calibration captures from a simulation specification."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from metrology.moments import moment_of
from metrology.results import SceneKey
from simulator.calibration import simulate_calibration
from simulator.scene import SimulatedScene, simulate
from simulator.spec import SimulationSpec
from storage.calibration import write_capture
from storage.rig import save_rig
from storage.scene import write_scene

RIG_FILE = "rig.json"
CAPTURE_FOLDER = "calibration"


def simulate_folders(
    spec: SimulationSpec, out: Path, on_progress: Callable[[float, str], None] | None = None
) -> tuple[list[Path], Path]:
    """Render every scene of a specification.

    Returns
    -------
    list of Path
        Scene folders in `out`.
    Path
        The rig file beside them.
    """
    rig_path = out / RIG_FILE
    folders: list[Path] = []
    for scene in simulate(spec, on_progress):
        if not folders:
            save_rig(scene.rig, rig_path)
        folders.append(_write(out / scene.name, scene))
    return folders, rig_path


def simulate_capture(spec: SimulationSpec, out: Path, on_progress: Callable[[float, str], None] | None = None) -> Path:
    """Render the calibration capture of a specification into a folder of `out`, and return that folder."""
    folder = out / CAPTURE_FOLDER
    capture = simulate_calibration(spec, progress=on_progress)
    device = capture.rig.with_projector()
    projector: dict[str, Any] = {"width": device.width, "height": device.height}
    if capture.dots:
        projector["dots"] = capture.dots.as_dict()
    if capture.fringe:
        projector["fringe"] = {code.axis: {"steps": code.steps, "counts": list(code.counts)} for code in capture.fringe}
    write_capture(
        folder,
        capture.rig.id,
        moment_of(spec.rig.calibrated_at),
        capture.board.as_dict(),
        projector,
        [pose.frames for pose in capture.poses],
    )
    return folder


def _write(folder: Path, scene: SimulatedScene) -> Path:
    write_scene(
        folder,
        SceneKey(scene.aircraft_serial, scene.panel, scene.station, moment_of(scene.captured_at)),
        scene.rig.id,
        scene.fringe,
        scene.exposures,
        scene.left,
        scene.right,
        truth=scene.truth,
        operator=scene.operator,
    )
    return folder

"""Scene folders from a simulation specification."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path

from metrology.results import SceneKey
from simulator.scene import SimulatedScene, simulate
from simulator.spec import SimulationSpec
from storage.rig import save_rig
from storage.scene import write_scene

RIG_FILE = "rig.json"


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


def _write(folder: Path, scene: SimulatedScene) -> Path:
    write_scene(
        folder,
        SceneKey(scene.aircraft_serial, scene.panel, scene.station, datetime.fromisoformat(scene.captured_at)),
        scene.rig.id,
        scene.fringe,
        scene.exposures,
        scene.left,
        scene.right,
        truth=scene.truth,
        operator=scene.operator,
    )
    return folder

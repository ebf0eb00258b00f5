"""The work of a study: rigs calibrated, scans rendered and inspected; what is done already is not done again."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from flows.calibrate import calibrate_capture
from flows.inspect_scene import Call, Job, directly, inspect_scene
from flows.simulate import simulate_capture
from flows.study.pattern import panel_specification
from flows.study.renderer import Renderer
from flows.study.series import RigKind, Scan, Series
from metrology.errors import FlushlineError
from simulator.scene import Frames, make_rig
from simulator.spec import CalibrationSpec, SimulationSpec
from storage.archive import Store
from storage.archive.bundle import document_hash
from storage.panel_spec import PanelSpecification
from storage.rig import load_rig, rig_document, save_rig
from storage.scene import write_scene
from tasks.result import config_hash
from tasks.settings import InspectionSettings

Say = Callable[[str], None]


@dataclass(frozen=True)
class Workshop:
    """Where a study works, and with what."""

    out: Path
    """Gets the store, the rigs and, while a scan is inspected, its frames."""
    settings: InspectionSettings
    calibration: CalibrationSpec
    """The capture from which calibrated rigs come."""
    tolerance_mm: float
    call: Call = directly
    """Runs a step of an inspection or a calibration."""
    renderer: Renderer = field(default_factory=Renderer)

    @property
    def store(self) -> Store:
        """Where the results go."""
        return Store(self.out / "store")

    def rig_path(self, simulation: SimulationSpec, kind: RigKind) -> Path:
        """The rig file of a simulation's rig."""
        return self.out / "rigs" / f"{simulation.rig.id}-{kind}.json"

    @property
    def frames(self) -> Path:
        """Where pictures lie while they are needed."""
        return self.out / "frames"


def make_rigs(workshop: Workshop, simulation: SimulationSpec, kinds: Iterable[RigKind], say: Say) -> None:
    """Write the rig files that are not there yet; the calibrated one comes from a simulated capture."""
    for kind in kinds:
        path = workshop.rig_path(simulation, kind)
        if path.exists():
            continue
        if kind == "true":
            path.parent.mkdir(parents=True, exist_ok=True)
            save_rig(replace(make_rig(simulation), id=path.stem), path)
        else:
            _calibrate(workshop, simulation, path, say)


def _calibrate(workshop: Workshop, simulation: SimulationSpec, path: Path, say: Say) -> None:
    asked = replace(simulation, calibration=workshop.calibration)
    capture = simulate_capture(asked, workshop.frames, lambda _, what: say(f"calibration capture: {what}"))
    draft = workshop.frames / path.name
    result = calibrate_capture(
        capture, draft, path.with_suffix(".html"), path.stem, workshop.call, lambda _, what: say(f"calibrating: {what}")
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    save_rig(result.rig, path)
    shutil.rmtree(workshop.frames)


def run_series(workshop: Workshop, series: Series, on_scan: Callable[[], None], say: Say) -> list[str]:
    """Inspect every scan of a series that the store does not hold yet; its rigs are there.

    Parameters
    ----------
    on_scan : callable
        Told when a scan is done, now or earlier.
    say : callable
        Told what is being done.

    Returns
    -------
    list of str
        Why scans could not be inspected.
    """
    specification = panel_specification(series, workshop.tolerance_mm)
    problems = []
    for scans in zip(*(series.scans(rig) for rig in series.rigs), strict=True):  # one exposure, seen with every rig
        missing = [scan for scan in scans if not _is_done(workshop, scan, specification)]
        if missing:
            frames = workshop.renderer.frames(
                series.simulation, scans[0].placement, scans[0].repeat, lambda what: say(f"{series.name}: {what}")
            )
        for scan in scans:
            if scan in missing:
                say(f"{series.name}: inspecting {scan.key.station}, scan {scan.repeat + 1}")
                try:
                    _inspect(workshop, scan, frames, specification)
                except FlushlineError as problem:
                    problems.append(f"{scan.key}: {problem}")
            on_scan()
    return problems


def _is_done(workshop: Workshop, scan: Scan, specification: PanelSpecification) -> bool:
    rig = load_rig(workshop.rig_path(scan.series.simulation, scan.rig))
    config = config_hash(workshop.settings, specification)
    return workshop.store.holds(scan.key.scene_id, config, document_hash(rig_document(rig)))


def _inspect(workshop: Workshop, scan: Scan, frames: dict[str, Frames], specification: PanelSpecification) -> None:
    simulation = scan.series.simulation
    rig = workshop.rig_path(simulation, scan.rig)
    shutil.rmtree(workshop.frames, ignore_errors=True)
    write_scene(
        workshop.frames, scan.key, rig.stem, simulation.fringe, simulation.camera.exposures, frames["left"],
        frames["right"], operator="simulator",
    )  # fmt: skip
    try:
        inspect_scene(Job(workshop.frames, workshop.store, rig, workshop.settings, specification), workshop.call)
    finally:
        shutil.rmtree(workshop.frames)

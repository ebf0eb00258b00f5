"""The order of steps that makes a result of a scan: written once, run in process or as Prefect tasks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar

from metrology.kinds import HOLE, RIVET, SEAM_STATION
from metrology.results import Features, SceneKey
from metrology.rig_health import RigHealth
from storage.archive import Store
from storage.archive.panels import PatternTaken
from storage.panel_spec import PanelSpecification
from tasks import steps
from tasks.settings import InspectionSettings

Result = TypeVar("Result")


class Call(Protocol):
    """How a step is run: directly, or as a Prefect task."""

    def __call__(self, step: Callable[..., Result], *arguments: Any) -> Result: ...


@dataclass(frozen=True)
class Job:
    """What to inspect, with what, and where the result goes.

    Attributes
    ----------
    folder : Path
        Scene folder.
    store : Store
    rig_path : Path or None
        None: the rig that the scene names, from the store.
    settings : InspectionSettings
    spec : PanelSpecification
        The example gives way to what is in force in the store for the scene's panel.
    """

    folder: Path
    store: Store
    rig_path: Path | None
    settings: InspectionSettings
    spec: PanelSpecification


@dataclass(frozen=True)
class Inspected:
    """What became of a scene, in short.

    Attributes
    ----------
    key : SceneKey
    run_id : str
    features : mapping
        Judged, by kind.
    warnings : tuple of str
    seconds : mapping
        Wall time of each step, of publishing, and in total.
    """

    key: SceneKey
    run_id: str
    features: Features
    warnings: tuple[str, ...]
    seconds: dict[str, float] = field(default_factory=dict)


def directly(step: Callable[..., Result], *arguments: Any) -> Result:
    """Run a step as the plain function it is."""
    return step(*arguments)


def inspect_scene(job: Job, call: Call = directly, on_step: Callable[[str], None] = lambda _: None) -> Inspected:
    """Inspect one scene and publish what was found.

    Parameters
    ----------
    job : Job
    call : callable
        Runs a step.
    on_step : callable
        Told the name of each step as it begins.
    """
    seconds: dict[str, float] = {}
    began = time.perf_counter()

    @contextmanager
    def timed(name: str) -> Iterator[None]:
        on_step(name)
        start = time.perf_counter()
        yield
        seconds[name] = time.perf_counter() - start

    def aside(work: Callable[..., Result], *arguments: Any) -> Future[Result]:
        """Work on what nobody waits for yet, in the run's own context."""
        return helpers.submit(copy_context().run, work, *arguments)

    def check_rig() -> RigHealth:
        with timed("check_rig"):
            return call(steps.check_rig, loaded, reconstruction, detections, settings)

    settings = job.settings
    with timed("load"):
        loaded = call(steps.load, job.folder, job.rig_path, job.store)
    with timed("reconstruct"):
        reconstruction = call(steps.reconstruct_scene, loaded, settings)
    with ThreadPoolExecutor(2) as helpers:
        encoding = aside(steps.encode, reconstruction)
        with timed("detect_rivets"):
            fasteners = call(steps.detect_rivets, reconstruction, settings)
            detections = fasteners.rivets
        checking = aside(check_rig)
        with timed("detect_seams"):
            lines = call(steps.detect_seams, reconstruction, detections, settings)
        health = checking.result()  # refused before anything is measured with a rig that does not fit
        with timed("measure_rivets"):
            rivets = call(steps.measure_rivets, detections, reconstruction, lines, settings)
            holes = call(steps.measure_holes, fasteners.openings, reconstruction, settings)
        with timed("measure_seams"):
            stations = call(steps.measure_seams, lines, reconstruction, detections, settings)
        encoded = encoding.result()
    found: Features = {RIVET.name: rivets, SEAM_STATION.name: stations, HOLE.name: holes}
    spec = steps.specification(job.spec, loaded.scene.key.panel, job.store)

    def conclude() -> Inspected:
        with timed("register"):
            doubts = steps.doubts(reconstruction, health)
            registered = call(steps.register, found, reconstruction, loaded, spec, job.store, settings, doubts)
        with timed("judge"):
            judged = call(steps.judge, registered.features, spec)
        with timed("overlay"):
            drawn = call(steps.draw_overlay, judged, loaded, reconstruction, settings)
        seconds["total"] = time.perf_counter() - began
        result = steps.assemble(
            loaded, reconstruction, health, registered, judged, drawn, encoded, settings, spec, seconds
        )
        with timed("publish"):
            run_id = call(steps.publish, job.store, result, loaded.rig)
        return Inspected(result.key, run_id, result.features, result.warnings, seconds)

    try:
        return conclude()
    except PatternTaken:  # another first scan of the station was stored meanwhile: this one is recognised by it
        return conclude()

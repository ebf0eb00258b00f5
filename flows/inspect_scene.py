"""The order of steps that makes a result of a scan: written once, run in process or as Prefect tasks."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import ParamSpec, Protocol, TypeVar

from metrology.cloud import Reconstruction
from metrology.frame_doubts import without_doubtful
from metrology.kinds import KINDS, RIVET, SEAM_STATION, load
from metrology.results import Feature, Features, SceneKey
from metrology.rig_health import RigHealth
from metrology.sighted import Sighted
from metrology.steps import STEPS
from storage import png
from storage.archive import Store
from storage.archive.bundle import OVERLAY
from storage.archive.panels import PatternTaken
from storage.panel_spec import PanelSpecification
from tasks import steps
from tasks.loaded import LoadedScene
from tasks.result import Encoded, assemble, encode
from tasks.settings import InspectionSettings

P = ParamSpec("P")
Result = TypeVar("Result")
_MOSTLY_MATCHED = 0.9  # of the pixels, by a rig that fits
_NAMES = {step.function: step.name for step in STEPS}


class Call(Protocol):
    """How a step is run: directly, or as a Prefect task."""

    def __call__(self, step: Callable[P, Result], *arguments: P.args, **named: P.kwargs) -> Result: ...


@dataclass(frozen=True)
class Job:
    """What to inspect, with what, and where the result goes."""

    folder: Path
    """Scene folder."""
    store: Store
    rig_path: Path | None
    """None: the rig that the scene names, from the store."""
    settings: InspectionSettings
    spec: PanelSpecification
    """The example gives way to what is in force in the store for the scene's panel."""


@dataclass(frozen=True)
class Answer:
    """What is known of a scene before it is stored: all that somebody at the panel waits for."""

    key: SceneKey
    features: Features
    """Judged, by kind."""
    warnings: tuple[str, ...]
    seconds: Mapping[str, float]
    """Wall time of each step so far, and in total without storing."""
    picture: Callable[[], bytes]
    """Encodes the overlay as a PNG."""


@dataclass(frozen=True)
class Inspected:
    """What became of a scene that is stored, in short."""

    key: SceneKey
    run_id: str
    features: Features
    """Judged, by kind."""
    warnings: tuple[str, ...]
    seconds: dict[str, float] = field(default_factory=dict)
    """Wall time of each step, of publishing, and in total."""


def directly(step: Callable[P, Result], *arguments: P.args, **named: P.kwargs) -> Result:
    """Run a step as the plain function it is."""
    return step(*arguments, **named)


@dataclass(frozen=True)
class _Run:
    """How the steps of one inspection are run, and how long they took."""

    call: Call
    on_step: Callable[[str], None]
    on_answer: Callable[[Answer], None]
    began: float = field(default_factory=time.perf_counter)
    seconds: dict[str, float] = field(default_factory=dict)

    def step(self, function: Callable[P, Result], *arguments: P.args, **named: P.kwargs) -> Result:
        """Run a step under its declared name."""
        name = _NAMES[f"{function.__module__}:{function.__name__}"]
        self.on_step(name)
        start = time.perf_counter()
        result = self.call(function, *arguments, **named)
        self.seconds[name] = time.perf_counter() - start
        return result


@dataclass(frozen=True)
class _Measured:
    """A scan measured in its rig's frame, before its panel is known."""

    loaded: LoadedScene
    reconstruction: Reconstruction
    health: RigHealth
    features: Features
    encoded: Encoded
    spec: PanelSpecification


def inspect_scene(
    job: Job,
    call: Call = directly,
    on_step: Callable[[str], None] = lambda _: None,
    on_answer: Callable[[Answer], None] = lambda _: None,
) -> Inspected:
    """Inspect one scene and publish what was found.

    Parameters
    ----------
    call : callable
        Runs a step.
    on_step : callable
        Told the name of each step as it begins.
    on_answer : callable
        Told what was found before it is stored. Told again where another first scan of the station was stored
        meanwhile, by which this one is then recognised.
    """
    run = _Run(call, on_step, on_answer)
    measured = _measure(job, run)
    try:
        return _conclude(job, run, measured)
    except PatternTaken:  # another first scan of the station was stored meanwhile: this one is recognised by it
        return _conclude(job, run, measured)


def _measure(job: Job, run: _Run) -> _Measured:
    settings = job.settings
    loaded = run.step(steps.load, job.folder, job.rig_path, job.store, settings.verification)
    reconstruction = run.step(steps.reconstruct_scene, loaded, settings)
    with ThreadPoolExecutor(2) as helpers:

        def beside(function: Callable[[], Result]) -> Future[Result]:
            """Start what nobody waits for yet, in the run's own context."""
            return helpers.submit(copy_context().run, function)

        encoding = beside(partial(encode, reconstruction))
        named = beside(partial(steps.with_same_frames, loaded, reconstruction, job.store))
        fasteners = run.step(steps.detect_rivets, reconstruction, settings)
        detections = fasteners.rivets
        checking = beside(partial(run.step, steps.check_rig, loaded, reconstruction, detections, settings))
        if reconstruction.matched < _MOSTLY_MATCHED:  # a rig that does not fit leaves much in which to look for seams
            checking.result()
        lines = run.step(steps.detect_seams, reconstruction, detections, settings)
        health = checking.result()  # refused before anything is measured with a rig that does not fit
        measuring = beside(partial(run.step, steps.measure_rivets, detections, reconstruction, lines, settings))
        stations = run.step(steps.measure_seams, lines, reconstruction, detections, settings)
        features: dict[str, Sequence[Feature]] = {RIVET.name: measuring.result(), SEAM_STATION.name: stations}
        spec = steps.specification(job.spec, loaded.scene.key.panel, job.store)
        for kind in KINDS:
            if kind.measure and (not kind.on_request or spec.limits.limits_any(kind)):
                sighted = Sighted(reconstruction, detections, lines, dict(features), fasteners.openings)
                features[kind.name] = run.step(
                    load(kind.measure), sighted, getattr(settings, kind.settings or kind.table, None)
                )
        believed = without_doubtful(features, reconstruction.doubts)
        return _Measured(named.result(), reconstruction, health, believed, encoding.result(), spec)


def _conclude(job: Job, run: _Run, measured: _Measured) -> Inspected:
    """Recognise the panel, judge, draw and publish."""
    loaded, reconstruction, settings = measured.loaded, measured.reconstruction, job.settings
    spec = measured.spec
    doubts = steps.doubts(loaded, reconstruction, measured.health)
    registered = run.step(steps.register, measured.features, reconstruction, loaded, spec, job.store, settings, doubts)
    judged = run.step(steps.judge, registered.features, spec)
    drawn = run.step(steps.draw_overlay, judged, loaded, reconstruction, settings)
    run.seconds["total"] = time.perf_counter() - run.began
    with ThreadPoolExecutor(1) as painter:
        painting = painter.submit(lambda: png.encode(drawn.image()))
        result = assemble(
            loaded,
            reconstruction,
            measured.health,
            registered,
            judged,
            drawn,
            measured.encoded,
            settings,
            spec,
            run.seconds,
        )
        run.on_answer(Answer(result.key, judged, result.warnings, result.seconds, painting.result))
        result = replace(result, encoded={**result.encoded, OVERLAY: painting.result()})
    run_id = run.step(steps.publish, job.store, result, loaded.rig)
    return Inspected(result.key, run_id, result.features, result.warnings, run.seconds)

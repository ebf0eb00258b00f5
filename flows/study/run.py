"""A study from its specification to its report: run in process or as a Prefect flow, taken up where it was killed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Protocol

from flows.inbox import only_run
from flows.inspect_scene import Call, directly
from flows.study.budget import Budget
from flows.study.detection import Detection
from flows.study.document import Section
from flows.study.folder import Finished, claim
from flows.study.gage import Gage
from flows.study.report import SIMULATED, write_report
from flows.study.series import RigKind, Series
from flows.study.skin import Skin
from flows.study.spec import Study
from flows.study.standard_part import StandardPart
from flows.study.workshop import Workshop, make_rigs, run_series
from simulator.spec import SimulationSpec
from storage.archive import Store
from storage.archive.bundle import document_hash
from tasks.settings import InspectionSettings


class Block(Protocol):
    """A part of a study: scans to inspect, and what they tell."""

    series: tuple[Series, ...]

    def sections(self, store: Store) -> list[Section]:
        """What the store holds once the series are in it."""


def run_study(
    study: Study,
    out: Path,
    settings: InspectionSettings,
    call: Call = directly,
    on_progress: Callable[[int, int, str], None] = lambda _done, _all, _what: None,
) -> Finished:
    """Do what a study asks for and write its report; scans that its store holds already are not repeated.

    Parameters
    ----------
    out : Path
        Gets the store, the rigs, the report and its tables.
    call : callable
        Runs a step of an inspection or a calibration.
    on_progress : callable
        Told how many scans are done, of how many, and what comes next.
    """
    claim(out, study.spec.study, document_hash(study.document))
    blocks = blocks_of(study)
    total = sum(len(series) for block in blocks for series in block.series)
    workshop = Workshop(out, settings, study.spec.calibration, study.spec.tolerance_mm, call)
    done = 0
    problems: list[str] = []

    def say(what: str) -> None:
        on_progress(done, total, what)

    def count() -> None:
        nonlocal done
        done += 1

    with only_run(out):
        for simulation in study.simulations.values():
            make_rigs(workshop, simulation, _rigs_of(simulation, blocks), say)
        for block in blocks:
            for series in block.series:
                problems += run_series(workshop, series, count, say)
        say("report")
        sections = [section for block in blocks for section in block.sections(workshop.store)]
        title = f"Study of {study.spec.study}"
        made = (
            f"Flushline {version('flushline')}, {datetime.now(UTC):%Y-%m-%d}, {done - len(problems)} inspected scans."
        )
        missed = [f"Not inspected: {problem}" for problem in problems]
        report = write_report(out, title, (SIMULATED, made, *missed), sections)
    return Finished(report, tuple(bar for section in sections for bar in section.bars), tuple(problems))


def _rigs_of(simulation: SimulationSpec, blocks: Sequence[Block]) -> set[RigKind]:
    """With which rigs the scans of a simulation's rig are inspected."""
    series = [series for block in blocks for series in block.series if series.simulation.rig == simulation.rig]
    return {rig for one in series for rig in one.rigs}


def blocks_of(study: Study) -> list[Block]:
    """The blocks that a study asks for, in the order of the report."""
    spec = study.spec
    blocks: list[Block] = []
    if spec.standard_part:
        blocks.append(StandardPart(spec.standard_part, study.simulations[spec.standard_part.simulation]))
    if spec.skin:
        blocks.append(Skin(spec.skin, study.simulations[spec.skin.simulation]))
    if spec.gage:
        blocks.append(Gage(spec.gage, study.simulations[spec.gage.simulation], spec.tolerance_mm))
    if spec.budget:
        blocks.append(Budget(spec.budget, study.simulations[spec.budget.simulation]))
    if spec.detection:
        blocks.append(Detection(spec.detection, study.simulations[spec.detection.simulation]))
    return blocks

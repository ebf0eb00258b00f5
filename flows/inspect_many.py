"""Inspecting scenes from the command line: all are looked at first, a bad one never stops the others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from flows.cli import EXIT_BAD_INPUT, EXIT_DONE, EXIT_SOME_FAILED, counted, print_error, unexpected
from flows.inspect_scene import Inspected, Job, inspect_scene
from flows.memory import share_heap
from flows.prefect_server import runs_on_server
from flows.progress import progress_bar
from metrology.errors import FlushlineError
from metrology.kinds import KINDS, Kind
from metrology.results import Feature
from metrology.steps import PROGRESS
from storage.archive import Store
from storage.documents import printable
from storage.panel_spec import load_panel_spec
from storage.rig import load_rig
from tasks import steps
from tasks.settings import load_settings


@dataclass(frozen=True)
class Inputs:
    """Paths that the command was given, and whether panels are put together in the end."""

    scenes: Sequence[Path]
    store: Path
    rig: Path | None = None
    panel_spec: Path | None = None
    settings: Path | None = None
    panels: bool = True


def inspect_many(inputs: Inputs, use_server: bool = False, debug: bool = False) -> int:
    """Inspect scenes one after the other; returns the command's exit code."""
    share_heap()
    jobs = _jobs(inputs)
    sound = [job for job in jobs if _passes(partial(_look_at, job), job, debug)]
    if not sound:
        return EXIT_BAD_INPUT
    run = _way_to_run(inputs, use_server)
    done, stored = 0, list[str]()
    with progress_bar() as progress:
        bar = progress.add_task("", total=len(sound))

        def inspect(job: Job) -> None:
            def show(step: str) -> None:
                progress.update(bar, description=f"{printable(job.folder.name)}: {PROGRESS[step]}")

            inspected = run(job, show)
            print(describe(inspected))
            stored.append(inspected.key.scene_id)

        for job in sound:
            done += _passes(partial(inspect, job), job, debug)
            progress.advance(bar)
    if stored and inputs.panels:
        from flows.assemble_panels import assemble_after

        assemble_after(Store(inputs.store), stored)
    if done == len(jobs):
        return EXIT_DONE
    return EXIT_SOME_FAILED if done else EXIT_BAD_INPUT


def describe(inspected: Inspected) -> str:
    """A scene's result in a few lines."""
    found = [_found(kind, rows) for kind in KINDS if kind.counts_in(rows := inspected.features.get(kind.name, ()))]
    lines = [
        f"{inspected.key}: {'; '.join(found)}; {inspected.seconds['total']:.1f} s",
        f"  scene id {inspected.key.scene_id}",
        *(f"  warning: {warning}" for warning in inspected.warnings),
    ]
    return "\n".join(lines)


def _jobs(inputs: Inputs) -> list[Job]:
    store = Store(inputs.store)
    store.check_usable()
    if inputs.rig:
        load_rig(inputs.rig)  # a bad rig is one complaint, not one per scene
    settings, spec = load_settings(inputs.settings), load_panel_spec(inputs.panel_spec)
    return [Job(folder, store, inputs.rig, settings, spec) for folder in inputs.scenes]


def _look_at(job: Job) -> None:
    """Refuse a scene that cannot be inspected before any is."""
    steps.load(job.folder, job.rig_path, job.store, job.settings.verification)


def _way_to_run(inputs: Inputs, use_server: bool) -> Callable[[Job, Callable[[str], None]], Inspected]:
    """In this process, or as a Prefect flow where a server is configured."""
    if runs_on_server(use_server):
        from flows.prefect_flows import inspect_scene_flow

        store, rig, spec, settings = map(_text, (inputs.store, inputs.rig, inputs.panel_spec, inputs.settings))
        return lambda job, _: inspect_scene_flow(str(job.folder), str(store), rig, spec, settings)
    return lambda job, show: inspect_scene(job, on_step=show)


def _text(path: Path | None) -> str | None:
    return str(path) if path else None


def _passes(work: Callable[[], object], job: Job, debug: bool) -> bool:
    """Whether work on one scene succeeds; what is wrong with it is said in one line."""
    try:
        work()
    except FlushlineError as problem:
        if debug:
            raise
        print_error(str(problem))
        return False
    except Exception as problem:
        if debug:
            raise
        place = "" if isinstance(problem, OSError) and problem.filename else f"{job.folder}: "
        print_error(f"{place}{unexpected(problem)}")
        return False
    return True


def _found(kind: Kind, rows: Sequence[Feature]) -> str:
    """How many there are and how they were judged."""
    positions = f" with {counted(len(rows), 'position')}" if rows and len(kind.id_columns) > 1 else ""
    decisions = ", ".join(f"{n} {decision}" for decision, n in Counter(row.decision for row in rows).most_common())
    return counted(len(kind.names(rows)), kind.subject) + positions + (f" ({decisions})" if decisions else "")

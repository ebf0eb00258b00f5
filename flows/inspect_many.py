"""Inspecting scenes from the command line: all are looked at first, a bad one never stops the others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from flows.cli import EXIT_BAD_INPUT, EXIT_DONE, EXIT_SOME_FAILED, counted, print_error, unexpected
from flows.compiling import kernels_beside
from flows.inspect_scene import Answer, Inspected, Job, inspect_scene
from flows.memory import do_without_pandas, share_heap
from flows.prefect_server import runs_on_server
from flows.progress import progress_bar
from metrology.errors import FlushlineError
from metrology.kinds import KINDS, Kind
from metrology.results import Feature
from metrology.steps import PROGRESS
from storage.archive import Store
from storage.archive.files import replacing
from storage.documents import printable
from storage.panel_spec import load_panel_spec
from storage.rig import load_rig
from tasks import steps
from tasks.settings import load_settings

Run = Callable[[Job, Callable[[str], None], Callable[[Answer], None]], Inspected]
"""Inspects a scene: told what is done with each step, and what is answered."""


@dataclass(frozen=True)
class Inputs:
    """Paths that the command was given, whether panels are put together in the end, and a folder for overlays."""

    scenes: Sequence[Path]
    store: Path
    rig: Path | None = None
    panel_spec: Path | None = None
    settings: Path | None = None
    panels: bool = True
    overlays: Path | None = None


def inspect_many(inputs: Inputs, use_server: bool = False, debug: bool = False) -> int:
    """Inspect scenes one after the other; returns the command's exit code."""
    share_heap()
    do_without_pandas()
    jobs = _jobs(inputs)
    sound = [job for job in jobs if _passes(partial(_look_at, job), job, debug)]
    if not sound:
        return EXIT_BAD_INPUT
    run = _way_to_run(inputs, use_server)
    if inputs.overlays:
        inputs.overlays.mkdir(parents=True, exist_ok=True)

    def tell(answer: Answer) -> None:
        print(describe(answer), flush=True)
        if inputs.overlays:
            _write_overlay(inputs.overlays / f"{answer.key.scene_id}.png", answer)

    done, stored = 0, list[str]()
    with kernels_beside(), progress_bar() as progress:
        bar = progress.add_task("", total=len(sound))

        def inspect(job: Job) -> None:
            def show(step: str) -> None:
                progress.update(bar, description=f"{printable(job.folder.name)}: {PROGRESS[step]}")

            inspected = run(job, show, tell)
            print(f"  stored, scene id {inspected.key.scene_id}", flush=True)
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


def describe(answer: Answer | Inspected) -> str:
    """What was found in a scene, in a few lines."""
    found = [_found(kind, rows) for kind in KINDS if kind.counts_in(rows := answer.features.get(kind.name, ()))]
    lines = [
        f"{answer.key}: {'; '.join(found)}; {answer.seconds['total']:.1f} s",
        *(f"  warning: {warning}" for warning in answer.warnings),
    ]
    return "\n".join(lines)


def _write_overlay(path: Path, answer: Answer) -> None:
    """Write the overlay's picture; whoever shows it never finds half of one."""
    with replacing(path, durable=False) as partial:
        partial.write_bytes(answer.picture())
    print(f"  overlay {path}", flush=True)


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


def _way_to_run(inputs: Inputs, use_server: bool) -> Run:
    """In this process, or as a Prefect flow where a server is configured, which answers when the scene is stored."""
    if runs_on_server(use_server):
        from flows.prefect_flows import inspect_scene_flow

        store, rig, spec, settings = map(_text, (inputs.store, inputs.rig, inputs.panel_spec, inputs.settings))

        def on_server(job: Job, _show: Callable[[str], None], tell: Callable[[Answer], None]) -> Inspected:
            inspected = inspect_scene_flow(str(job.folder), str(store), rig, spec, settings)
            overlay = job.store.paths(inspected.key.scene_id).overlay
            tell(Answer(inspected.key, inspected.features, inspected.warnings, inspected.seconds, overlay.read_bytes))
            return inspected

        return on_server
    return lambda job, show, tell: inspect_scene(job, on_step=show, on_answer=tell)


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

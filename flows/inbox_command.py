"""An inbox run as the command line shows it."""

from __future__ import annotations

from contextlib import nullcontext

from flows.assemble_panels import assemble_after
from flows.cli import EXIT_DONE, EXIT_SOME_FAILED, print_error
from flows.compiling import kernels_beside
from flows.deliver import deliver_after_run
from flows.inbox import inspected_scenes, only_run, plan, run_here, write_parquet
from flows.inbox_job import InboxJob, Outcome, Way
from flows.inbox_report import summary
from flows.prefect_server import runs_on_server
from flows.progress import progress_bar
from metrology.errors import UsageError
from storage.archive import Store


def run_inbox(job: InboxJob, way: Way, use_server: bool) -> int:
    """Inspect an inbox; returns the command's exit code."""
    outcomes: list[Outcome] = []
    on_server = runs_on_server(use_server)
    if on_server:
        from flows.prefect_inbox import run_on_server

        run_on_server(job, way, outcomes.append)
        for outcome in outcomes:
            _tell(outcome)
    elif way.runner != "processes":
        raise UsageError(f"--runner {way.runner}: found no Prefect server, expected one to be configured, or --server")
    else:
        _run_here(job, way.workers, outcomes)
    print(summary(outcomes))
    if not on_server:
        for problem in deliver_after_run(Store(job.store), outcomes):
            print_error(problem)
    bad = any(outcome.state in ("quarantined", "failed") for outcome in outcomes)
    return EXIT_SOME_FAILED if bad else EXIT_DONE


def _run_here(job: InboxJob, workers: int, outcomes: list[Outcome]) -> None:
    with only_run(job.inbox), progress_bar() as progress:
        planned = plan(job)
        bar = progress.add_task("inspecting", total=len(planned.ready))

        def take(outcome: Outcome) -> None:
            outcomes.append(outcome)
            _tell(outcome)

        for outcome in planned.settled:
            take(outcome)

        def finish(outcome: Outcome) -> None:
            take(outcome)
            progress.advance(bar)

        with kernels_beside() if planned.ready else nullcontext():
            run_here(job, planned.ready, workers, finish)
        assemble_after(Store(job.store), inspected_scenes(outcomes))
        if place := write_parquet(job, outcomes):
            print(f"tables for other engines in {place}")


def _tell(outcome: Outcome) -> None:
    if outcome.state == "inspected":
        print(f"{outcome.scene_id}: {outcome.text}; {outcome.seconds:.1f} s")
    elif outcome.state in ("quarantined", "failed"):
        print_error(f"{outcome.text} ({'put aside' if outcome.state == 'quarantined' else 'left for the next run'})")
    elif outcome.state in ("waiting", "signed off"):
        print(f"{outcome.scene_id}: left, {outcome.text}")

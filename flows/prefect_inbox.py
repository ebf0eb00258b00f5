"""The inbox as a Prefect flow: one task per scene, a progress bar and a summary in Prefect's pages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from prefect import flow, get_run_logger, task
from prefect.artifacts import create_markdown_artifact, create_progress_artifact, update_progress_artifact
from prefect.cache_policies import NO_CACHE
from prefect.futures import PrefectFuture, as_completed
from prefect.task_runners import TaskRunner, ThreadPoolTaskRunner

from flows.assemble_panels import assemble_after
from flows.dask_workers import dask_workers
from flows.deliver import deliver_after_run
from flows.inbox import inspect_folder, inspect_in, inspected_scenes, only_run, plan, write_parquet
from flows.inbox_folders import put_aside
from flows.inbox_job import InboxJob, Outcome, Runner, Way
from flows.inbox_report import markdown
from flows.prefect_page import show_scene
from flows.workers import worker_processes
from storage.archive import Store
from storage.documents import printable


# Without tags: for a tagged task Prefect asks its server first whether the tag is limited, and where SQLite is busy
# just then, tries again after two seconds.
@task(
    name="inspect-scene",
    task_run_name="{folder}",
    cache_policy=NO_CACHE,
    persist_result=False,
    description="One scene of an inbox, from its files to its published result.",
)
def inspect_folder_task(job: InboxJob, folder: Path, processes: Executor | None) -> Outcome:
    """Inspect one scene folder, here or in one of `processes`; its picture and rows become an artifact."""
    outcome = inspect_in(processes, job, folder) if processes else inspect_folder(job, folder)
    if outcome.state == "inspected" and outcome.scene_id:
        show_scene(Store(job.store), outcome.scene_id)
    return outcome


@task(
    name="compact",
    tags=["flushline", "store"],
    cache_policy=NO_CACHE,
    persist_result=False,
    description="The tables as Parquet partitioned by aircraft, for other engines.",
)
def compact_task(job: InboxJob, outcomes: list[Outcome]) -> str | None:
    """Compact the store's tables if the job asks for it and something new is in them."""
    return write_parquet(job, outcomes)


@task(
    name="deliver",
    tags=["flushline", "store"],
    cache_policy=NO_CACHE,
    persist_result=False,
    description="What is new, to web-hooks, folders and object storage.",
)
def deliver_task(job: InboxJob, outcomes: list[Outcome]) -> list[str]:
    """Deliver what is new to the store's targets; returns what a person should know."""
    return deliver_after_run(Store(job.store), outcomes)


@flow(
    name="inspect_inbox",
    description="Inspect what is new in an inbox; put aside what is broken.",
    validate_parameters=False,
    persist_result=False,
)
def inspect_inbox_flow(
    inbox: str,
    store: str,
    rig: str | None = None,
    panel_spec: str | None = None,
    settings: str | None = None,
    settle_s: float = 30.0,
    compact: bool = True,
    runner: Runner = "processes",
    workers: int = 1,
    dask_address: str | None = None,
) -> list[Outcome]:
    """Inspect an inbox.

    Parameters
    ----------
    inbox, store, rig, panel_spec, settings : str
        Paths.
    settle_s : float
        A folder whose newest change is younger than this many seconds is still being copied.
    compact : bool
        Write the tables as Parquet for other engines when something new was inspected.
    runner : "processes", "threads" or "dask"
        What runs the scenes' tasks. It is opened here and not given to the flow from outside, so that a deployment,
        whose flow is loaded anew for each run, can say it, too.
    workers : int
        Scenes at a time.
    dask_address : str, optional
        Of the scheduler of a Dask cluster that stands already; without it `workers` processes are started here.
    """
    job = InboxJob(Path(inbox), Path(store), _path(rig), _path(panel_spec), _path(settings), settle_s, compact)
    with only_run(job.inbox):
        planned = plan(job)
        outcomes = list(planned.settled)
        progress: Any = create_progress_artifact(0.0, key="inbox-progress", description=f"{len(planned.ready)} scenes")
        with task_runner(runner, workers, dask_address) as (running, processes):
            futures = {
                running.submit(inspect_folder_task, {"job": job, "folder": folder, "processes": processes}): folder
                for folder in planned.ready
            }
            for future in as_completed(list(futures)):
                outcomes.append(outcome_of(job, futures[future], future))
                done = len(outcomes) - len(planned.settled)
                update_progress_artifact(progress, 100.0 * done / len(futures))
        assemble_after(Store(job.store), inspected_scenes(outcomes))
        if job.compact:
            compact_task(job, outcomes)
    for problem in deliver_task(job, outcomes):
        get_run_logger().warning(problem)
    create_markdown_artifact(markdown(outcomes), key="inbox-summary", description=inbox)
    return outcomes


def outcome_of(job: InboxJob, folder: Path, future: PrefectFuture[Outcome]) -> Outcome:
    """A task's outcome; what ended the task itself is the outcome of its folder and of no other."""
    try:
        return future.result()
    except Exception as problem:
        if type(problem).__name__ == "KilledWorker":  # Dask's, after it tried several workers
            reason = "found that the workers at it died one after the other, expected it to be inspected"
            return put_aside(job.inbox, folder, reason, None)
        said = " ".join(str(problem).split())
        return Outcome(folder, "failed", text=printable(f"{folder}: found {type(problem).__name__}: {said}"))


@contextmanager
def task_runner(
    kind: Runner, workers: int, dask_address: str | None = None
) -> Iterator[tuple[TaskRunner[Any], Executor | None]]:
    """What runs the scenes' tasks, and the processes that they inspect in; see `inspect_inbox_flow`.

    Prefect's own runner of processes would start Prefect in each of them and set it up again for every task, at half a
    second per scene. Here its tasks are threads that wait for plain processes, or for Dask's.
    """
    with ExitStack() as opened:
        processes: Executor | None = None
        if kind == "dask":
            processes, workers = opened.enter_context(dask_workers(workers, dask_address))
        elif kind == "processes":
            processes = opened.enter_context(worker_processes(workers))
        yield opened.enter_context(ThreadPoolTaskRunner(max_workers=workers)), processes


def flow_parameters(job: InboxJob, way: Way) -> dict[str, Any]:
    """The flow's parameters; paths are absolute, so that it can run elsewhere."""
    paths = {field: _text(getattr(job, field)) for field in ("inbox", "store", "rig", "panel_spec", "settings")}
    return {**paths, "settle_s": job.settle_s, "compact": job.compact, **asdict(way)}


def run_on_server(job: InboxJob, way: Way, on_outcome: Callable[[Outcome], None]) -> None:
    """Run the flow here and now; its outcomes are reported when it is done."""
    for outcome in inspect_inbox_flow(**flow_parameters(job, way)):
        on_outcome(outcome)


def _path(text: str | None) -> Path | None:
    return Path(text) if text else None


def _text(path: Path | None) -> str | None:
    return str(path.absolute()) if path else None


def serve(job: InboxJob, way: Way, cron: str, timezone: str | None, name: str) -> int:
    """Serve the flow as a deployment with a schedule until the process is stopped."""
    from prefect.schedules import Cron

    from metrology.errors import UsageError

    try:
        schedule = Cron(cron, timezone=timezone or "UTC")
    except ValueError:
        raise UsageError(
            f"--cron: found {cron!r}, expected five fields as cron has them, such as '0 2 * * *'"
        ) from None
    inspect_inbox_flow.serve(
        name=name, schedule=schedule, parameters=flow_parameters(job, way), tags=["flushline"], limit=1
    )
    return 0

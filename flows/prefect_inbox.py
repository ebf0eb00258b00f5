"""The inbox as a Prefect flow: one task per scene, a progress bar and a summary in Prefect's pages."""

from __future__ import annotations

import base64
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
from prefect import flow, task
from prefect.artifacts import create_markdown_artifact, create_progress_artifact, update_progress_artifact
from prefect.cache_policies import NO_CACHE
from prefect.futures import as_completed
from prefect.task_runners import ProcessPoolTaskRunner, TaskRunner, ThreadPoolTaskRunner

from flows.inbox import inspect_folder, only_run, plan, write_parquet
from flows.inbox_job import InboxJob, Outcome, Runner, Way
from flows.inbox_report import markdown
from storage.archive import Store

_PICTURE_WIDTH = 800


@task(
    name="inspect-scene",
    task_run_name="{folder}",
    tags=["flushline", "scene"],
    cache_policy=NO_CACHE,
    persist_result=False,
    description="One scene of an inbox, from its files to its published result.",
)
def inspect_folder_task(job: InboxJob, folder: Path) -> Outcome:
    """Inspect one scene folder; its picture and rows become an artifact."""
    outcome = inspect_folder(job, folder)
    if outcome.state == "inspected" and outcome.scene_id:
        create_markdown_artifact(
            scene_page(Store(job.store), outcome.scene_id), key="scene", description=outcome.scene_id
        )
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
        with task_runner(runner, workers, dask_address) as running:
            futures = [running.submit(inspect_folder_task, {"job": job, "folder": f}) for f in planned.ready]
            for future in as_completed(futures):
                outcomes.append(future.result())
                done = len(outcomes) - len(planned.settled)
                update_progress_artifact(progress, 100.0 * done / len(futures))
        compact_task(job, outcomes)
    create_markdown_artifact(markdown(outcomes), key="inbox-summary", description=inbox)
    return outcomes


def task_runner(kind: Runner, workers: int, dask_address: str | None = None) -> TaskRunner[Any]:
    """What runs the scenes' tasks; see `inspect_inbox_flow`."""
    if kind == "threads":
        return ThreadPoolTaskRunner(max_workers=workers)
    if kind == "processes":
        return ProcessPoolTaskRunner(max_workers=workers)
    from metrology.errors import UsageError

    try:
        from prefect_dask import DaskTaskRunner
    except ImportError:
        raise UsageError(
            "--runner dask: found no prefect-dask, expected it installed: pip install flushline[dask]"
        ) from None
    if dask_address:
        return DaskTaskRunner(address=dask_address)
    return DaskTaskRunner(cluster_kwargs={"n_workers": workers, "threads_per_worker": 1})


def flow_parameters(job: InboxJob, way: Way) -> dict[str, Any]:
    """The flow's parameters; paths are absolute, so that it can run elsewhere."""
    paths = {field: _text(getattr(job, field)) for field in ("inbox", "store", "rig", "panel_spec", "settings")}
    return {**paths, "settle_s": job.settle_s, "compact": job.compact, **asdict(way)}


def run_on_server(job: InboxJob, way: Way, on_outcome: Callable[[Outcome], None]) -> None:
    """Run the flow here and now; its outcomes are told when it is done."""
    for outcome in inspect_inbox_flow(**flow_parameters(job, way)):
        on_outcome(outcome)


def scene_page(store: Store, scene_id: str) -> str:
    """A scene's overlay and rows as Markdown."""
    lines = [f"# {scene_id}", *_picture(store.paths(scene_id).overlay)]
    rows = store.query(
        "SELECT rivet_id, height_mean_mm, height_u95_mm, tilt_deg, decision FROM rivets "
        "WHERE scene_id = ? ORDER BY rivet_id",
        [scene_id],
    ).to_pylist()
    lines += ["", "| rivet | height mm | U95 mm | tilt ° | decision |", "|---|---:|---:|---:|---|"]
    lines += [f"| {' | '.join(_cell(value) for value in row.values())} |" for row in rows]
    seams = store.query(
        "SELECT seam_id, n_stations, step_mean_mm, step_abs_p95_mm, width_mean_mm, n_fail FROM seam_summary "
        "WHERE scene_id = ? ORDER BY seam_id",
        [scene_id],
    ).to_pylist()
    if seams:
        lines += ["", "| seam | positions | mean step mm | 95 % of steps mm | mean width mm | fail |"]
        lines += ["|---|---:|---:|---:|---:|---:|"]
        lines += [f"| {' | '.join(_cell(value) for value in row.values())} |" for row in seams]
    return "\n".join(lines)


def _cell(value: object) -> str:
    return "–" if value is None else f"{value:.3f}" if isinstance(value, float) else str(value)


def _picture(path: Path) -> list[str]:
    """A picture small enough to stand in a page itself."""
    picture = cv2.imread(str(path))
    if picture is None:
        return []
    height = round(picture.shape[0] * _PICTURE_WIDTH / picture.shape[1])
    _, data = cv2.imencode(".jpg", cv2.resize(picture, (_PICTURE_WIDTH, height), interpolation=cv2.INTER_AREA))
    return ["", f"![overlay](data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()})"]


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
    except ValueError as problem:
        text = str(problem).splitlines()[0]
        raise UsageError(
            f"--cron, --timezone: found {cron!r}, {timezone!r} ({text}), expected a cron line and a zone"
        ) from None
    inspect_inbox_flow.serve(
        name=name, schedule=schedule, parameters=flow_parameters(job, way), tags=["flushline"], limit=1
    )
    return 0

"""The same steps as Prefect tasks. Importing this takes seconds: only where a Prefect server is used."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from prefect import Task, task
from prefect.cache_policies import NO_CACHE
from prefect.client.schemas.objects import TaskRun
from prefect.states import State

from tasks import calibration, steps

_IO_RETRIES = 2
_IO_RETRY_SECONDS = 5.0


def _is_passing(_task: Task[..., Any], _run: TaskRun, state: State[Any]) -> bool:
    """Only trouble with a disk or a network may pass; a bad scene stays bad."""
    error = state.result(raise_on_failure=False)
    return isinstance(error, OSError) or isinstance(getattr(error, "__cause__", None), OSError)


def _step(function: Callable[..., Any], *tags: str) -> Task[..., Any]:
    # Arrays go from task to task by reference; hashing them for a cache would cost more than the step.
    settings = task(
        name=function.__name__.replace("_", "-"),
        tags=["flushline", *tags],
        cache_policy=NO_CACHE,
        persist_result=False,
        retries=_IO_RETRIES if "io" in tags else 0,
        retry_delay_seconds=_IO_RETRY_SECONDS,
        retry_condition_fn=_is_passing,
    )
    return settings(function)


TASKS = {
    steps.load: _step(steps.load, "io"),
    steps.reconstruct_scene: _step(steps.reconstruct_scene, "io", "metrology"),
    steps.detect_rivets: _step(steps.detect_rivets, "metrology"),
    steps.check_rig: _step(steps.check_rig, "metrology"),
    steps.detect_seams: _step(steps.detect_seams, "metrology"),
    steps.measure_rivets: _step(steps.measure_rivets, "metrology"),
    steps.measure_holes: _step(steps.measure_holes, "metrology"),
    steps.measure_seams: _step(steps.measure_seams, "metrology"),
    steps.register: _step(steps.register, "io", "metrology"),
    steps.judge: _step(steps.judge, "metrology"),
    steps.draw_overlay: _step(steps.draw_overlay, "metrology"),
    steps.publish: _step(steps.publish, "io", "store"),
    calibration.load_calibration_capture: _step(calibration.load_calibration_capture, "io"),
    calibration.detect_pose: _step(calibration.detect_pose, "io", "metrology"),
    calibration.solve_rig: _step(calibration.solve_rig, "metrology"),
    calibration.write_rig: _step(calibration.write_rig, "io"),
}


def call(step: Callable[..., Any], *arguments: Any) -> Any:
    """Run a step as its task."""
    return TASKS[step](*arguments)

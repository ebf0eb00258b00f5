"""The same steps as Prefect tasks. Importing this takes seconds: only where a Prefect server is used."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

from prefect import Task, task
from prefect.cache_policies import NO_CACHE
from prefect.client.schemas.objects import TaskRun
from prefect.states import State

from metrology.kinds import load
from metrology.steps import STEPS
from tasks import calibration

P = ParamSpec("P")
Result = TypeVar("Result")

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
    **{load(step.function): _step(load(step.function), *step.tags) for step in STEPS},
    calibration.load_calibration_capture: _step(calibration.load_calibration_capture, "io"),
    calibration.detect_pose: _step(calibration.detect_pose, "io", "metrology"),
    calibration.solve_rig: _step(calibration.solve_rig, "metrology"),
    calibration.write_rig: _step(calibration.write_rig, "io"),
}


def call(step: Callable[P, Result], *arguments: P.args, **named: P.kwargs) -> Result:
    """Run a step as its task."""
    return cast(Result, TASKS[step](*arguments, **named))

"""A whole scene, from its frames to the published result, beside reading the same frames with OpenCV.

    OPENBLAS_NUM_THREADS=1 python benchmarks/bench_scene.py SCENE --rig RIG [--repeats 5] [--steps]

One thread of BLAS, as every command of Flushline sets it. The first inspection of the process loads compiled kernels
and is not counted. Times by the clock and of all threads; on a busy machine only the latter mean something. With
`--steps` everything is run one after the other, and the least CPU time of each step is shown.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import ParamSpec, TypeVar
from unittest.mock import patch

import cv2

import flows.inspect_scene as inspection
from flows.inspect_scene import Job, inspect_scene
from flows.memory import share_heap
from storage.archive import Store
from storage.panel_spec import load_panel_spec
from tasks.settings import load_settings

P = ParamSpec("P")
Result = TypeVar("Result")


def timed(work: Callable[[], object], repeats: int, best: Callable[[list[float]], float]) -> tuple[float, float]:
    """Seconds by the clock and of all threads: the median, or the least."""
    wall, cpu = [], []
    for _ in range(repeats):
        start, start_cpu = time.perf_counter(), time.process_time()
        work()
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - start_cpu)
    return best(wall), best(cpu)


class OneAfterTheOther:
    """In place of threads that work beside the rest."""

    def __init__(self, _threads: int) -> None:
        pass

    def __enter__(self) -> OneAfterTheOther:
        return self

    def __exit__(self, *_problem: object) -> None:
        pass

    def submit(self, work: Callable[P, Result], *arguments: P.args, **named: P.kwargs) -> Future[Result]:
        """Work at once."""
        done: Future[Result] = Future()
        done.set_result(work(*arguments, **named))
        return done


def show_steps(job: Job, repeats: int) -> None:
    """Print the least CPU time of each step."""
    taken: dict[str, list[float]] = {}

    def call(step: Callable[P, Result], *arguments: P.args, **named: P.kwargs) -> Result:
        start = time.process_time()
        result = step(*arguments, **named)
        taken.setdefault(step.__name__, []).append(time.process_time() - start)
        return result

    encode = inspection.encode
    with (
        patch("flows.inspect_scene.ThreadPoolExecutor", OneAfterTheOther),
        patch.object(inspection, "encode", lambda *given: call(encode, *given)),
    ):
        for _ in range(repeats):
            inspect_scene(job, call)
    for name, values in taken.items():
        print(f"  {name:18s} {1000 * min(values):6.0f} ms of CPU")


def main() -> None:
    """Time and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("--rig", type=Path, required=True)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--steps", action="store_true", help="least CPU time of each step, all one after the other")
    options = parser.parse_args()
    frames = [path for camera in ("left", "right") for path in sorted((options.scene / camera).glob("*"))]

    def read() -> None:
        for path in frames:
            cv2.imread(str(path), cv2.IMREAD_UNCHANGED)

    share_heap()  # as `flushline inspect` does
    best = min if options.steps else statistics.median
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    reading = timed(read, options.repeats, best)
    cv2.setNumThreads(threads)
    with tempfile.TemporaryDirectory() as folder:
        job = Job(options.scene, Store(Path(folder) / "store"), options.rig, load_settings(), load_panel_spec())
        seconds: dict[str, list[float]] = {}
        answered: list[float] = []

        def inspect() -> None:
            start = time.perf_counter()
            done = inspect_scene(job, on_answer=lambda _: answered.append(time.perf_counter() - start))
            for name, value in done.seconds.items():
                seconds.setdefault(name, []).append(value)

        inspect()
        seconds.clear()
        answered.clear()
        inspecting = timed(inspect, options.repeats, best)
        print(f"{len(frames)} frames with cv2.imread, one thread: {reading[0]:.3f} s, CPU {reading[1]:.3f} s")
        print(f"whole scene: {inspecting[0]:.3f} s, CPU {inspecting[1]:.3f} s")
        print(f"answer before storing: {best(answered):.3f} s, ratio {best(answered) / reading[0]:.1f} by the clock")
        print(f"ratio: {inspecting[0] / reading[0]:.1f} by the clock, {inspecting[1] / reading[1]:.1f} of CPU")
        if options.steps:
            show_steps(job, options.repeats)
            return
    for name, values in seconds.items():
        print(f"  {name:16s} {1000 * statistics.median(values):6.0f} ms")


if __name__ == "__main__":
    main()

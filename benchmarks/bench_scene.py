"""A whole scene, from its frames to the published result, beside reading the same frames with OpenCV.

    OPENBLAS_NUM_THREADS=1 python benchmarks/bench_scene.py SCENE --rig RIG [--repeats 5]

One thread of BLAS, as every command of Flushline sets it. The first inspection of the process loads compiled kernels
and is not counted. Times by the clock and of all threads; on a busy machine only the latter mean something.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2

from flows.inspect_scene import Job, inspect_scene
from flows.memory import share_heap
from storage.archive import Store
from storage.panel_spec import load_panel_spec
from tasks.settings import load_settings


def timed(work: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Median seconds by the clock and of all threads."""
    wall, cpu = [], []
    for _ in range(repeats):
        start, start_cpu = time.perf_counter(), time.process_time()
        work()
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - start_cpu)
    return statistics.median(wall), statistics.median(cpu)


def main() -> None:
    """Time and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("--rig", type=Path, required=True)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    frames = [path for camera in ("left", "right") for path in sorted((options.scene / camera).glob("*"))]

    def read() -> None:
        for path in frames:
            cv2.imread(str(path), cv2.IMREAD_UNCHANGED)

    share_heap()  # as `flushline inspect` does
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    reading = timed(read, options.repeats)
    cv2.setNumThreads(threads)
    steps: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        job = Job(options.scene, Store(Path(folder) / "store"), options.rig, load_settings(), load_panel_spec())

        def inspect() -> None:
            for name, seconds in inspect_scene(job).seconds.items():
                steps.setdefault(name, []).append(seconds)

        inspect()
        steps.clear()
        inspecting = timed(inspect, options.repeats)
    print(f"{len(frames)} frames with cv2.imread, one thread: {reading[0]:.3f} s, CPU {reading[1]:.3f} s")
    print(f"whole scene: {inspecting[0]:.3f} s, CPU {inspecting[1]:.3f} s")
    print(f"ratio: {inspecting[0] / reading[0]:.1f} by the clock, {inspecting[1] / reading[1]:.1f} of CPU")
    for name, values in steps.items():
        print(f"  {name:16s} {1000 * statistics.median(values):6.0f} ms")


if __name__ == "__main__":
    main()

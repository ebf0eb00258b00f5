"""Many scenes through `flushline run`: seconds and CPU of a scene beside `cv2.imread` of its files, memory of a worker.

    python benchmarks/bench_inbox.py SCENE --rig RIG [--scenes 50] [--workers 2] [--dask]

The scene's files are linked under other aircraft serials, so that each is a scan of its own. What the command takes to
start and to import is part of it. Memory is looked at ten times a second: the most that a process held (VmHWM), and its
share where what processes map alike is divided among them (PSS, at its highest look).
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import cv2

_LOOKS_S = 0.1


def copies(scene: Path, inbox: Path, count: int) -> None:
    """The scene under several serials; its frames are linked, not copied."""
    for index in range(count):
        folder = inbox / f"scan-{index:03d}"
        for camera in ("left", "right"):
            (folder / camera).mkdir(parents=True)
            for path in (scene / camera).iterdir():
                try:
                    os.link(path, folder / camera / path.name)
                except OSError:  # another disk
                    (folder / camera / path.name).write_bytes(path.read_bytes())
        manifest = json.loads((scene / "scene.json").read_text(encoding="utf-8"))
        manifest["aircraft_serial"] = f"BENCH-{index:04d}"
        (folder / "scene.json").write_text(json.dumps(manifest), encoding="utf-8")


def reading(scene: Path) -> tuple[float, float]:
    """Least seconds by the clock and of CPU for the scene's files on one thread."""
    frames = [path for camera in ("left", "right") for path in sorted((scene / camera).glob("*"))]
    cv2.setNumThreads(1)
    taken = []
    for _ in range(3):
        start, start_cpu = time.perf_counter(), time.process_time()
        for path in frames:
            cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        taken.append((time.perf_counter() - start, time.process_time() - start_cpu))
    return min(wall for wall, _ in taken), min(cpu for _, cpu in taken)


class Memory:
    """Watches the processes that descend from one."""

    def __init__(self, root: int) -> None:
        self.peak: dict[int, int] = {}
        self.share: dict[int, int] = {}
        self._root, self._over = root, threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Look no longer."""
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._over.wait(_LOOKS_S):
            for process in _family(self._root):
                _keep(self.peak, process, f"/proc/{process}/status", "VmHWM")
                _keep(self.share, process, f"/proc/{process}/smaps_rollup", "Pss")


def _keep(most: dict[int, int], process: int, path: str, name: str) -> None:
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError:  # has ended
        return
    if found := re.search(rf"^{name}:\s+(\d+)", text, re.MULTILINE):
        most[process] = max(most.get(process, 0), int(found[1]) // 1024)


def _family(root: int) -> list[int]:
    found, new = [], [root]
    while new:
        found += new
        children = []
        for process in new:
            for path in Path(f"/proc/{process}/task").glob("*/children"):
                try:
                    children += [int(child) for child in path.read_text(encoding="utf-8").split()]
                except OSError:
                    continue
        new = children
    return found


def main() -> int:
    """Run, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("--rig", type=Path, required=True)
    parser.add_argument("--scenes", type=int, default=50)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--dask", action="store_true", help="on Dask workers, under a Prefect server that is started")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as root:
        inbox, store = Path(root) / "inbox", Path(root) / "store"
        copies(options.scene, inbox, options.scenes)
        wall_read, cpu_read = reading(options.scene)
        command = [sys.executable, "-c", "import sys; from flows.cli import main; sys.exit(main())", "run"]
        command += ["--inbox", str(inbox), "--store", str(store), "--rig", str(options.rig.absolute()), "--settle", "0"]
        command += ["--workers", str(options.workers), *(["--runner", "dask", "--server"] if options.dask else [])]
        start = time.perf_counter()
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        memory = Memory(running.pid)
        said, _ = running.communicate()
        memory.stop()
        wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(said.strip().splitlines()[-1])
    each, cpu_each = wall / options.scenes, cpu / options.scenes
    print(f"cv2.imread, one thread: {wall_read:.3f} s, CPU {cpu_read:.3f} s")
    print(f"a scene: {each:.3f} s, {each / wall_read:.2f} times; CPU {cpu_each:.3f} s, {cpu_each / cpu_read:.2f} times")
    for process, peak in sorted(memory.peak.items(), key=lambda item: -item[1])[: options.workers + 1]:
        print(f"process {process}: at most {peak} MB, {memory.share.get(process, 0)} MB of its own and its share")
    return running.returncode


if __name__ == "__main__":
    sys.exit(main())

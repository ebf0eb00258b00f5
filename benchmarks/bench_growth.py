"""How a scene's CPU time and memory grow with its pixels, exposures, rivets and seams.

    OPENBLAS_NUM_THREADS=1 python benchmarks/bench_growth.py --keep FOLDER [--only 5-mpx 60-rivets] [--repeats 3]

Scans are simulated once, into FOLDER. Each is inspected in a process of its own, once to load the kernels and then
`--repeats` times; the least CPU time counts, beside that of `cv2.imread` of the same files, and the most memory the
process held (VmHWM). The last column divides CPU time by that of the first row, over how much larger the scan is.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flows.simulate import simulate_folders
from metrology.kinds import RIVET, SEAM_STATION
from simulator.panel import Rivet, Seam
from simulator.spec import SimulationSpec, shipped_spec
from storage.scene_models import MANIFEST

_FEW_RIVETS, _ONE_SEAM = 8, 1


@dataclass(frozen=True)
class Case:
    """A scan to be inspected.

    Attributes
    ----------
    name : str
    scale : float
        Pixels along a side, over those of the demonstration's cameras.
    exposures : int
    rivets, seams : int
    of : {"pixels", "rivets", "seams"}
        What makes it larger than the first.
    """

    name: str
    scale: float = 1.0
    exposures: int = 1
    rivets: int = _FEW_RIVETS
    seams: int = _ONE_SEAM
    of: str = "pixels"

    @property
    def larger(self) -> float:
        """How much larger than the first one."""
        ratios = {"rivets": self.rivets / _FEW_RIVETS, "seams": self.seams / _ONE_SEAM}
        return ratios.get(self.of, self.scale**2 * self.exposures)

    @property
    def spec(self) -> SimulationSpec:
        """What is to be simulated."""
        spec = shipped_spec("demo")
        design = spec.rig.design
        design = replace(
            design,
            camera_width=round(design.camera_width * self.scale),
            camera_height=round(design.camera_height * self.scale),
            camera_focal_px=design.camera_focal_px * self.scale,
        )
        exposures = tuple(0.5 * 2.0**index for index in range(self.exposures)) if self.exposures > 1 else (1.0,)
        return replace(
            spec,
            rig=replace(spec.rig, design=design),
            camera=replace(spec.camera, exposures=exposures),
            panel=replace(spec.panel, rivets=_rivets(self.rivets), seams=_seams(self.seams)),
        )


CASES = (
    Case("2 Mpx"),
    Case("5 Mpx", math.sqrt(2.5)),
    Case("12 Mpx", math.sqrt(6.0)),
    Case("3 exposures", exposures=3),
    Case("30 rivets", rivets=30, of="rivets"),
    Case("60 rivets", rivets=60, of="rivets"),
    Case("2 seams", seams=2, of="seams"),
    Case("4 seams", seams=4, of="seams"),
)


def _rivets(count: int) -> tuple[Rivet, ...]:
    """Heads in rows across the panel, apart from where the seams are."""
    columns = (-120.0, -108.0, -62.0, -50.0, -16.0, 16.0, 50.0, 62.0, 108.0, 120.0)
    rows = (-75.0, 75.0, -45.0, 45.0, -15.0, 15.0)
    places = [(x, y) for y in rows for x in columns]
    step = max(1, len(places) // count)
    return tuple(
        Rivet(f"R{i:02d}", x_mm=x, y_mm=y, diameter_mm=6.0, height_mm=0.02 * (i % 7 - 3), tilt_deg=0.2)
        for i, (x, y) in enumerate(places[::step][:count])
    )


def _seams(count: int) -> tuple[Seam, ...]:
    """Gaps from border to border."""
    return tuple(
        Seam(f"J{i}", ((x, -105.0), (x, 105.0)), width_mm=(1.8, 2.0), step_mm=(0.1, 0.15), chamfer_mm=0.25)
        for i, x in enumerate((0.0, -85.0, 85.0, -35.0)[:count])
    )


def inspect(scene: Path, rig: Path, repeats: int) -> dict[str, Any]:
    """Inspect a scan in this process; CPU seconds, peak memory and what was found."""
    import cv2

    from flows.inspect_scene import Job, inspect_scene
    from flows.memory import share_heap
    from storage.archive import Store
    from storage.panel_spec import load_panel_spec
    from tasks.settings import load_settings

    share_heap()
    frames = [path for camera in ("left", "right") for path in sorted((scene / camera).glob("*"))]
    taken, read = [], []
    with tempfile.TemporaryDirectory() as folder:
        job = Job(scene, Store(Path(folder) / "store"), rig, load_settings(), load_panel_spec())
        for _ in range(repeats + 1):
            start = time.process_time()
            inspected = inspect_scene(job)
            taken.append(time.process_time() - start)
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    peak = int(re.search(r"VmHWM:\s+(\d+)", status)[1]) // 1024  # type: ignore[index]
    cv2.setNumThreads(1)
    for _ in range(repeats):
        start = time.process_time()
        for path in frames:
            cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        read.append(time.process_time() - start)
    rivets, stations = inspected.features[RIVET.name], inspected.features[SEAM_STATION.name]
    return {
        "seconds": min(taken[1:]),
        "reading": min(read),
        "peak_mb": peak,
        "found": f"{len(rivets)} rivets, {len({row.seam_id for row in stations})} seams",
    }


def main() -> None:
    """Simulate, inspect, print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", type=Path, required=True, metavar="FOLDER", help="scans, kept for the next time")
    parser.add_argument("--only", nargs="*", metavar="NAME", help="names with '-' for ' '")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--one", nargs=2, type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(inspect(*options.one, options.repeats)))
        return
    print(
        "| scan | CPU s | × `cv2.imread` | peak MB | found | over the first, per size |\n|---|---:|---:|---:|---|---:|"
    )
    first = 0.0
    for case in CASES:
        name = case.name.replace(" ", "-")
        if options.only and name not in options.only:
            continue
        folder = options.keep / name
        if not (folder / "rig.json").is_file():
            simulate_folders(case.spec, folder)
        (scene,) = (path.parent for path in folder.glob(f"*/{MANIFEST}"))
        command = [sys.executable, __file__, "--keep", str(options.keep), "--repeats", str(options.repeats)]
        done = subprocess.run(
            [*command, "--one", str(scene), str(folder / "rig.json")], capture_output=True, text=True, check=True
        )
        row = json.loads(done.stdout.splitlines()[-1])
        first = first or row["seconds"]
        growth = row["seconds"] / first / case.larger
        print(
            f"| {case.name} | {row['seconds']:.2f} | {row['seconds'] / row['reading']:.1f} | {row['peak_mb']} | "
            f"{row['found']} | {growth:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()

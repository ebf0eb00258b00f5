"""Does every wrong input become one line? Input files are changed at random and read.

    python benchmarks/fuzz_inputs.py --mutations 2000 --inspect 60

Of each change there are two outcomes: a sound object, or a FlushlineError whose text is one line that names the file.
With --inspect a small simulated scene is changed and inspected by the command line: exit 0 and a store that holds it,
or one error line and no store. Exit code 1 where anything else came out.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path

import cv2

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from metrology.fringe import FringeCode
from tests.support.fuzzing import fuzz, fuzz_inspect


def simulated_scene(folder: Path) -> tuple[Path, Path]:
    """A small scene and its rig."""
    from flows.simulate import simulate_folders
    from simulator.panel import Panel, Rivet, Seam, Skin, Surface
    from simulator.rig import RigDesign
    from simulator.spec import Placement, RigSpec, SceneKeys, SimulationSpec

    panel = Panel(
        skin=Skin(1500.0, 3000.0, 25.0),
        rivets=(Rivet("R1", -11.0, 8.0, 8.0, 0.12, 0.5, 40.0), Rivet("R2", -12.0, -8.0, 6.0, -0.08, 0.3, 200.0)),
        seams=(Seam("J1", ((5.0, -110.0), (7.0, 0.0), (4.0, 110.0)), (1.8, 2.2), (0.1, 0.3, 0.2), chamfer_mm=0.3),),
        surface=Surface(brushing=0.0, blotches=0.0),
    )
    spec = SimulationSpec(
        format="flushline-simulation/1",
        scene=SceneKeys("MSN-1", "P1", "S1", "2026-11-20T08:00:00Z"),
        panel=panel,
        rig=RigSpec(design=RigDesign(camera_width=260, camera_height=200, camera_focal_px=3640.0), seed=3),
        placements=(Placement((0.0, 0.0, 0.0), (2.0, -3.0, 1.0)),),
        fringe=FringeCode("x", 4, (70, 64, 59)),
    )
    folders, rig = simulate_folders(spec, folder)
    return folders[0], rig


def main() -> int:
    """Run as told by the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutations", type=int, default=2000)
    parser.add_argument("--inspect", type=int, default=60, help="scans that are changed and inspected")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--memory-mb", type=int, default=4096, help="address space that the process may use")
    options = parser.parse_args()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # as the command line has it
    resource.setrlimit(resource.RLIMIT_AS, (options.memory_mb * 2**20,) * 2)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        wrong = fuzz(Path(folder), options.mutations, options.seed)
        if options.inspect:
            scene, rig = simulated_scene(Path(folder) / "simulated")
            wrong += fuzz_inspect(Path(folder), scene, rig, options.inspect, options.seed)
    print("\n".join(wrong))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{options.mutations} mutations read, {options.inspect} inspected, {len(wrong)} wrong; "
        f"{time.perf_counter() - began:.0f} s, {peak:.0f} MB at most"
    )
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())

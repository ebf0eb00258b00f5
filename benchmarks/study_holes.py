"""Open holes and countersinks on six rigs: found, named, within 0.05 mm, within U95.

python benchmarks/study_holes.py [--rigs 1 2 …] [--panels 1] [--first 0] [--keep DIR]

Panels of a dozen drilled holes of 3 to 9.5 mm, half of them countersunk at 82 to 120°, with nothing, another sheet or
sealant behind, in small pictures. A panel takes about ten seconds of CPU; reconstructed scans are kept in DIR.
"""

from __future__ import annotations

import argparse
import pickle
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from rigs import RIGS

from metrology.cloud import Reconstruction
from metrology.fastening import detect_fasteners
from metrology.holes import measure_holes
from metrology.reconstruct import reconstruct
from metrology.results import Hole
from simulator.panel import Hole as PanelHole
from simulator.panel import Panel
from simulator.random_panel import Variety, random_placement, random_skin, random_surface
from simulator.scene import expose, fringe_light, make_rig, set_up
from simulator.spec import Camera, RigSpec, SimulationSpec, shipped_spec
from simulator.truth import TrueHole

SIZE_PX = (560, 420)  # of the part of the panel that the cameras see
BORES_MM, ANGLES_DEG = (3.0, 9.5), (82.0, 90.0, 100.0, 120.0)
SAME_PX = 12.0
BAR_MM = 0.05


def specification(number: int, k: int) -> SimulationSpec:
    """The k-th panel before the rig of that number: holes on a lattice, a little off its places."""
    rng, kind = np.random.default_rng([41, number, k]), RIGS[number]
    base = shipped_spec("skin")
    width, height = (n * kind.px_mm for n in SIZE_PX)
    variety = Variety(size_mm=(width, height), stickers=0, scratches=(0, 5))
    columns, rows = int(width // 22.0), int(height // 22.0)
    places = [(c, r) for r in range(rows) for c in range(columns)][:16]
    holes = tuple(
        drilled(rng, width * ((c + 0.5) / columns - 0.5), height * ((r + 0.5) / rows - 0.5)) for c, r in places
    )
    panel = Panel(width, height, random_skin(rng, variety), holes=holes, surface=random_surface(rng, variety))
    return replace(
        base, panel=panel, placements=(random_placement(rng, 10.0, 3.0),), seed=k,
        rig=RigSpec(seed=number, design=kind.design(640, 512)), camera=Camera(blur_px=kind.blur_px, samples=32),
        light=replace(base.light, brightness=float(rng.uniform(180, 330))),
    )  # fmt: skip


def drilled(rng: np.random.Generator, x: float, y: float) -> PanelHole:
    bore = float(rng.uniform(*BORES_MM))
    outer = min(bore * float(rng.uniform(1.3, 1.9)), 15.0) if rng.uniform() < 0.5 else 0.0
    behind = 0.0 if rng.uniform() < 0.5 else float(rng.uniform(0.1, 1.0))
    dx, dy = rng.uniform(-1.5, 1.5, 2)
    return PanelHole(
        x + dx, y + dy, bore, float(rng.uniform(1.5, 5.0)) + 0.5 * outer, behind,
        countersink_mm=outer, countersink_deg=float(rng.choice(ANGLES_DEG)),
    )  # fmt: skip


def kept_scan(number: int, k: int, folder: Path | None) -> tuple[Reconstruction, tuple[TrueHole, ...]]:
    """One panel's reconstructed scan, traced or as kept, and its true holes."""
    path = folder / f"{number}-{k}.pickle" if folder else None
    if path and path.exists():
        return tuple(pickle.loads(path.read_bytes()))
    spec = specification(number, k)
    rng = np.random.default_rng([9, number, k])
    stage = set_up(spec, make_rig(spec), spec.placements[0])
    light = fringe_light(spec, stage, rng)
    left, right = (expose(spec, light[side], rng) for side in ("left", "right"))
    scan = reconstruct(left, right, stage.rig, spec.fringe, spec.camera.exposures)
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps((scan, stage.truth.holes)))
    return scan, stage.truth.holes


def count(name: str, true: TrueHole, found: list[Hole]) -> Counter[str]:
    """One hole of the truth against what was found; what is not as it should be is printed."""
    total = Counter[str]()
    near = [h for h in found if np.hypot(h.u_px - true.uv_px[0], h.v_px - true.uv_px[1]) < SAME_PX]
    kind = "countersunk" if true.countersink_mm else "plain"
    total[f"{kind} true"] += 1
    what = f"{name} {true.id} bore {true.diameter_mm:.2f} countersink {true.countersink_mm:.2f}"
    if not near:
        print(f"{what}: not found")
        return total
    hole = near[0]
    total[f"{kind} found"] += 1
    if hole.diameter_mm is None or hole.diameter_u95_mm is None:
        total[f"{kind} not measured"] += 1
        print(f"{what}: {hole.reason}")
        return total
    error = hole.diameter_mm - true.diameter_mm
    total[f"{kind} measured"] += 1
    total[f"{kind} within {BAR_MM}"] += abs(error) < BAR_MM
    total[f"{kind} within U95"] += abs(error) <= hole.diameter_u95_mm
    total[f"{kind} named"] += (hole.countersink_diameter_mm is not None) == bool(true.countersink_mm)
    if abs(error) > max(BAR_MM, hole.diameter_u95_mm):
        print(
            f"{what}: off by {error:+.3f}, U95 {hole.diameter_u95_mm:.3f}, countersink {hole.countersink_diameter_mm}"
        )
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, nargs="*", choices=tuple(RIGS))
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--panels", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for reconstructed scans")
    arguments = parser.parse_args()
    total = Counter[str]()
    for number in arguments.rigs or RIGS:
        for k in range(arguments.first, arguments.first + arguments.panels):
            scan, true = kept_scan(number, k, arguments.keep)
            found = measure_holes(detect_fasteners(scan).openings, scan)
            visible = [t for t in true if t.visible]
            for t in visible:
                total += count(f"rig {number} panel {k}", t, found)
            right = {h.hole_id for h in found for t in true
                     if np.hypot(h.u_px - t.uv_px[0], h.v_px - t.uv_px[1]) < SAME_PX}  # fmt: skip
            total["false"] += len(found) - len(right)
    for name in sorted(total):
        print(f"{name}: {total[name]}")


if __name__ == "__main__":
    main()

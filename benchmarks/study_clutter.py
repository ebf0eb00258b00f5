"""Rivets and holes of cluttered panels: recall, precision, misses and false findings one by one, diameters of holes.

python benchmarks/study_clutter.py --keep FOLDER [--first 1] [--panels 60]

Panels of 200 × 150 mm at 0.2 mm a pixel with all that a hall adds: at least twenty stencilled characters, painted
rings, stickers, grease pencil, chips and drops, holes (half of them countersunk), temporary fasteners, recessed heads,
dents and scratches; every second one shaken by 15 µm and flickering by 3 %. The rings of one panel have one contrast:
4, 6, 10 or 20 grey levels. A panel takes about half a minute to render and two seconds to inspect; its pictures stay in
FOLDER, and a study that was stopped goes on where it was. Panels of which an inspection would say that they are
overexposed are counted apart.
"""

from __future__ import annotations

import argparse
import os
import pickle
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from flows.study.clutter import lies_on
from metrology.cloud import PixelFlag
from metrology.fastening import Fasteners, detect_fasteners
from metrology.holes import measure_holes
from metrology.reconstruct import reconstruct
from metrology.results import Hole, RivetDetection
from simulator.random_clutter import Clutter
from simulator.random_panel import Variety, random_panel, random_placement
from simulator.scene import expose, fringe_light, make_rig, set_up
from simulator.spec import SimulationSpec, shipped_spec
from simulator.truth import Pose, TrueHole, TrueRivet, Truth

LEVELS = (4.0, 6.0, 10.0, 20.0)
PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]
_SAME_PX = {"open hole": 15.0, "temporary fastener": 40.0}  # a tall one leans away from its foot
_DIAMETER_MM = 0.05
_OVEREXPOSED = 0.05  # of the picture: an inspection warns of such scans


@dataclass(frozen=True)
class Kept:
    """A rendered panel."""

    spec: SimulationSpec
    truth: Truth
    pose: Pose
    frames: dict[str, np.ndarray]


def specification(k: int) -> SimulationSpec:
    """The k-th panel."""
    base, rng = shipped_spec("skin"), np.random.default_rng([7, k])
    level = LEVELS[k % len(LEVELS)]
    variety = Variety(
        size_mm=(200.0, 150.0), rivets=(8, 18), ring_levels=(level, level), skin_level=100.0, reflectance=(0.6, 0.6)
    )
    placement = random_placement(rng)
    panel = random_panel(rng, variety, blur_px=base.camera.blur_px, clutter=Clutter(holes=(1, 3)))
    shaken = replace(base.disturbances, vibration_mm=0.015, flicker=0.03)
    return replace(
        base,
        rig=replace(base.rig, design=replace(base.rig.design, camera_width=1000, camera_height=760)),
        camera=replace(base.camera, samples=24),
        panel=panel,
        placements=(placement,),
        repeats=1,
        seed=1 + k,
        disturbances=shaken if k % 2 else base.disturbances,
    )


def kept_or_rendered(spec: SimulationSpec, path: Path) -> Kept:
    """A panel as it is kept in a file, rendered where it is not yet."""
    if not path.exists():
        stage = set_up(spec, make_rig(spec), spec.placements[0])
        rng = np.random.default_rng([spec.seed, 2, 0, 0])
        light = fringe_light(spec, stage, rng)
        frames = {side: expose(spec, light[side], rng) for side in ("left", "right")}
        coded = {side: [cv2.imencode(".png", f, PNG)[1] for e in frames[side] for f in e] for side in frames}
        part = path.with_suffix(".part")
        shapes = {side: frames[side].shape for side in frames}
        part.write_bytes(pickle.dumps((spec, stage.truth, stage.pose, coded, shapes)))
        os.replace(part, path)
    spec, truth, pose, coded, shapes = pickle.loads(path.read_bytes())
    frames = {
        side: np.stack([cv2.imdecode(c, cv2.IMREAD_UNCHANGED) for c in coded[side]]).reshape(shapes[side])
        for side in coded
    }
    return Kept(spec, truth, pose, frames)


def on(detection: RivetDetection, true: TrueRivet) -> bool:
    """Whether a rivet's centre lies in the inner half of a detection's ellipse."""
    return bool(np.hypot(detection.u_px - true.uv_px[0], detection.v_px - true.uv_px[1]) < detection.minor_px / 4)


def count_rivets(name: str, kept: Kept, found: Sequence[RivetDetection], points: np.ndarray) -> Counter[str]:
    """Counts of one panel; misses and false ones are printed."""
    total = Counter[str]()
    for true in kept.truth.rivets:
        if not true.visible:
            continue
        here = [d for d in found if on(d, true)]
        sure = any(d.doubt is None for d in here)
        total["rivets"] += 1
        total["found"] += sure
        total["doubted"] += bool(here) and not sure
        if not sure:
            why = here[0].doubt if here else "no ring"
            print(
                f"{name} missed {true.id} ({true.kind}, {true.diameter_mm:.1f} mm, {true.height_mean_mm:+.3f}): {why}"
            )
    for d in found:
        total["reported"] += d.doubt is None
        total["unconfirmed"] += d.doubt is not None
        if d.doubt is None and not any(on(d, true) for true in kept.truth.rivets):
            total["false"] += 1
            point = points[round(d.v_px), round(d.u_px)].astype(float)
            place = "?" if np.isnan(point).any() else lies_on(kept.spec.panel, *kept.pose.to_panel(point)[:2])
            print(f"{name} false at {d.u_px:.0f}, {d.v_px:.0f} px, {d.major_px:.0f} px across, on: {place}")
    return total


def count_holes(name: str, truth: Truth, found: Sequence[Hole]) -> Counter[str]:
    """Counts of one panel's holes and temporary fasteners."""
    total = Counter[str]()
    right: set[str] = set()
    for true in truth.holes:
        kind = "open hole" if true.kind == "hole" else "temporary fastener"
        if not true.visible:
            right |= {h.hole_id for h in found if away_px(h, true) < _SAME_PX[kind]}
            continue
        total[kind] += 1
        near = [h for h in found if h.kind == kind and away_px(h, true) < _SAME_PX[kind]]
        if not near or near[0].decision == "unconfirmed":
            print(f"{name} missed {kind} of {true.diameter_mm:.2f} mm, countersink {true.countersink_mm:.1f}")
            continue
        hole = near[0]
        right.add(hole.hole_id)
        total[f"{kind} found"] += 1
        if kind == "open hole":
            total += count_diameters(name, true, hole)
    total["false holes"] = sum(h.hole_id not in right and h.decision != "unconfirmed" for h in found)
    return total


def away_px(hole: Hole, true: TrueHole) -> float:
    return float(np.hypot(hole.u_px - true.uv_px[0], hole.v_px - true.uv_px[1]))


def count_diameters(name: str, true: TrueHole, hole: Hole) -> Counter[str]:
    """Whether bore and countersink are right, and covered by their U95."""
    total = Counter[str]()
    for what, measured, u95, expected in (
        ("bore", hole.diameter_mm, hole.diameter_u95_mm, true.diameter_mm),
        ("countersink", hole.countersink_diameter_mm, hole.countersink_diameter_u95_mm, true.countersink_mm or None),
    ):
        total[f"{what} true"] += expected is not None
        if measured is None or u95 is None or expected is None:
            continue
        total[f"{what} measured"] += 1
        total[f"{what} within {_DIAMETER_MM} mm"] += abs(measured - expected) < _DIAMETER_MM
        total[f"{what} within U95"] += abs(measured - expected) <= u95
        if abs(measured - expected) > max(_DIAMETER_MM, u95):
            print(f"{name} {what} of {expected:.2f} mm: off by {measured - expected:+.3f}, U95 {u95:.3f}")
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", type=Path, required=True, help="folder of the rendered panels")
    parser.add_argument("--first", type=int, default=1, help="number of the first panel")
    parser.add_argument("--panels", type=int, default=60)
    arguments = parser.parse_args()
    arguments.keep.mkdir(parents=True, exist_ok=True)
    total, overexposed = Counter[str](), Counter[str]()
    for k in range(arguments.first, arguments.first + arguments.panels):
        kept = kept_or_rendered(specification(k), arguments.keep / f"{k:03d}.pkl")
        name = f"panel {k} ({LEVELS[k % len(LEVELS)]:.0f} levels):"
        left, right = kept.frames["left"], kept.frames["right"]
        cloud = reconstruct(left, right, make_rig(kept.spec), kept.spec.fringe, kept.spec.camera.exposures)
        fasteners: Fasteners = detect_fasteners(cloud)
        counted = count_rivets(name, kept, fasteners.rivets, cloud.points)
        counted += count_holes(name, kept.truth, measure_holes(fasteners.openings, cloud))
        saturated = float(((cloud.left.flags & np.uint16(PixelFlag.SATURATED)) != 0).mean())
        if saturated > _OVEREXPOSED:
            overexposed += counted
            print(f"{name} {saturated:.0%} saturated")
        else:
            total += counted
        report(f"up to {k}", total)
    report("overexposed", overexposed)


def report(name: str, total: Counter[str]) -> None:
    recall = total["found"] / max(total["rivets"], 1)
    precision = 1 - total["false"] / max(total["reported"], 1)
    others: dict[str, Any] = {name: total[name] for name in total if name not in ("rivets", "found", "reported")}
    print(f"{name}: recall {recall:.4f} of {total['rivets']}, precision {precision:.4f}; {others}", flush=True)


if __name__ == "__main__":
    main()

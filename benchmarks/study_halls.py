"""Panels as a hall has them, whole scans of 1.4 megapixels: rivets, holes, and what U95 of a seam's step and width covers.

python benchmarks/study_halls.py --keep FOLDER [--first 1] [--panels 6] [--stations]

Four rows of four heads with one left out (an open hole), half of them recessed, a seam between the plates, letters and
a sticker across it, dents beside it, painted rings, chips and drops; shaken by 15 µm, flickering by 3 %, gamma 1.6.
Pictures stay in FOLDER. With --stations every seam station is printed: place, errors, U95, what lies nearest.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from study_clutter import Kept, count_holes, count_rivets, kept_or_rendered, report
from study_seams import errors, summary

from metrology.fastening import detect_fasteners
from metrology.holes import measure_holes
from metrology.moments import moment_of
from metrology.results import SceneKey
from metrology.cloud import Reconstruction
from metrology.rivets import measure_rivets
from metrology.seams import detect_seams, measure_seams
from simulator.clutter import Patch
from simulator.defects import Dent
from simulator.marks import Stencil
from simulator.panel import Hole, Rivet, Seam
from simulator.random_clutter import Clutter, with_clutter
from simulator.random_panel import Places, Variety, random_placement, random_skin, random_surface, ring_reflectance
from simulator.rig import RigDesign
from simulator.scene import make_rig
from simulator.spec import SimulationSpec, shipped_spec
from storage.archive import Store
from storage.rig import save_rig
from storage.scene import write_scene
from tasks import steps
from tasks.settings import InspectionSettings

SIZE_MM = (300.0, 205.0)
DIAMETERS_MM = (4.8, 6.4, 8.0, 9.5)
DESIGN = RigDesign(camera_width=1380, camera_height=1049, camera_focal_px=3090.0, stand_off_mm=700.0)
VARIETY = Variety(size_mm=SIZE_MM, radius_mm=(420.0, 2500.0), concave=True, scratches=(0, 20), stickers=1, smudges=2)
CLUTTER = Clutter(characters=45, rings=(3, 5), holes=(0, 1), clecos=(0, 2), recessed=0.5)


def specification(k: int) -> SimulationSpec:
    """The k-th panel."""
    base, rng = shipped_spec("skin"), np.random.default_rng([23, k])
    placement = random_placement(rng)
    places = rng.uniform(-1, 1, 5)
    seam = Seam(
        "J01", tuple((4.0 + 2.0 * float(p), y) for p, y in zip(places, (-104.0, -50.0, 0.0, 50.0, 104.0), strict=True)),
        tuple(float(w) for w in rng.uniform(0.5, 2.6) * (1 + rng.uniform(-0.06, 0.06, 5))),
        tuple(float(s) for s in rng.uniform(-0.3, 0.3) + rng.uniform(-0.1, 0.1, 5)),
        chamfer_mm=float(rng.choice([0.2, 0.3, 0.45])), depth_mm=float(rng.uniform(1.5, 4.0)),
        floor_reflectance=float(rng.uniform(0.15, 0.5)), edge_reflectance=float(rng.uniform(0.6, 1.0)),
    )  # fmt: skip
    find = Places(VARIETY, (seam,))
    rivets, holes = _rows(rng, find.take)
    panel = replace(base.panel, width_mm=SIZE_MM[0], height_mm=SIZE_MM[1], skin=random_skin(rng, VARIETY),
                    surface=random_surface(rng, VARIETY), rivets=rivets, holes=holes, seams=(seam,))  # fmt: skip
    panel = _beside_the_seam(rng, with_clutter(rng, panel, CLUTTER, find.find))
    return replace(
        base,
        rig=replace(base.rig, seed=40 + k, design=DESIGN),
        camera=replace(base.camera, samples=32, blur_px=float(rng.uniform(0.6, 0.9))),
        projector=replace(base.projector, gamma=1.6),
        light=replace(base.light, brightness=186.0 / panel.surface.reflectance / (1 + 1.6 * panel.surface.specular)),
        panel=panel,
        placements=(placement,),
        repeats=1,
        seed=500 + k,
        disturbances=replace(base.disturbances, vibration_mm=0.015, flicker=0.03),
    )


def _rows(rng: np.random.Generator, take) -> tuple[tuple[Rivet, ...], tuple[Hole, ...]]:  # type: ignore[no-untyped-def]
    """Four rows of four heads, each a little off its place; one is a hole."""
    rivets, holes, missing = [], [], int(rng.integers(16))
    for k in range(16):
        x = (-118.0, -42.0, 42.0, 118.0)[k % 4] + float(rng.uniform(-1, 1))
        y = (76.0, 26.0, -26.0, -76.0)[k // 4] + float(rng.uniform(-2, 2))
        size = float(rng.choice(DIAMETERS_MM))
        take(x, y, size)
        if k == missing:
            holes.append(Hole(x, y, size))
            continue
        ring, level = float(rng.uniform(0.1, 0.2)), float(np.exp(rng.uniform(*np.log((6.0, 30.0)))))
        rivets.append(Rivet(
            f"R{k + 1:02d}", x, y, size, float(rng.uniform(-0.1, 0.15)), float(rng.uniform(0, 0.6)),
            float(rng.uniform(0, 360)), 0.0, ring, 0.3, ring_reflectance(level, ring, 100.0, 0.75, 0.227),
        ))  # fmt: skip
    return tuple(rivets), tuple(holes)


def _beside_the_seam(rng, panel):  # type: ignore[no-untyped-def]
    """A line of letters and a sticker across the seam, and a dent whose foot reaches it."""
    y = rng.permutation([-75.0, -25.0, 25.0, 75.0])
    letters = Stencil("RH-F11 STA 872", float(rng.uniform(-8, 15)), float(y[0]), 5.0, 180.0)
    sticker = Patch("rectangle", float(rng.uniform(-10, 12)), float(y[1]), (30.0, 18.0), float(rng.normal(0, 2)), -0.5)
    length = float(rng.uniform(14, 36))
    depth = float(np.exp(rng.uniform(*np.log((0.05, 0.4))))) * float(rng.choice([1, 1, -1]))
    side = float(rng.choice([-1, 1]))
    dent = Dent("D90", 4.0 + side * (4.0 + 0.7 * length), float(y[2]), depth, (length, 0.8 * length), 0.0, "smooth")
    surface = replace(
        panel.surface, stencils=(*panel.surface.stencils, letters), patches=(*panel.surface.patches, sticker)
    )
    return replace(panel, surface=surface, dents=(*panel.dents, dent))


def cloud_of(kept: Kept, folder: Path) -> Reconstruction:
    """The cloud as an inspection has it: from a scene folder, with what it does about uneven frames."""
    rig_path, spec = folder / "rig.json", kept.spec
    if not rig_path.exists():
        keys = spec.scene
        key = SceneKey(keys.aircraft_serial, keys.panel, keys.station, moment_of(keys.captured_at))
        left, right = kept.frames["left"], kept.frames["right"]
        write_scene(folder, key, spec.rig.id, spec.fringe, spec.camera.exposures, left, right, kept.truth.as_dict())
        save_rig(make_rig(spec), rig_path)
    return steps.reconstruct_scene(steps.load(folder, rig_path, Store(folder / "store")), InspectionSettings())


def near_by(kept: Kept, x: float, y: float) -> str:
    """What lies beside a place of the seam, panel frame."""
    panel, found = kept.spec.panel, []
    for dent in panel.all_dents:
        away = math.hypot(x - dent.x_mm, y - dent.y_mm)
        if away < 8 + dent.axes_mm[0]:
            found.append(f"dent {dent.depth_mm:+.2f}, {dent.axes_mm[0]:.0f} mm, {away:.0f} away")
    for stencil in panel.surface.stencils:
        if abs(y - stencil.y_mm) < stencil.cap_mm and abs(x - stencil.x_mm) < 40:
            found.append("letters")
    for patch in panel.surface.patches:
        if math.hypot(x - patch.x_mm, y - patch.y_mm) < 0.6 * max(patch.size_mm) + 8:
            found.append(patch.shape)
    return ", ".join(found) or "bare"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", type=Path, required=True, help="folder of the rendered panels")
    parser.add_argument("--first", type=int, default=1, help="number of the first panel")
    parser.add_argument("--panels", type=int, default=6)
    parser.add_argument("--stations", action="store_true", help="print every seam station")
    arguments = parser.parse_args()
    arguments.keep.mkdir(parents=True, exist_ok=True)
    total, steps, heights = Counter[str](), [], []
    for k in range(arguments.first, arguments.first + arguments.panels):
        kept = kept_or_rendered(specification(k), arguments.keep / f"hall-{k:03d}.pkl")
        name = f"panel {k}:"
        cloud = cloud_of(kept, arguments.keep / f"hall-{k:03d}")
        fasteners = detect_fasteners(cloud)
        lines = detect_seams(cloud, fasteners.rivets)
        rivets = measure_rivets(fasteners.rivets, cloud, lines)
        stations = measure_seams(lines, cloud, fasteners.rivets)
        total += count_rivets(name, kept, fasteners.rivets, cloud.points)
        total += count_holes(name, kept.truth, measure_holes(fasteners.openings, cloud))
        for true in kept.truth.rivets:
            for row in rivets:
                if (
                    math.hypot(row.u_px - true.uv_px[0], row.v_px - true.uv_px[1]) < row.minor_px / 4
                    and not row.decision
                ):
                    if row.height_mean_mm is None:
                        print(f"{name} {true.id} ({true.kind}, {true.diameter_mm} mm): {row.reason}")
                    else:
                        heights.append((row.height_mean_mm - true.height_mean_mm, row.height_u95_mm))
        found = errors(stations, kept.truth.as_dict())
        steps.append(found)
        print(f"{name} step  {summary(found[:, 1], found[:, 2])}\n          width {summary(found[:, 3], found[:, 4])}")
        if arguments.stations:
            truth = kept.truth.as_dict()["seams"][0]
            for place, step, u95, width, width_u95 in found:
                at = [
                    np.interp(place, np.arange(len(truth["xyz_mm"])), column) for column in np.array(truth["xyz_mm"]).T
                ]
                x, y = kept.pose.to_panel(np.array(at))[:2]
                mark = "!" if abs(step) > u95 else " "
                print(
                    f"   y {y:7.1f} step {step:+.4f} u95 {u95:.4f}{mark} width {width:+.3f} u95 {width_u95:.3f} {near_by(kept, x, y)}"
                )
        report(f"up to {k}", total)
    joined, errs = np.concatenate(steps), np.array(heights, float)
    print(f"steps  {summary(joined[:, 1], joined[:, 2])}\nwidths {summary(joined[:, 3], joined[:, 4])}")
    print(f"heights {summary(errs[:, 0], errs[:, 1])}")


if __name__ == "__main__":
    main()

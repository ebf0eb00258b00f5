"""Panels as a hall has them, in scans of 1.4 megapixels: rivets, holes, what U95 of step and width covers.

python benchmarks/study_halls.py --keep FOLDER [--kind hall] [--first 1] [--panels 6] [--stations]

Four rows of four heads with one left out (an open hole), half of them recessed, a seam between the plates, letters and
a sticker across it, dents beside it, painted rings, chips and drops; shaken by 15 µm, flickering by 3 %, gamma 1.6.
Pictures stay in FOLDER. With --kind lap or along panels of `coarse_panels.py`, before coarser cameras. With --stations
every seam station is printed: place, errors, U95, what lies nearest.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import coarse_panels
import numpy as np
from study_clutter import Kept, count_holes, count_rivets, kept_or_rendered, report
from study_seams import errors, summary

from metrology.cloud import Reconstruction
from metrology.errors import SceneError
from metrology.fastening import detect_fasteners
from metrology.holes import measure_holes
from metrology.moments import moment_of
from metrology.reconstruct import reconstruct
from metrology.results import Rivet, SceneKey
from metrology.rivets import measure_rivets
from metrology.seams import detect_seams, measure_seams
from simulator.clutter import Patch
from simulator.defects import Dent
from simulator.marks import Stencil
from simulator.panel import Hole, Panel, Seam
from simulator.panel import Rivet as SimulatedRivet
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
    free = Places(VARIETY, (seam,))
    rivets, holes = _rows(rng, free)
    panel = replace(base.panel, width_mm=SIZE_MM[0], height_mm=SIZE_MM[1], skin=random_skin(rng, VARIETY),
                    surface=random_surface(rng, VARIETY), rivets=rivets, holes=holes, seams=(seam,))  # fmt: skip
    panel = _beside_the_seam(rng, with_clutter(rng, panel, CLUTTER, free.find))
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


def _rows(rng: np.random.Generator, places: Places) -> tuple[tuple[SimulatedRivet, ...], tuple[Hole, ...]]:
    """Four rows of four heads, each a little off its place; one is a hole."""
    rivets, holes, missing = [], [], int(rng.integers(16))
    for k in range(16):
        x = (-118.0, -42.0, 42.0, 118.0)[k % 4] + float(rng.uniform(-1, 1))
        y = (76.0, 26.0, -26.0, -76.0)[k // 4] + float(rng.uniform(-2, 2))
        size = float(rng.choice(DIAMETERS_MM))
        places.take(x, y, size)
        if k == missing:
            holes.append(Hole(x, y, size))
            continue
        ring, level = float(rng.uniform(0.1, 0.2)), float(np.exp(rng.uniform(*np.log((6.0, 30.0)))))
        rivet = SimulatedRivet(
            f"R{k + 1:02d}", x, y, size, float(rng.uniform(-0.1, 0.15)), float(rng.uniform(0, 0.6)),
            float(rng.uniform(0, 360)), 0.0, ring, 0.3, ring_reflectance(level, ring, 100.0, 0.75, 0.227),
        )  # fmt: skip
        rivets.append(rivet)
    return tuple(rivets), tuple(holes)


def _beside_the_seam(rng: np.random.Generator, panel: Panel) -> Panel:
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
    try:
        return steps.reconstruct_scene(steps.load(folder, rig_path, Store(folder / "store")), InspectionSettings())
    except SceneError as problem:
        print(f"refused, so without what an inspection does about uneven frames: {problem}")
        return reconstruct(
            kept.frames["left"], kept.frames["right"], make_rig(spec), spec.fringe, spec.camera.exposures
        )


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


def print_stations(kept: Kept, found: np.ndarray) -> None:
    """Errors along the seam, and what lies near by."""
    truth = kept.truth.as_dict()["seams"][0]
    at = [np.interp(found[:, 0], np.arange(len(truth["xyz_mm"])), c) for c in np.array(truth["xyz_mm"]).T]
    for (_, step, u95, width, width_u95), point in zip(found, np.stack(at, axis=1), strict=True):
        x, y = kept.pose.to_panel(point)[:2]
        print(
            f"   y {y:7.1f} step {step:+.4f} U95 {u95:.4f}{'!' if abs(step) > u95 else ' '} width {width:+.3f} "
            f"U95 {width_u95:.3f} {near_by(kept, x, y)}"
        )


def height_errors(name: str, kept: Kept, rivets: Sequence[Rivet]) -> list[tuple[float, float]]:
    """Errors of heights and their U95; heads that were not measured are printed."""
    found = []
    for true in kept.truth.rivets:
        for row in rivets:
            near = math.hypot(row.u_px - true.uv_px[0], row.v_px - true.uv_px[1]) < row.minor_px / 4
            if not near or row.decision == "unconfirmed":
                continue
            if row.height_mean_mm is None or row.height_u95_mm is None:
                print(f"{name} {true.id} ({true.kind}, {true.diameter_mm} mm) not measured: {row.reason}")
            else:
                found.append((row.height_mean_mm - true.height_mean_mm, row.height_u95_mm))
    return found


KINDS = {"hall": specification, "lap": coarse_panels.lap, "along": coarse_panels.along}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", type=Path, required=True, help="folder of the rendered panels")
    parser.add_argument("--kind", choices=sorted(KINDS), default="hall")
    parser.add_argument("--first", type=int, default=1, help="number of the first panel")
    parser.add_argument("--panels", type=int, default=6)
    parser.add_argument("--stations", action="store_true", help="print every seam station")
    arguments = parser.parse_args()
    arguments.keep.mkdir(parents=True, exist_ok=True)
    total, seams, heights = Counter[str](), [], []
    for k in range(arguments.first, arguments.first + arguments.panels):
        folder = arguments.keep / f"{arguments.kind}-{k:03d}"
        kept = kept_or_rendered(KINDS[arguments.kind](k), folder.with_suffix(".pkl"))
        name, cloud = f"panel {k}:", cloud_of(kept, folder)
        fasteners = detect_fasteners(cloud)
        lines = detect_seams(cloud, fasteners.rivets)
        stations = measure_seams(lines, cloud, fasteners.rivets)
        heights += height_errors(name, kept, measure_rivets(fasteners.rivets, cloud, lines))
        total += count_rivets(name, kept, fasteners.rivets, cloud.points)
        total += count_holes(name, kept.truth, measure_holes(fasteners.openings, cloud))
        found = errors(stations, kept.truth.as_dict()) if stations else np.empty((0, 5))
        seams.append(found)
        print(f"{name} step  {summary(found[:, 1], found[:, 2])}\n   width {summary(found[:, 3], found[:, 4])}")
        if arguments.stations:
            print_stations(kept, found)
        report(f"up to {k}", total)
    joined, off = np.concatenate(seams), np.array(heights, float).reshape(-1, 2)
    print(f"steps   {summary(joined[:, 1], joined[:, 2])}\nwidths  {summary(joined[:, 3], joined[:, 4])}")
    print(f"heights {summary(off[:, 0], off[:, 1])}")


if __name__ == "__main__":
    main()

"""Seams on simulated panels: how many are found, whole and once, and what is found where there are none.

python benchmarks/seam_panels.py [--seams 20] [--joints 3] [--clutter 4] [--crowded 8]

Single seams 0.3–5 mm wide with steps of −1 … +1 mm, chamfers of 0–0.6 mm, in eight directions, some of them sealed, on
curved skin with rivets, scratches, stickers and painted lines; crossings and T joints; panels with 60 scratches,
stickers, holes and cables but no seam; crowded ones: two seams with a row of rivets beside the first, a cable, 60
scratches, stickers, painted lines and a skin that shines so much that highlights are cut off. About half a minute of
one core for each panel.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import cv2
import numpy as np
from scipy.spatial import cKDTree

from metrology.cloud import Reconstruction
from metrology.reconstruct import reconstruct
from metrology.results import SeamLine
from metrology.rivets import detect_rivets
from metrology.seams import detect_seams
from simulator.panel import Panel, Rivet, Seam
from simulator.random_panel import Variety, random_panel, random_placement
from simulator.scene import expose, fringe_light, make_rig, set_up
from simulator.spec import Camera, Lighting, RigSpec, SceneKeys, SimulationSpec
from tests.support.random_seams import SeamVariety, crossing_seams, random_seam

KINDS = ("seam", "cross", "T", "clutter", "crowded")


def seams_of(kind: str, number: int, of: int, rng: np.random.Generator) -> tuple[Seam, ...]:
    if kind == "seam":
        # Each width and step once, in an order of their own.
        width = np.geomspace(0.3, 5.0, of)[np.random.default_rng(5).permutation(of)[number]]
        step = np.linspace(-1, 1, of)[number * 7 % of]
        variety = SeamVariety(
            direction_deg=22.5 * (number % 8) + rng.uniform(-3, 3),
            width_mm=(0.97 * width, 1.03 * width),
            step_mm=(step - 0.05, step + 0.05),
            bow_mm=3.0,
        )
        return (random_seam(rng, variety, through=tuple(rng.uniform(-20, 20, 2))),)
    if kind in ("cross", "T"):
        return crossing_seams(rng, kind, SeamVariety(width_mm=(0.6, 3.5), step_mm=(-0.5, 0.5), filled=0.0))
    if kind == "crowded":
        return crossing_seams(rng, ("cross", "T")[number % 2], SeamVariety(width_mm=(0.4, 3.0), step_mm=(-0.3, 0.3)))
    return ()


def rivet_row(panel: Panel, rng: np.random.Generator) -> Panel:
    """The panel with a row of rivets along its first seam, but for where something else is."""
    points = np.array(panel.seams[0].points_mm)
    along = points[-1] - points[0]
    along = along / np.linalg.norm(along)
    beside = rng.choice([-1, 1]) * (max(panel.seams[0].width_mm) + rng.uniform(6, 9)) * np.array([-along[1], along[0]])
    row = []
    for k, way in enumerate(np.arange(-160, 160, rng.uniform(18, 25))):
        place = points[len(points) // 2] + way * along + beside
        inside = np.all(np.abs(place) < (panel.width_mm / 2 - 8, panel.height_mm / 2 - 8))
        free = all(np.hypot(*(place - (r.x_mm, r.y_mm))) > 12 for r in panel.rivets)
        clear = all(cKDTree(dense(seam)).query(place)[0] > 5 + max(seam.width_mm) for seam in panel.seams[1:])
        if inside and free and clear:
            row.append(Rivet(f"B{k:02d}", *place, 5.0, rng.uniform(-0.1, 0.15), ring_width_mm=0.2))
    return replace(panel, rivets=(*panel.rivets, *row))


def dense(seam: Seam) -> np.ndarray:
    """(n, 2) points of a seam's course, a hundredth of its length apart."""
    points = np.array(seam.points_mm)
    stops = np.linspace(0, len(points) - 1, 101)
    return np.stack([np.interp(stops, np.arange(len(points)), column) for column in points.T], axis=1)


def specification(kind: str, number: int, of: int) -> SimulationSpec:
    rng = np.random.default_rng([77, KINDS.index(kind), number])
    variety = Variety(rivets=(6, 12), scratches=(0, 20), stickers=1, smudges=2)
    if kind == "clutter":
        variety = Variety(rivets=(10, 24), scratches=(60, 60), stickers=3, holes=4, smudges=4, cables=2)
    brightness = (200, 330)
    if kind == "crowded":
        variety = Variety(rivets=(4, 8), scratches=(60, 60), stickers=3, smudges=3, cables=1, specular=(0.8, 1.5))
        brightness = (130, 190)
    panel = random_panel(rng, variety, seams_of(kind, number, of, rng))
    return SimulationSpec(
        "flushline-simulation/1",
        SceneKeys("SIM", "SEAMS", kind, "2026-11-20T09:00:00Z"),
        rivet_row(panel, rng) if kind == "crowded" else panel,
        RigSpec(seed=100 + number),
        (random_placement(rng),),
        camera=Camera(samples=24),
        light=Lighting(brightness=rng.uniform(*brightness)),
        seed=int(rng.integers(1, 10000)),
    )


def scan(spec: SimulationSpec) -> tuple[Reconstruction, dict[str, np.ndarray]]:
    """Cloud of one simulated scan, and its seams' visible stations (n, 2) px by their ids."""
    rig, rng = make_rig(spec), np.random.default_rng(spec.seed)
    stage = set_up(spec, rig, spec.placements[0])
    light = fringe_light(spec, stage, rng)
    left, right = (expose(spec, light[side], rng) for side in ("left", "right"))
    truth = {seam.id: np.array(seam.uv_px)[np.array(seam.visible)] for seam in stage.truth.seams}
    return reconstruct(left, right, rig, spec.fringe, spec.camera.exposures), truth


def along(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two polylines have about the same direction."""
    p, q = a[-1] - a[0], b[-1] - b[0]
    return abs(p @ q) > 0.9 * np.linalg.norm(p) * np.linalg.norm(q)


def matched(line: SeamLine, stations: np.ndarray) -> np.ndarray:
    """Which of a seam's stations a line passes: the ideal edges' middle lies within the dark band."""
    distance, _ = cKDTree(line.centre_px).query(stations)
    return (distance < 3 + 0.5 * np.nanmedian(line.width_px)) & along(line.centre_px, stations)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seams", type=int, default=20)
    parser.add_argument("--joints", type=int, default=3)
    parser.add_argument("--clutter", type=int, default=4)
    parser.add_argument("--crowded", type=int, default=8)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    joints = arguments.joints
    of_each = (arguments.seams, joints, joints, arguments.clutter, arguments.crowded)
    counts = dict(zip(KINDS, of_each, strict=True))
    true, once, false, flat, complete, seconds = 0, 0, 0, 0, [], []
    for kind, count in counts.items():
        for number in range(count):
            spec = specification(kind, number, count)
            cloud, truth = scan(spec)
            rivets = detect_rivets(cloud)
            detect_seams(cloud, rivets)
            start = time.process_time()
            lines = detect_seams(cloud, rivets)
            seconds.append(time.process_time() - start)
            found = [line for line in lines if line.relief]
            hits = {name: [matched(line, stations) for line in found] for name, stations in truth.items()}
            passed = {name: np.any(masks, axis=0) if masks else np.zeros(1, bool) for name, masks in hits.items()}
            pieces = {name: sum(mask.sum() > 10 for mask in masks) for name, masks in hits.items()}
            true += len(truth)
            once += sum(n == 1 for n in pieces.values())
            false += len(found) - sum(pieces.values())
            flat += len(lines) - len(found)
            complete += [float(mask.mean()) for mask in passed.values()]
            said = ", ".join(f"{n}: {pieces[n]} line(s), complete {passed[n].mean():.3f}" for n in truth)
            print(f"{kind} {number}: {said or 'no seam'}; {len(found)} found, {seconds[-1] * 1e3:.0f} ms", flush=True)
    print(
        f"{once} of {true} seams found as one line, completeness {np.mean(complete):.4f} (least {min(complete):.3f}); "
        f"{false} false; {flat} lines without relief; median {np.median(seconds) * 1e3:.0f} ms"
    )


if __name__ == "__main__":
    main()

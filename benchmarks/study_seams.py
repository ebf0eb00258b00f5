"""Accuracy and repeatability of seam measurement over simulated seams: the figures in docs/seams.md.

python benchmarks/study_seams.py [--seams 24] [--scans 1] [--only 5 11] [--draw 5] [--angles 6] [--shift 3]
                                  [--edges image|points] [--without NAME …]
python benchmarks/study_seams.py --rigs [1 2 …] [--seams 36] [--only 5 11] [--keep DIR] [--without NAME …]

Widths 0.3 to 5 mm, steps −1 to 1 mm, chamfers 0 to 0.6 mm, eight directions, bent skin, sealed ones, dark, bright and
shiny skin. A seam takes about 15 s of CPU to trace; further scans of it differ by noise alone.

With --rigs: what U95 covers on six rigs (resolution, baseline, blur), for butt joints, sealed ones and laps in all
directions, gaps of 0.05 to 2 mm, in small pictures. Reconstructed scans are kept in DIR, for measuring them again.

With --without: one refinement of the measurement switched off, to see what it buys.
"""

from __future__ import annotations

import argparse
import math
import pickle
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from rigs import RIGS

from metrology.cloud import Reconstruction
from metrology.reconstruct import reconstruct
from metrology.seams import SeamSettings, detect_seams, measure, measure_seams
from metrology.seams.gap import fit, image_edges, levels, prior, shape
from metrology.seams.gap.model import SKY
from metrology.seams.skins import neighbours
from simulator.pack import pack
from simulator.panel import Panel, Seam, Skin, Surface
from simulator.random_panel import random_placement
from simulator.rig import RigDesign
from simulator.scene import expose, fringe_light, make_rig, place, set_up
from simulator.spec import Camera, Lighting, RigSpec, SceneKeys, SimulationSpec
from simulator.truth import truth

KEYS = SceneKeys("SIM", "P", "S", "2026-11-20T08:00:00Z")
# A quarter of the usual cameras, of the usual resolution on the panel.
DESIGN = RigDesign(camera_width=640, camera_height=512)
WIDTHS_MM = (0.3, 5.0)
CHAMFERS_MM = (0.0, 0.15, 0.3, 0.45, 0.6, 0.3, 0.2, 0.5)
REFLECTANCES, SPECULARS = (0.5, 0.25, 0.8, 0.5), (0.0, 0.3, 0.0, 0.8)
# With the 64 rays a pixel that are usual near edges, a blurred border would be off by up to 4 % of its height.
RAYS = 500


def seam_spec(i: int, count: int, draw: int = 5, angle_sigma_deg: float = 0.0, shift: int = 0) -> SimulationSpec:
    """The i-th of `count` seams; what is left to chance differs by `draw`, chamfers' angles from 45° by the sigma.

    Gloss repeats every eight seams as chamfers do: a `shift` gives each skin other chamfers.
    """
    rng = np.random.default_rng([draw, i])
    # Every direction gets narrow and wide seams.
    width = float(np.geomspace(*WIDTHS_MM, count)[(i * 7) % count])
    step = rng.uniform(-1, 1) if i % 3 else rng.uniform(-0.2, 0.2)
    filled = i % 5 == 3
    curvatures = rng.uniform(-1 / 900, 1 / 900, 2)
    reflectance, specular = REFLECTANCES[i % 4], SPECULARS[i // 2 % 4]
    # From numbers of its own: all else stays what it is without.
    off = angle_sigma_deg * float(np.clip(np.random.default_rng([draw, i, 1]).normal(), -2.5, 2.5))
    seam = Seam(
        "J01",
        course(math.radians(22.5 * (i % 8)), rng.uniform(-1, 1)),
        tuple(float(w) for w in width * (1 + rng.uniform(-0.04, 0.04, 5))),
        tuple(float(s) for s in step + rng.uniform(-0.04, 0.04, 5)),
        chamfer_mm=0.0 if filled else CHAMFERS_MM[(5 * i + 3 + shift) % 8],
        chamfer_deg=45.0 + off,
        filled=filled,
        depth_mm=rng.uniform(0, 0.05) if filled else rng.uniform(1.5, 4),
        floor_reflectance=rng.uniform(0.15, 0.5),
        edge_reflectance=rng.uniform(0.6, 1.0),
    )
    surface = Surface(
        reflectance=reflectance, specular=specular, roughness=rng.uniform(0.3, 0.5),
        brushing=rng.uniform(0.005, 0.03), brushing_deg=rng.uniform(0, 180), random_scratches=10,
    )  # fmt: skip
    panel = Panel(
        180, 150, Skin(1 / curvatures[0], 1 / curvatures[1], rng.uniform(0, 180)), (), (seam,), surface=surface
    )
    brightness = 186.0 / reflectance / (1 + 1.6 * specular)
    return SimulationSpec(
        "flushline-simulation/1", KEYS, panel, RigSpec(seed=3 + i, design=DESIGN), (random_placement(rng, 10, 5),),
        camera=Camera(blur_px=rng.uniform(0.6, 0.95), samples=RAYS),
        light=Lighting(min(500.0, brightness), rng.uniform(10, 40), rng.uniform(0.3, 0.8)), seed=100 + i,
    )  # fmt: skip


def course(angle: float, bow: float) -> tuple[tuple[float, float], ...]:
    """A slightly bowed line through the panel's middle."""
    c, s = math.cos(angle), math.sin(angle)
    ways = (-1.0, -0.5, 0.0, 0.5, 1.0)
    return tuple((125 * w * c - bow * (0.5 - w * w) * s, 125 * w * s + bow * (0.5 - w * w) * c) for w in ways)


def errors(stations: list, truth: dict) -> np.ndarray:
    """(n, 5) place along the true seam, error and U95 of step, error and U95 of width; NaN where not measured."""
    true = truth["seams"][0]
    line, number = np.array(true["uv_px"]), np.arange(len(true["uv_px"]))
    along = np.diff(line, axis=0)
    rows = []
    # A scratch that passes for a seam is detection's error, not measurement's.
    counts = Counter(station.seam_id for station in stations)
    for station in stations:
        if station.seam_id != counts.most_common(1)[0][0]:
            continue
        pixel = np.array([station.u_px, station.v_px])
        share = np.clip(((pixel - line[:-1]) * along).sum(1) / (along**2).sum(1), 0, 1)
        distance = np.linalg.norm(line[:-1] + share[:, None] * along - pixel, axis=1)
        k = int(distance.argmin())
        if distance[k] > 12:
            continue
        place, row = k + share[k], [k + share[k]]
        for quantity in ("step", "width"):
            value, u95 = getattr(station, f"{quantity}_mm"), getattr(station, f"{quantity}_u95_mm")
            row += [
                np.nan if value is None else value - np.interp(place, number, true[f"{quantity}_mm"]),
                u95 or np.nan,
            ]
        rows.append(row)
    return np.array(rows, float).reshape(-1, 5)


# In turn, so that every rig has all of them in all directions.
JOINTS = ("butt", "lap", "butt", "butt sealed", "butt", "lap", "butt", "butt sealed", "butt", "butt")
GAPS_MM = (0.05, 2.0)


def rig_seam(number: int, i: int, count: int, draw: int = 21) -> SimulationSpec:
    """The i-th of `count` seams before the rig of that number."""
    rng = np.random.default_rng([draw, number, i])
    kind, joint = RIGS[number], JOINTS[i % len(JOINTS)]
    side = 520 * kind.px_mm
    sheet = joint == "lap"
    step = rng.choice([-1, 1]) * rng.uniform(0.4, 1.6) if sheet else rng.uniform(-1, 1) * (1.0 if i % 3 else 0.2)
    width = 0.0 if sheet else float(np.geomspace(*GAPS_MM, count)[(i * 7) % count])
    radius = float(rng.choice([0.0, 0.2, 0.5])) if sheet else 0.0
    broken = float(rng.choice(CHAMFERS_MM)) if joint == "butt" or (sheet and not radius) else 0.0
    # Evenly over a quarter turn; at 45° itself the last pixel decides which side is A.
    angle = 90.0 * ((i * 11) % count + 0.5) / count
    angle += 2.0 if abs(angle - 45.0) < 2.0 else 0.0
    seam = Seam(
        "J01", course(math.radians(angle), rng.uniform(-1, 1)),
        tuple(float(w) for w in width * (1 + rng.uniform(0.0, 0.08, 5))),
        tuple(float(s) for s in step + rng.uniform(-0.03, 0.03, 5)),
        chamfer_mm=min(broken, 0.8 * abs(step)) if sheet else broken, chamfer_deg=45.0 + float(rng.uniform(-5, 5)),
        filled=joint == "butt sealed", joint="lap" if sheet else "butt", edge_radius_mm=min(radius, 0.8 * abs(step)),
        depth_mm=rng.uniform(0, 0.05) if joint == "butt sealed" else rng.uniform(1.5, 4),
        floor_reflectance=rng.uniform(0.15, 0.5), edge_reflectance=rng.uniform(0.6, 1.0),
    )  # fmt: skip
    reflectance, specular = rng.uniform(0.25, 0.8), float(rng.choice([0.0, 0.3, 0.6]))
    surface = Surface(
        reflectance=reflectance, specular=specular, roughness=rng.uniform(0.3, 0.5),
        brushing=rng.uniform(0.005, 0.03), brushing_deg=rng.uniform(0, 180), random_scratches=0,
    )  # fmt: skip
    bends = rng.uniform(-1 / 900, 1 / 900, 2)
    panel = Panel(side, side, Skin(1 / bends[0], 1 / bends[1], rng.uniform(0, 180)), (), (seam,), surface=surface)
    brightness = 186.0 / reflectance / (1 + 1.6 * specular)
    return SimulationSpec(
        "flushline-simulation/1", KEYS, panel, RigSpec(seed=number, design=kind.design(400, 320)),
        (random_placement(rng, 10, 3),), camera=Camera(blur_px=kind.blur_px, samples=200),
        light=Lighting(min(500.0, brightness), rng.uniform(10, 40), rng.uniform(0.3, 0.8)), seed=100 + i,
    )  # fmt: skip


def kept_scan(number: int, i: int, count: int, folder: Path | None) -> tuple[Reconstruction, dict]:
    """One seam's reconstructed scan, traced or as kept, and its truth."""
    spec = rig_seam(number, i, count)
    rig, placement = make_rig(spec), spec.placements[0]
    true = truth(spec.panel, pack(spec.panel), rig, place(rig, placement)).as_dict()
    path = folder / f"{number}-{i}-of-{count}.pickle" if folder else None
    if path and path.exists():
        return pickle.loads(path.read_bytes()), true
    stage, rng = set_up(spec, rig, placement), np.random.default_rng([9, number, i])
    light = fringe_light(spec, stage, rng)
    left, right = (expose(spec, light[side], rng) for side in ("left", "right"))
    scan = reconstruct(left, right, rig, spec.fringe, spec.camera.exposures)
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(scan))
    return scan, true


def predicted_step_unused(lines: np.ndarray, covariance: np.ndarray, *_: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The smoothing's last part, which leaves everything as it is."""
    return lines, covariance


def even_floor() -> None:
    """No darkening of the floor towards its walls: its level is held at nothing."""
    usual = prior._levels
    prior._levels = lambda *light: [(0.0, 1e-6) if k == SKY else level for k, level in enumerate(usual(*light))]
    levels.LEVEL_SCATTER[SKY] = levels.COURSE_SCATTER[SKY] = 1e-6


# What the measurement can be had without: how it is switched off.
REFINEMENTS: dict[str, Callable[[], None]] = {
    "neighbours": lambda: setattr(neighbours, "smoothed", lambda sections, *_: list(sections)),
    "predicted-step": lambda: setattr(neighbours, "_step_told", predicted_step_unused),
    "shared-noise": lambda: setattr(neighbours, "shared_share", lambda *_: 0.0),
    "bends": lambda: setattr(measure, "with_unresolved_bends", lambda rows, *_: list(rows)),
    "courses": lambda: setattr(fit, "courses", lambda places, away: np.zeros_like(away)),
    "floor-darkening": even_floor,
    "likely-chamfers": lambda: setattr(shape, "weigh_chamfers", lambda free, some: (free, 0.0)),
    "open-rivals": lambda: setattr(fit, "sealant_doubt", lambda *_: 0.0),
    "broken-laps": lambda: setattr(image_edges, "gap_or_edge", lambda _: None),
}


def over_rigs(chosen: argparse.Namespace, settings: SeamSettings) -> None:
    """What U95 covers, by rig and by joint."""
    tables: dict[str, list[np.ndarray]] = {}
    counts: Counter[str] = Counter()
    for number in chosen.rigs or RIGS:
        for i in chosen.only or range(chosen.seams):
            scan, true = kept_scan(number, i, chosen.seams, chosen.keep)
            stations = measure_seams(detect_seams(scan, ()), scan, (), settings)
            seam = rig_seam(number, i, chosen.seams).panel.seams[0]
            true_kind = "lap" if seam.joint == "lap" else "butt sealed" if seam.filled else "butt"
            found = errors(stations, true) if stations else np.empty((0, 5))
            named = Counter(station.joint for station in stations).most_common(1)[0][0] if stations else "not found"
            for key in (f"rig {number} ({RIGS[number].px_mm} mm)", true_kind, "all"):
                tables.setdefault(key, []).append(found)
                counts[key] += 1
            print(
                f"rig {number} {i:2d} {true_kind:11s} as {named or '?':11s} width {seam.width_mm[2]:.2f} step "
                f"{seam.step_mm[2]:+.2f} edge {seam.chamfer_mm or seam.edge_radius_mm:.2f}: {len(found)} stations\n"
                f"   step  {summary(found[:, 1], found[:, 2])}\n   width {summary(found[:, 3], found[:, 4])}",
                flush=True,
            )
    for key in sorted(tables):
        joined = np.concatenate(tables[key])
        print(f"{key}: {counts[key]} seams, {len(joined)} seam stations")
        print(f"   step  {summary(joined[:, 1], joined[:, 2])}\n   width {summary(joined[:, 3], joined[:, 4])}")


def scans(spec: SimulationSpec, count: int, settings: SeamSettings) -> Iterator[tuple[np.ndarray, float]]:
    """Errors of each of `count` scans of one seam, and the CPU seconds of measuring it."""
    rig = make_rig(spec)
    stage = set_up(spec, rig, spec.placements[0])
    rng = np.random.default_rng([9, spec.seed])
    light = fringe_light(spec, stage, rng)
    for _ in range(count):
        frames = [expose(spec, light[side], rng) for side in ("left", "right")]
        scan = reconstruct(frames[0], frames[1], rig, spec.fringe, spec.camera.exposures)
        lines = detect_seams(scan, ())
        start = time.process_time()
        stations = measure_seams(lines, scan, (), settings)
        yield errors(stations, stage.truth.as_dict()), time.process_time() - start


def summary(error: np.ndarray, u95: np.ndarray) -> str:
    """Statistics of what was measured."""
    known = np.isfinite(error) & np.isfinite(u95)
    error, u95 = error[known], u95[known]
    if not len(error):
        return "none"
    size = np.abs(error)
    return (
        f"n {len(error):4d} |e| {size.mean():.4f} bias {error.mean():+.4f} sd {error.std():.4f} "
        f"p95 {np.percentile(size, 95):.4f} U95 {np.median(u95):.4f} covers {100 * np.mean(size <= u95):.0f} %"
    )


def scatter(runs: list[np.ndarray], column: int) -> str:
    """Usual and large standard deviations of one place's values over the scans, where all of them have one."""
    measured = [run[np.isfinite(run[:, column])] for run in runs]
    if min(map(len, measured)) < 2:
        return "not measured in every scan"
    first, last = max(run[:, 0].min() for run in measured), min(run[:, 0].max() for run in measured)
    places = np.arange(first, last, 2.0)
    values = []
    for run in measured:
        run = run[np.argsort(run[:, 0])]
        values.append(np.interp(places, run[:, 0], run[:, column]))
    spread = np.std(values, axis=0, ddof=1)
    return f"median {np.median(spread):.4f} p95 {np.percentile(spread, 95):.4f} max {spread.max():.4f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seams", type=int, default=24)
    parser.add_argument("--scans", type=int, default=1)
    parser.add_argument("--draw", type=int, default=5)
    parser.add_argument("--angles", type=float, default=0.0, help="standard deviation of the chamfers' angles, degrees")
    parser.add_argument("--shift", type=int, default=0, help="give each skin the chamfers of another, so many on")
    parser.add_argument("--only", type=int, nargs="*")
    parser.add_argument("--edges", choices=("image", "points"), default="image")
    parser.add_argument("--rigs", type=int, nargs="*", choices=tuple(RIGS), help="coverage on these rigs, or on all")
    parser.add_argument("--without", choices=tuple(REFINEMENTS), nargs="*", default=[], help="switched off")
    parser.add_argument("--keep", type=Path, help="folder for reconstructed scans")
    chosen = parser.parse_args()
    settings = SeamSettings(edges=chosen.edges)
    for name in chosen.without:
        REFINEMENTS[name]()
    if chosen.rigs is not None:
        over_rigs(chosen, settings)
        return
    found, seconds = [], []
    for i in chosen.only or range(chosen.seams):
        spec = seam_spec(i, chosen.seams, chosen.draw, chosen.angles, chosen.shift)
        seam = spec.panel.seams[0]
        runs = []
        for run, cpu in scans(spec, chosen.scans, settings):
            runs.append(run)
            seconds.append(cpu)
        found += runs
        print(
            f"{i:2d} {22.5 * (i % 8):5.1f}° width {seam.width_mm[2]:.2f} step {seam.step_mm[2]:+.2f} "
            f"chamfer {seam.chamfer_mm:.2f}{' sealed' if seam.filled else ''}: {len(runs[0])} stations"
        )
        for name, column in (("step", 1), ("width", 3)):
            joined = np.concatenate(runs)
            print(f"   {name:5s} {summary(joined[:, column], joined[:, column + 1])}", flush=True)
            if chosen.scans > 1:
                print(f"         sd over {chosen.scans} scans: {scatter(runs, column)}", flush=True)
    joined = np.concatenate(found)
    print(f"all: {len(joined)} stations, {np.sum(seconds) / len(joined) * 1e3:.1f} ms of CPU each")
    print(f"   step  {summary(joined[:, 1], joined[:, 2])}\n   width {summary(joined[:, 3], joined[:, 4])}")


if __name__ == "__main__":
    main()

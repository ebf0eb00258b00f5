"""Rivets on simulated panels: recall, precision, errors of height, tilt and centre, and whether U95 covers them.

python benchmarks/study_rivets.py [--panels 12] [--first 0] [--scans 2] [--bare 5] [--repeats 10]
python benchmarks/study_rivets.py --rigs [1 2 …] [--creases] [--panels 12] [--first 0] [--scans 2] [--keep DIR]

Panels of varied size, curvature, pose, light, ring contrast (down to six grey levels) and clutter, each traced once and
scanned several times with fresh noise; panels with scratches, stickers and holes but no rivets; and one flat panel of
9 mm heads scanned often. A panel takes about half a minute.

With --rigs: what U95 covers on six rigs (resolution, baseline, blur; the panel turned by 0 to 90°), in small pictures.
Reconstructed scans are kept in DIR, for measuring them again. With --creases their skins are bent along three lines by
heads, and what is measured on heads that such a line crosses is counted by itself, too.
"""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rigs import RIGS

from metrology.cloud import Reconstruction
from metrology.reconstruct import reconstruct
from metrology.results import Rivet
from metrology.rivets import detect_rivets, measure_rivets
from metrology.surfaces import Frame
from simulator.panel import Panel
from simulator.panel import Rivet as PanelRivet
from simulator.random_panel import Variety, random_panel, random_placement
from simulator.scene import expose, fringe_light, make_rig, set_up
from simulator.spec import Camera, Placement, RigSpec, SimulationSpec, shipped_spec

VARIETY = Variety(
    rivets=(20, 28), diameters_mm=(4.8, 5.5, 6.4, 8.0, 9.5, 12.0), ring_levels=(6.0, 60.0), holes=2, partial_rings=0.1
)
BARE = replace(VARIETY, rivets=(0, 0), holes=6, stickers=6, scratches=(30, 60))
MATCH_PX = 6.0
DIAMETERS_MM = (4.8, 5.5, 6.4, 8.0, 9.5, 12.0)
LEAST_PX = 17.0  # across, of the heads that a rig is given: smaller ones leave too few points


def specification(seed: int, variety: Variety) -> SimulationSpec:
    """A random panel in a random pose and light before one of the shipped rigs."""
    rng = np.random.default_rng(seed)
    base = shipped_spec(("standard_part", "skin", "demo")[seed % 3])
    panel = random_panel(rng, variety)
    light = replace(base.light, brightness=float(rng.uniform(180, 330)))
    return replace(base, panel=panel, placements=(random_placement(rng, 8.0),), light=light, seed=seed)


def rig_specification(number: int, k: int) -> SimulationSpec:
    """The k-th panel before the rig of that number."""
    rng, kind = np.random.default_rng([31, number, k]), RIGS[number]
    base = shipped_spec("skin")
    width, height = 600 * kind.px_mm, 460 * kind.px_mm
    variety = replace(
        VARIETY, size_mm=(width, height), rivets=(10, 16), ring_levels=(12.0, 60.0), holes=0, scratches=(0, 10),
        diameters_mm=tuple(d for d in DIAMETERS_MM if LEAST_PX * kind.px_mm < d < 0.2 * height), stickers=0,
    )  # fmt: skip
    panel = random_panel(rng, variety, blur_px=kind.blur_px, pixel_mm=kind.px_mm)
    placement = random_placement(rng, 8.0, 3.0)
    turned = Placement(placement.offset_mm, (*placement.rotation_deg[:2], float(rng.uniform(0, 90))))
    return replace(
        base, panel=panel, placements=(turned,), rig=RigSpec(seed=number, design=kind.design(640, 512)), seed=k,
        camera=Camera(blur_px=kind.blur_px, samples=24),
        light=replace(base.light, brightness=float(rng.uniform(180, 330))),
    )  # fmt: skip


def nine_millimetre_heads() -> SimulationSpec:
    """The standard part's plate with sixteen proud and sunk 9 mm heads."""
    base = shipped_spec("standard_part")
    heights = np.linspace(-0.3, 1.0, 16)
    rivets = tuple(
        PanelRivet(f"R{k + 1:02d}", -96 + 64.0 * (k % 4), 66 - 44.0 * (k // 4), 9.0, float(h), 0.2, 37.0 * k)
        for k, h in enumerate(heights)
    )
    return replace(base, panel=Panel(280.0, 200.0, rivets=rivets, surface=base.panel.surface))


def scans(spec: SimulationSpec, count: int) -> Iterator[tuple[Reconstruction, list[dict[str, Any]]]]:
    """Noisy scans of a panel traced once, with its true rivets."""
    stage = set_up(spec, make_rig(spec), spec.placements[0])
    truth = stage.truth.as_dict()["rivets"]
    light = fringe_light(spec, stage, np.random.default_rng(spec.seed))
    for k in range(count):
        rng = np.random.default_rng([spec.seed, k])
        left, right = (expose(spec, light[side], rng) for side in ("left", "right"))
        yield reconstruct(left, right, stage.rig, spec.fringe, spec.camera.exposures), truth


def measured(cloud: Reconstruction) -> list[Rivet]:
    return measure_rivets(detect_rivets(cloud), cloud)


def distance_px(rivet: Rivet, truth: dict[str, Any]) -> float:
    return float(np.hypot(rivet.u_px - truth["uv_px"][0], rivet.v_px - truth["uv_px"][1]))


def pairs(rivets: list[Rivet], truth: list[dict[str, Any]]) -> list[tuple[Rivet, dict[str, Any]]]:
    """Measured rivets with the true ones they are."""
    found = []
    for t in truth:
        nearest = min(rivets, key=lambda r: distance_px(r, t), default=None)
        if nearest is not None and distance_px(nearest, t) < MATCH_PX:
            found.append((nearest, t))
    return found


def study_panels(first: int, panels: int, count: int) -> None:
    visible = seen = false = 0
    rows = []
    for seed in range(first, first + panels):
        for cloud, truth in scans(specification(seed, VARIETY), count):
            rivets = measured(cloud)
            matched = pairs(rivets, truth)
            visible += sum(t["visible"] for t in truth)
            seen += sum(t["visible"] for _, t in matched)
            false += len(rivets) - len({id(r) for r, _ in matched})
            for r, t in matched:
                if r.height_mean_mm is None or r.tilt_deg is None or not t["visible"]:
                    continue
                centre = np.linalg.norm(np.array([r.x_mm, r.y_mm, r.z_mm]) - t["xyz_mm"])
                rows.append(
                    [r.height_mean_mm - t["height_mean_mm"], r.height_u95_mm, r.tilt_deg - t["tilt_deg"],
                     r.tilt_u95_deg, centre, t["diameter_mm"]]
                )  # fmt: skip
        print(f"panel {seed}: {seen} of {visible} rivets so far, {false} false", flush=True)
    height, height_u95, tilt, tilt_u95, centre, diameter = np.array(rows, float).T
    print(f"recall {seen / visible:.4f}, precision {seen / (seen + false):.4f}, {len(rows)} measured")
    print(
        f"height: mean |e| {1e3 * np.abs(height).mean():.2f} µm, bias {1e3 * height.mean():+.2f} µm, "
        f"U95 covers {np.mean(np.abs(height) <= height_u95):.3f} (median U95 {1e3 * np.median(height_u95):.1f} µm)"
    )
    print(
        f"tilt: mean |e| {np.abs(tilt).mean():.3f}°, bias {tilt.mean():+.4f}°, "
        f"U95 covers {np.mean(np.abs(tilt) <= tilt_u95):.3f}"
    )
    print(f"centre: median {1e3 * np.median(centre):.1f} µm, 95 % {1e3 * np.quantile(centre, 0.95):.1f} µm")
    for d in np.unique(diameter):
        k = diameter == d
        print(
            f"  {d:4.1f} mm: {k.sum():3d} heads, mean |e| {1e3 * np.abs(height[k]).mean():.2f} µm, "
            f"covered {np.mean(np.abs(height[k]) <= height_u95[k]):.3f}; tilt {np.abs(tilt[k]).mean():.3f}°, "
            f"covered {np.mean(np.abs(tilt[k]) <= tilt_u95[k]):.3f}"
        )


def kept_scans(number: int, k: int, count: int, folder: Path | None) -> list[tuple[Reconstruction, Any]]:
    """Scans of one panel before a rig, traced or as kept."""
    path = folder / f"{number}-{k}-{count}.pickle" if folder else None
    if path and path.exists():
        return list(pickle.loads(path.read_bytes()))
    made = list(scans(rig_specification(number, k), count))
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(made))
    return made


def creased(cloud: Reconstruction, truth: Any, rng: np.random.Generator) -> tuple[Reconstruction, set[str]]:
    """The scan with its skin bent along three lines by heads, which stay as flush; heads that a line crosses."""
    centres = np.array([t["xyz_mm"] for t in truth])
    frame = Frame.on_plane(centres.mean(axis=0), np.linalg.svd(centres - centres.mean(axis=0))[2][2])
    turn = rng.uniform(0, np.pi)
    across = frame.local(cloud.points)[..., :2] @ (np.cos(turn), np.sin(turn))
    heads = frame.local(centres)[:, :2] @ (np.cos(turn), np.sin(turn))
    chosen = rng.choice(len(truth), min(3, len(truth)), replace=False)
    lines = [heads[k] + rng.uniform(-0.5, 0.5) * truth[k]["diameter_mm"] for k in chosen]
    bends = rng.uniform(0.001, 0.004, len(lines)) * rng.choice([-1, 1], len(lines))
    for k, t in enumerate(truth):
        away = np.linalg.norm(cloud.points - t["xyz_mm"], axis=-1)
        across[away < 0.5 * t["diameter_mm"] + 0.15] = heads[k]
    raised = sum(bend * np.abs(across - line) for bend, line in zip(bends, lines, strict=True))
    ray = cloud.points / np.linalg.norm(cloud.points, axis=-1, keepdims=True)
    points = cloud.points + ray * (raised / (ray @ frame.axes[2]))[..., None]
    crossed = {t["id"] for k, t in enumerate(truth) if min(abs(heads[k] - np.array(lines))) < 0.5 * t["diameter_mm"]}
    return replace(cloud, points=points.astype(np.float32)), crossed


def study_rigs(numbers: list[int], first: int, panels: int, count: int, folder: Path | None, bent: bool) -> None:
    """What U95 of height, tilt and diameter covers, by rig."""
    for number in numbers:
        rows, heads, on_line = [], 0, []
        for k in range(first, first + panels):
            for j, (cloud, truth) in enumerate(kept_scans(number, k, count, folder)):
                crossed: set[str] = set()
                detections = detect_rivets(cloud)
                if bent:
                    cloud, crossed = creased(cloud, truth, np.random.default_rng([number, j, k]))
                for r, t in pairs(measure_rivets(detections, cloud), truth):
                    if r.height_mean_mm is not None and r.tilt_deg is not None and t["visible"]:
                        rows.append([r.height_mean_mm - t["height_mean_mm"], r.height_u95_mm,
                                     r.tilt_deg - t["tilt_deg"], r.tilt_u95_deg])  # fmt: skip
                        on_line.append(t["id"] in crossed)
            heads += sum(t["visible"] for t in truth)
        height, height_u95, tilt, tilt_u95 = np.array(rows, float).reshape(-1, 4).T
        within = np.abs(height) <= height_u95
        text = (
            f"rig {number} ({RIGS[number].px_mm} mm): {heads} heads, {len(rows)} measured; height: mean |e| "
            f"{1e3 * np.abs(height).mean():.2f} µm, bias {1e3 * height.mean():+.2f}, median U95 "
            f"{1e3 * np.median(height_u95):.1f}, covers {within.mean():.3f}; "
        )
        # A crease turns the skin beside it against heads, of which no truth tells.
        of_tilt = f"tilt: mean |e| {np.abs(tilt).mean():.3f}°, covers {np.mean(np.abs(tilt) <= tilt_u95):.3f}"
        print(text + (f"of {sum(on_line)} crossed {within[on_line].mean():.3f}" if bent else of_tilt), flush=True)


def study_bare(panels: int) -> None:
    found = 0
    for seed in range(panels):
        for cloud, _ in scans(specification(500 + seed, BARE), 1):
            found += len(detect_rivets(cloud))
    print(f"{panels} panels without rivets: {found} found")


def study_repeatability(count: int) -> None:
    heights: dict[str, list[float]] = {}
    errors: dict[str, list[float]] = {}
    for cloud, truth in scans(nine_millimetre_heads(), count):
        for r, t in pairs(measured(cloud), truth):
            if r.height_mean_mm is not None:
                heights.setdefault(t["id"], []).append(r.height_mean_mm)
                errors.setdefault(t["id"], []).append(r.height_mean_mm - t["height_mean_mm"])
    scatter = [np.std(h, ddof=1) for h in heights.values()]
    print(
        f"{count} scans of {len(heights)} heads of 9 mm: standard deviation {1e3 * rms(scatter):.2f} µm, "
        f"errors of the means {1e3 * rms([np.mean(e) for e in errors.values()]):.2f} µm"
    )


def rms(values: list[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--panels", type=int, default=12)
    parser.add_argument("--first", type=int, default=0, help="seed of the first panel")
    parser.add_argument("--scans", type=int, default=2)
    parser.add_argument("--bare", type=int, default=5)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--rigs", type=int, nargs="*", choices=tuple(RIGS), help="coverage on these rigs, or on all")
    parser.add_argument("--creases", action="store_true", help="with --rigs: the skin is bent by heads")
    parser.add_argument("--keep", type=Path, help="folder for reconstructed scans")
    arguments = parser.parse_args()
    if arguments.rigs is not None:
        study_rigs(arguments.rigs or list(RIGS), arguments.first, arguments.panels, arguments.scans, arguments.keep,
                   arguments.creases)  # fmt: skip
        return
    if arguments.repeats > 1:
        study_repeatability(arguments.repeats)
    if arguments.bare:
        study_bare(arguments.bare)
    if arguments.panels:
        study_panels(arguments.first, arguments.panels, arguments.scans)


if __name__ == "__main__":
    main()

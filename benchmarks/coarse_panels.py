"""Panels for `study_halls.py` before coarser cameras, 0.28 mm a pixel.

A lap joint, or a butt joint along the epipolar lines with two dents beside it. Rows of heads, no lettering; frames at
rest, in even light.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simulator.defects import Dent
from simulator.panel import Rivet, Seam
from simulator.random_panel import Variety, random_placement, random_skin, random_surface, ring_reflectance
from simulator.rig import RigDesign
from simulator.spec import SimulationSpec, shipped_spec

SIZE_MM = (310.0, 208.0)
DIAMETERS_MM = (4.8, 6.4, 8.0)
DESIGN = RigDesign(camera_width=1137, camera_height=864, camera_focal_px=2545.0, stand_off_mm=700.0)
VARIETY = Variety(size_mm=SIZE_MM, radius_mm=(600.0, 2500.0), concave=True, scratches=(0, 8), stickers=0, smudges=0)


def _specification(
    kind: str, k: int, rng: np.random.Generator, joint: Seam, rivets: list[Rivet], dents: tuple[Dent, ...]
) -> SimulationSpec:
    base = shipped_spec("skin")
    panel = replace(
        base.panel, width_mm=SIZE_MM[0], height_mm=SIZE_MM[1], skin=random_skin(rng, VARIETY),
        surface=random_surface(rng, VARIETY), rivets=tuple(rivets), holes=(), seams=(joint,), dents=dents,
    )  # fmt: skip
    return replace(
        base,
        scene=replace(base.scene, panel=f"{kind}-{k}"),
        rig=replace(base.rig, seed=40 + k, design=DESIGN),
        camera=replace(base.camera, samples=48, blur_px=float(rng.uniform(0.6, 0.85))),
        light=replace(base.light, brightness=186.0 / panel.surface.reflectance / (1 + 1.6 * panel.surface.specular)),
        panel=panel,
        placements=(random_placement(rng),),
        repeats=1,
        seed=700 + k,
    )


def _head(rng: np.random.Generator, number: int, x: float, y: float) -> Rivet:
    ring, level = float(rng.uniform(0.1, 0.2)), float(np.exp(rng.uniform(*np.log((6.0, 30.0)))))
    return Rivet(
        f"R{number:02d}", x, y, float(rng.choice(DIAMETERS_MM)), float(rng.uniform(-0.1, 0.12)),
        float(rng.uniform(0, 0.5)), float(rng.uniform(0, 360)), 0.0, ring, 0.3,
        ring_reflectance(level, ring, 100.0, 0.75, 0.227),
    )  # fmt: skip


def lap(k: int) -> SimulationSpec:
    """A lap joint down the middle, four rows of four heads."""
    rng = np.random.default_rng([29, k])
    step = float(rng.choice([-1, 1]) * rng.uniform(0.6, 1.6))
    broken, radius = ((0.1, 0.0), (0.2, 0.0), (0.0, 0.2), (0.0, 0.0))[int(rng.integers(4))]
    joint = Seam(
        "J01", tuple((-8.0 + 2.0 * float(rng.uniform(-1, 1)), y) for y in (-106.0, -50.0, 0.0, 50.0, 106.0)), (0.0,),
        tuple(step + float(s) for s in rng.uniform(-0.05, 0.05, 5)), chamfer_mm=broken, edge_radius_mm=radius,
        edge_reflectance=float(rng.uniform(0.6, 1.0)), joint="lap",
    )  # fmt: skip
    places = [(x, y) for y in (75.0, 25.0, -25.0, -75.0) for x in (-118.0, -48.0, 42.0, 118.0)]
    rivets = [
        _head(rng, number + 1, x + float(rng.uniform(-2, 2)), y + float(rng.uniform(-2, 2)))
        for number, (x, y) in enumerate(places)
    ]
    return _specification("lap", k, rng, joint, rivets, ())


def along(k: int) -> SimulationSpec:
    """A butt joint across the picture, along the epipolar lines; two rows of heads on either side, two dents."""
    rng = np.random.default_rng([31, k])
    width, step = float(rng.uniform(0.6, 2.6)), float(rng.uniform(-0.3, 0.3))
    joint = Seam(
        "J01", tuple((x, 2.0 * float(rng.uniform(-1, 1))) for x in (-158.0, -80.0, 0.0, 80.0, 158.0)),
        tuple(width * (1 + float(w)) for w in rng.uniform(-0.05, 0.05, 5)),
        tuple(step + float(s) for s in rng.uniform(-0.08, 0.08, 5)), chamfer_mm=float(rng.choice([0.2, 0.3, 0.45])),
        depth_mm=float(rng.uniform(1.5, 4.0)), floor_reflectance=float(rng.uniform(0.15, 0.5)),
        edge_reflectance=float(rng.uniform(0.6, 1.0)),
    )  # fmt: skip
    places = [(x, y) for y in (22.0, -22.0) for x in (-125.0, -75.0, -25.0, 25.0, 75.0, 125.0)]
    rivets = [
        _head(rng, number + 1, x + float(rng.uniform(-2, 2)), y + float(rng.uniform(-2, 2)))
        for number, (x, y) in enumerate(places)
    ]
    dents = tuple(
        Dent(f"D{n + 1}", float(rng.uniform(-100, 100)), side * 60.0, float(np.exp(rng.uniform(*np.log((0.06, 0.4))))),
             (float(rng.uniform(20, 32)), float(rng.uniform(12, 20))), float(rng.uniform(0, 180)), "smooth")
        for n, side in enumerate((-1, 1))
    )  # fmt: skip
    return _specification("along", k, rng, joint, rivets, dents)

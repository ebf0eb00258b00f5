"""Panels of letters, stripes and tape with two to five heads and no seam: what of it becomes a rivet or a seam.

python benchmarks/study_lettering.py --keep FOLDER [--first 900] [--panels 24]

Seven lines across 200 × 150 mm each: five of letters, one or two of them stripes or tape, dark or bright, up to 0.12 mm
thick, at 0.16 to 0.33 mm a pixel. Letters often cover heads, so that recall is no measure of anything but itself.
Pictures stay in FOLDER; a panel takes some ten seconds to render.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from study_clutter import kept_or_rendered, on

from metrology.fastening import detect_fasteners
from metrology.reconstruct import reconstruct
from metrology.seams import detect_seams
from simulator.clutter import Patch
from simulator.marks import Stencil
from simulator.random_panel import Variety, random_panel, random_placement
from simulator.scene import make_rig
from simulator.spec import SimulationSpec, shipped_spec

WORDS = (
    "NO STEP NO STEP NO STEP",
    "RH-F11 STA 872 DO NOT DRILL",
    "IIIIIIIIIIIIIIIIIIIIIIII",
    "P/N 4012-7 REV B HHHHHHHHHH",
    "LIFT HERE CUT HERE FUEL 08",
    "================",
    "------ ------ ------ -----",
    "MMMMMMMMMMMMMM",
)
VARIETY = Variety(
    size_mm=(200.0, 150.0), rivets=(2, 5), reflectance=(0.3, 0.7), scratches=(0, 10), stickers=0, smudges=1
)


def specification(k: int) -> SimulationSpec:
    """The k-th panel."""
    rng, base = np.random.default_rng([97, k]), shipped_spec("skin")
    placement = random_placement(rng)
    panel = random_panel(rng, VARIETY)
    stencils, patches = _lines(rng)
    surface = replace(panel.surface, stencils=stencils, patches=patches)
    scale = float(rng.uniform(0.7, 1.3)) if k % 3 else 0.6
    brightness = 170 / panel.surface.reflectance * float(rng.uniform(0.6, 1.1))
    design = replace(
        base.rig.design,
        camera_width=int(1000 * scale),
        camera_height=int(760 * scale),
        camera_focal_px=base.rig.design.camera_focal_px * scale,
    )
    return replace(
        base,
        rig=replace(base.rig, seed=70 + k, design=design),
        camera=replace(base.camera, samples=12),
        light=replace(base.light, brightness=brightness),
        panel=replace(panel, surface=surface),
        placements=(placement,),
        repeats=1,
        seed=int(rng.integers(1e6)),
    )


def _lines(rng: np.random.Generator) -> tuple[tuple[Stencil, ...], tuple[Patch, ...]]:
    """Lines side by side, all about in one direction."""
    stencils, patches = [], []
    angle = float(rng.choice([0.0, 90.0, rng.uniform(0, 90)]))
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    for i in range(7):
        off = (i - 3) * 18.0 + rng.uniform(-3, 3)
        x, y = float(-s * off), float(c * off)
        if i in (2, 5):
            size = (170.0 if angle < 45 else 140.0, float(rng.uniform(0.6, 9)))
            turn, contrast = angle + float(rng.normal(0, 1)), float(rng.choice([-0.8, -0.5, 0.6]))
            patches.append(Patch("rectangle", x, y, size, turn, contrast, 1.0, float(rng.choice([0.01, 0.05, 0.12]))))
            continue
        cap, text = float(rng.uniform(3, 9)), str(rng.choice(WORDS))
        text = (text * 2)[: max(4, int(150 / cap / 0.75))]
        turn, contrast = angle + float(rng.normal(0, 1)), float(rng.choice([-0.9, -0.8, -0.6, 0.8]))
        thickness, bold = float(rng.choice([0.02, 0.05, 0.1])), bool(rng.uniform() < 0.7)
        stencils.append(Stencil(text, x, y, cap, turn, contrast, thickness, bold))
    return tuple(stencils), tuple(patches)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", type=Path, required=True, help="folder of the rendered panels")
    parser.add_argument("--first", type=int, default=900, help="number of the first panel")
    parser.add_argument("--panels", type=int, default=24)
    arguments = parser.parse_args()
    arguments.keep.mkdir(parents=True, exist_ok=True)
    heads = found = false_rivets = false_seams = 0
    for k in range(arguments.first, arguments.first + arguments.panels):
        kept = kept_or_rendered(specification(k), arguments.keep / f"{k}.pkl")
        left, right = kept.frames["left"], kept.frames["right"]
        cloud = reconstruct(left, right, make_rig(kept.spec), kept.spec.fringe, kept.spec.camera.exposures)
        rivets = detect_fasteners(cloud).rivets
        sure = [d for d in rivets if d.doubt is None]
        seams = [line for line in detect_seams(cloud, rivets) if line.relief]
        false = [d for d in sure if not any(on(d, true) for true in kept.truth.rivets)]
        visible = [true for true in kept.truth.rivets if true.visible]
        heads, found = heads + len(visible), found + sum(any(on(d, true) for d in sure) for true in visible)
        false_rivets, false_seams = false_rivets + len(false), false_seams + len(seams)
        places = [f"{d.u_px:.0f}, {d.v_px:.0f}" for d in false] + [str(np.round(s.centre_px[[0, -1]])) for s in seams]
        print(f"panel {k}: {len(false)} false rivets, {len(seams)} false seams {places}", flush=True)
    print(f"{found} of {heads} heads found, {false_rivets} false rivets, {false_seams} false seams")


if __name__ == "__main__":
    main()

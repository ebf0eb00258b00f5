"""What lies on a skin or fills its holes, rendered: chips, drops, a sticker, sealant, and a bump."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrology.defects.measure import measure_defects
from metrology.defects.row import Defect
from metrology.fastening import detect_fasteners
from metrology.holes.measure import measure_sighted
from metrology.kinds import DEFECT, HOLE
from metrology.limits import Limit, PanelSpec
from metrology.reconstruct import reconstruct
from metrology.registration.known import with_known_names
from metrology.results import Hole
from metrology.sighted import Sighted
from metrology.tolerance import as_measured, judge
from simulator.clutter import Patch, Speck
from simulator.defects import Dent
from simulator.panel import Hole as PanelHole
from simulator.panel import Panel, Rivet, Surface
from simulator.scene import Stage, expose, fringe_light, make_rig, set_up
from simulator.spec import Camera, RigSpec, SimulationSpec, shipped_spec

DEEP = {(-24.0, -14.0): 0.1, (0.0, -14.0): 0.35}
"""x, y: how far the sealant in two holes of 6 mm lies below the skin."""
SIZE = 6.0
DROP, CHIP = Speck(-26.0, 3.0, 4.0, 0.02, crown_mm=0.4, reflectance=0.7), Speck(-10.0, 4.0, 4.0, 0.3, 4.0)
LIKE_SKIN = Speck(28.0, 12.0, 3.4, 0.02, crown_mm=0.34, reflectance=1.0), Speck(-32.0, 26.0, 1.9, 0.2, reflectance=1.0)
STICKER = Patch("disc", 8.0, 4.0, (9.0, 9.0), contrast=-0.5, thickness_mm=0.08)


@pytest.fixture(scope="module")
def rendered() -> tuple[Stage, Sighted]:
    base = shipped_spec("skin")
    design = replace(base.rig.design, camera_width=420, camera_height=330)
    panel = Panel(
        80.0, 62.0,
        rivets=tuple(Rivet(f"R{k}", 24.0 * k - 24.0, 20.0, SIZE, 0.05 * k) for k in range(3)),
        holes=tuple(PanelHole(x, y, SIZE, deep, 0.7, filled=True) for (x, y), deep in DEEP.items()),
        dents=(Dent("D1", 24.0, -14.0, -0.25, (9.0, 8.0)),),
        specks=(DROP, CHIP, *LIKE_SKIN),
        surface=Surface(reflectance=0.5, patches=(STICKER,)),
    )  # fmt: skip
    spec: SimulationSpec = replace(
        base, panel=panel, rig=RigSpec(seed=3, design=design), camera=Camera(samples=16), seed=8
    )
    stage = set_up(spec, make_rig(spec), spec.placements[0])
    rng = np.random.default_rng(5)
    light = fringe_light(spec, stage, rng)
    left, right = (expose(spec, light[side], rng) for side in ("left", "right"))
    cloud = reconstruct(left, right, stage.rig, spec.fringe, spec.camera.exposures)
    fasteners = detect_fasteners(cloud)
    return stage, Sighted(cloud, fasteners.rivets, [], {}, fasteners.openings)


def place(stage: Stage, row: Defect | Hole) -> tuple[float, float]:
    at = stage.pose.to_panel(np.array([row.x_mm, row.y_mm, row.z_mm], float))
    return float(at[0]), float(at[1])


def test_filled_holes_are_holes_and_no_dents(rendered: tuple[Stage, Sighted]) -> None:
    stage, sighted = rendered
    assert len(sighted.detections) == 3
    holes = measure_sighted(sighted, None)
    assert [hole.kind for hole in holes] == ["filled hole"] * 2
    for hole in holes:
        x, y = place(stage, hole)
        (deep,) = [d for (px, py), d in DEEP.items() if np.hypot(x - px, y - py) < 0.3]
        assert hole.depth_mm == pytest.approx(deep, abs=0.03)
        assert abs((hole.diameter_mm or 0.0) - SIZE) < (hole.diameter_u95_mm or 0.0) < 0.3
    said = [hole.reason for hole in judge(HOLE, holes, PanelSpec("P", "A"))]
    assert said == [f"filled hole of {h.diameter_mm:.1f} mm: what belongs there is to be decided" for h in holes]


def test_what_lies_on_the_skin_is_a_deposit_and_a_bump_is_none(rendered: tuple[Stage, Sighted]) -> None:
    stage, sighted = rendered
    found = measure_defects(sighted)
    kinds = {tuple(np.round(place(stage, row)).astype(int).tolist()): row.kind for row in found}
    assert [kind for (x, y), kind in kinds.items() if np.hypot(x - 24, y + 14) < 3] == ["bump"]
    for at in ((-26, 3), (-10, 4), (8, 4), (28, 12), (-32, 26)):
        assert {kind for place, kind in kinds.items() if np.hypot(*np.subtract(place, at)) < 5} == {"deposit"}
    assert len(found) == 6


def test_a_deposit_is_to_be_removed_whatever_limits_say(rendered: tuple[Stage, Sighted]) -> None:
    found = [row for row in measure_defects(rendered[1]) if row.kind == "deposit"]
    strict = PanelSpec("P", "A", {"default": {"defect_depth_mm": Limit(lower=-0.01, upper=0.01)}})
    for row in judge(DEFECT, found, strict):
        assert row.decision == "conditional fail"
        assert "something lies on the skin: remove it and scan again" in (row.reason or "")
        assert "outside" not in (row.reason or "")
        assert judge(DEFECT, [as_measured(DEFECT, row)], strict) == [row]


def test_a_deposit_that_was_a_bump_in_an_older_run_keeps_its_name(rendered: tuple[Stage, Sighted]) -> None:
    row = next(row for row in measure_defects(rendered[1]) if row.kind == "deposit").changed(
        x_panel_mm=1.0, y_panel_mm=2.0, z_panel_mm=0.0
    )
    (named,) = with_known_names([row], [replace(row, kind="bump", defect_id="D07")])
    assert named.defect_id == "D07"

"""What a hall adds to a panel: dents, holes, lap joints, recesses, letters, beads; each against its own truth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from metrology.errors import SpecError
from simulator.clutter import Bead, Cleco, Patch, Speck
from simulator.defects import Dent, Gouge, Hail
from simulator.marks import Stencil, Stroke
from simulator.pack import pack
from simulator.pack_defects import no_dents
from simulator.paint import coat, paint
from simulator.panel import Hole, Panel, Rivet, Seam, Skin, Slot, Surface
from simulator.projection import Beamer, _spread, project_stripes, receive_stripes
from simulator.random_clutter import Clutter
from simulator.random_panel import random_panel
from simulator.relief import BEAD, CONE, HEAD, HOLE, SLOT
from simulator.rig import aim_frame, virtual_rig
from simulator.scene import fringe_light, make_rig
from simulator.spec import Disturbances
from simulator.survey import survey
from simulator.truth import Pose, truth
from simulator.vibration import sway_of
from tests.support.whole_panel import meet, surface_heights

PLAIN = Surface(brushing=0.0, blotches=0.0)
CURVED = Skin(420.0, 900.0, 20.0)
EYE = np.array([-140.0, 20.0, 690.0])


def grid(x0: float, x1: float, y0: float, y1: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.arange(x0, x1, step), np.arange(y0, y1, step))
    return x.ravel(), y.ravel()


def true_of(panel: Panel):
    rig = virtual_rig(np.random.default_rng(3))
    return truth(panel, pack(panel), rig, Pose(*aim_frame(rig)))


def below(panel: Panel, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """How far the skin lies below itself without dents, along z."""
    relief = pack(panel)
    return surface_heights(relief._replace(dents=no_dents()), x, y)[0] - surface_heights(relief, x, y)[0]


@pytest.mark.parametrize(
    "dent",
    [
        Dent("D", 90.0, -40.0, 0.5, (22.0, 16.0), 30.0),
        Dent("D", 90.0, -40.0, 0.8, (14.0, 12.0), 70.0, "sharp", 1.5),
        Dent("D", 90.0, -40.0, 0.4, (26.0, 8.0), -25.0, "crease", 1.0),
        Dent("D", 90.0, -40.0, -0.3, (16.0, 16.0)),
    ],
    ids=["smooth", "sharp", "crease", "bump"],
)
def test_a_dent_has_the_depth_outline_volume_and_radius_that_its_truth_states(dent):
    panel = Panel(skin=CURVED, dents=(dent,))
    told = true_of(panel).dents[0]
    step = 0.05
    x, y = grid(40, 140, -90, 10, step)
    _, normal = survey(pack(replace(panel, dents=())), dent.x_mm, dent.y_mm)
    along = below(panel, x, y) * normal[2]
    share, texel = along / dent.depth_mm, step * step / normal[2]
    assert share.max() == pytest.approx(1.0, abs=1e-4)
    assert told.area_mm2 == pytest.approx((share > 0.5).sum() * texel, rel=2e-3)
    assert told.volume_mm3 == pytest.approx(along.sum() * texel, rel=1e-3)
    assert told.foot_area_mm2 >= (share > 1e-6).sum() * texel * 0.999
    assert told.kind == ("bump" if dent.depth_mm < 0 else "crease" if dent.shape == "crease" else "dent")
    # Full length and width at half depth, in the tangent plane.
    e1 = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    e1 /= np.linalg.norm(e1)
    e2, angle = np.cross(normal, e1), math.radians(dent.angle_deg)
    inside = share > 0.5
    d = np.stack([x - dent.x_mm, y - dent.y_mm], axis=1)[inside]
    d = np.column_stack([d, -(d @ normal[:2]) / normal[2]])
    for unit, length in zip(
        (math.cos(angle) * e1 + math.sin(angle) * e2, math.cos(angle) * e2 - math.sin(angle) * e1),
        told.half_depth_axes_mm,
        strict=True,
    ):
        assert np.ptp(d @ unit) == pytest.approx(length, abs=0.15)
    # Curvature across the width, at the bottom.
    h = 0.004
    across = (math.cos(angle) * e2 - math.sin(angle) * e1)[:2] * h
    places = np.array([[dent.x_mm, dent.y_mm]]) + np.array([[-1.0], [0.0], [1.0]]) * across
    z = below(panel, places[:, 0].copy(), places[:, 1].copy()) * normal[2]
    assert h * h / abs(z[0] - 2 * z[1] + z[2]) == pytest.approx(told.least_radius_mm, rel=0.02)


def test_a_dents_place_is_its_deepest_point_along_the_normal():
    dent = Dent("D", 90.0, -40.0, 0.5, (22.0, 16.0))
    panel = Panel(skin=CURVED, dents=(dent,))
    rig = virtual_rig(np.random.default_rng(3))
    pose = Pose(*aim_frame(rig))
    told = truth(panel, pack(panel), rig, pose).dents[0]
    point, normal = survey(pack(replace(panel, dents=())), 90.0, -40.0)
    np.testing.assert_allclose(pose.to_panel(np.array(told.xyz_mm)), point - 0.5 * normal, atol=1e-9)
    assert told.visible
    assert not true_of(replace(panel, width_mm=600.0, dents=(replace(dent, x_mm=200.0),))).dents[0].visible


def test_a_gouge_has_its_profile_its_lips_and_its_volume():
    gouge = Gouge("G", (-10.0, 0.0), (10.0, 0.0), 0.8, 0.1, 0.04)
    panel = Panel(gouges=(gouge,))
    told = true_of(panel).dents[0]
    y = np.linspace(-1.7, 1.7, 3401)
    drop = below(panel, np.zeros_like(y), y)
    assert drop.max() == pytest.approx(0.1)
    assert np.ptp(y[drop > 0.05]) == pytest.approx(0.8, abs=0.005)
    assert drop.min() == pytest.approx(-0.04, abs=1e-5)
    x = np.linspace(-12, 12, 4801)
    assert np.ptp(x[below(panel, x, np.zeros_like(x)) > 0.05]) == pytest.approx(20.0, abs=0.02)
    gx, gy = grid(-12, 12, -1, 1, 0.02)
    cut = np.maximum(below(panel, gx, gy), 0.0)
    assert told.volume_mm3 == pytest.approx(cut.sum() * 0.02**2, rel=5e-3)
    assert told.area_mm2 == pytest.approx((cut > 0.05).sum() * 0.02**2, rel=2e-2)
    assert (told.kind, told.lip_mm) == ("scratch", 0.04)


def test_hail_is_as_many_dents_apart_and_a_steep_dent_is_refused():
    panel = Panel(hail=(Hail(4, 12), Hail(5, 3, centre_mm=(0.0, 60.0), size_mm=(200.0, 1.0))))
    told = true_of(panel).dents
    assert len({dent.id for dent in told}) == len(told) == 15
    first = panel.hail[0].dents()
    gaps = [
        math.hypot(a.x_mm - b.x_mm, a.y_mm - b.y_mm) - a.axes_mm[0] - b.axes_mm[0]
        for k, a in enumerate(first)
        for b in first[:k]
    ]
    assert min(gaps) > 0
    with pytest.raises(SpecError, match="slopes of at most 1"):
        Dent("D", 0.0, 0.0, 3.0, (4.0, 4.0))


def everything() -> Panel:
    return Panel(
        skin=CURVED,
        rivets=(
            Rivet("R1", -100.0, 60.0, 9.5, 0.05, slot=Slot(6.0, 1.2, 0.6, 20.0, shape="cross")),
            Rivet("R2", -75.0, 60.0, 9.5, -0.05, slot=Slot(6.0, 1.0, 0.6, 20.0, shape="torq-set")),
            Rivet("R3", -50.0, 60.0, 9.5, 0.05, slot=Slot(4.0, 4.0, 1.5, 20.0, shape="hex")),
            Rivet("R4", 60.0, -60.0, 6.4),
        ),
        seams=(Seam("L", ((0.0, -110.0), (0.0, 110.0)), (0.0,), (1.0,), joint="lap", edge_radius_mm=0.2),),
        holes=(Hole(-75.0, 30.0, 6.0, 3.0, 0.0, "H1", 10.0), Hole(-50.0, 30.0, 5.0, 2.0, 0.0)),
        dents=(Dent("D", 40.0, 40.0, 0.4, (30.0, 20.0), 30.0),),
        gouges=(Gouge("G", (-120.0, -20.0), (-80.0, -10.0), 0.4, 0.1, 0.05),),
        clecos=(Cleco(110.0, 60.0),),
        specks=(Speck(20.0, -60.0, 2.0, 0.2, 8.0, 20.0), Speck(30.0, -60.0, 4.0, 0.05, crown_mm=0.6)),
        beads=(Bead(((50.0, -60.0), (85.0, -60.5)), 8.0, 0.5),),
        surface=replace(PLAIN, stencils=(Stencil("LIFT", -70.0, 0.0, 7.0, thickness_mm=0.03),)),
    )


def test_rays_meet_all_of_it_on_its_surface_with_nothing_in_front(rng):
    relief = pack(everything())
    centres = [(-100, 60), (-75, 60), (-50, 60), (-75, 30), (-50, 30), (40, 40), (-100, -15), (110, 60), (20, -60),
               (60, -60), (0, 0), (-70, 0)]  # fmt: skip
    at = np.array(centres)[rng.integers(0, len(centres), 3000)] + rng.uniform(-7, 7, (3000, 2))
    target = np.column_stack([at, surface_heights(relief, at[:, 0].copy(), at[:, 1].copy())[0]])
    directions = (target - EYE) / np.linalg.norm(target - EYE, axis=1, keepdims=True)
    points, kinds = meet(relief, EYE, directions)
    floor = kinds >= 0
    z, _ = surface_heights(relief, points[floor, 0].copy(), points[floor, 1].copy())
    assert np.abs(points[floor, 2] - z).max() < 1e-7
    assert {HEAD, SLOT, HOLE, CONE, BEAD} <= set(kinds.tolist())
    share = np.linspace(0, 1, 400)[1:-1, None, None]
    before = (points - 40 * directions) + share * (40 - 1e-5) * directions
    flat = before.reshape(-1, 3)
    clear = flat[:, 2] - surface_heights(relief, flat[:, 0].copy(), flat[:, 1].copy())[0]
    assert clear.reshape(share.size, -1).min() > -1e-4


def test_truth_names_every_kind_as_the_reference_scans_do():
    told = true_of(everything()).as_dict()
    kinds = {rivet["id"]: rivet["kind"] for rivet in told["rivets"]}
    assert kinds == {"R1": "recessed", "R2": "recessed", "R3": "recessed", "R4": "head", "H1": "hole", "H02": "hole",
                     "C01": "cleco"}  # fmt: skip
    shown = {rivet["id"]: rivet["visible"] for rivet in told["rivets"]}
    assert shown["H1"]
    assert not shown["R4"], "under the bead"
    (lap,) = told["seams"]
    assert (lap["kind"], lap["edge_radius_mm"], set(lap["width_mm"])) == ("lap", 0.2, {0.0})
    np.testing.assert_allclose(np.abs(lap["step_mm"]), 1.0, atol=0.02)  # its part along the normal
    assert np.mean(lap["visible"]) > 0.8
    hole = next(rivet for rivet in told["rivets"] if rivet["id"] == "H1")
    assert hole["height_mean_mm"] == -3.0
    assert hole["countersink_depth_mm"] == pytest.approx(2.0 / math.tan(math.radians(50)))


def test_a_countersink_is_a_cone_of_its_angle_down_to_the_bore():
    relief = pack(Panel(holes=(Hole(10.0, 5.0, 6.0, 4.0, countersink_mm=10.0, countersink_deg=100.0),)))
    x = np.array([15.1, 14.999, 13.001, 12.9])
    z, kinds = surface_heights(relief, x, np.full(4, 5.0))
    np.testing.assert_allclose(z, [0.0, 0.0, -2.0 / math.tan(math.radians(50)), -4.0], atol=2e-3)
    assert kinds.tolist()[1:] == [CONE, CONE, HOLE]


def test_a_lap_is_a_step_with_one_rounded_edge_and_no_gap():
    relief = pack(
        Panel(seams=(Seam("L", ((0.0, -110.0), (0.0, 110.0)), (0.0,), (1.0,), joint="lap", edge_radius_mm=0.2),))
    )
    z, _ = surface_heights(relief, np.array([-5.0, -0.2, -0.1, -1e-9, 1e-9, 0.1]), np.zeros(6))
    high = 0.5 - (0.2 - math.sqrt(0.2**2 - 0.1**2))
    np.testing.assert_allclose(z, [0.5, 0.5, high, 0.3, -0.5, -0.5], atol=1e-4)
    with pytest.raises(SpecError, match="0 in a lap joint"):
        Seam("L", ((0.0, -110.0), (0.0, 110.0)), (0.5,), joint="lap")


def test_a_bead_leads_from_one_plate_to_the_other():
    lap = Seam("L", ((0.0, -110.0), (0.0, 110.0)), (0.0,), (1.0,), joint="lap")
    relief = pack(Panel(seams=(lap,), beads=(Bead(lap.points_mm, 6.0, 0.4),)))
    z, kinds = surface_heights(relief, np.array([-3.001, -2.999, 0.0, 2.999, 3.001]), np.zeros(5))
    np.testing.assert_allclose(z, [0.5, 0.5, 0.4, -0.5, -0.5], atol=2e-3)
    assert (kinds == BEAD).tolist() == [False, True, True, True, False]


@pytest.mark.parametrize(
    ("slot", "area"),
    [
        (Slot(6.0, 1.0, shape="cross"), 2 * 6.0 - 1.0),
        (Slot(6.0, 1.0, shape="torq-set"), 4 * 3.0 * 1.0),
        (Slot(4.0, 4.0, shape="hex"), 4.0**2 * math.sqrt(3) / 2),
    ],
    ids=["cross", "torq-set", "hex"],
)
def test_recesses_have_their_shapes_area(slot, area):
    relief = pack(Panel(rivets=(Rivet("R", 0.0, 0.0, 9.0, slot=replace(slot, angle_deg=17.0)),)))
    _, kinds = surface_heights(relief, *grid(-4, 4, -4, 4, 0.02))
    assert (kinds == SLOT).sum() * 0.02**2 == pytest.approx(area, rel=0.01)


def test_letters_are_paint_of_another_reflectance_and_of_slight_thickness(rng):
    text = Stencil("LIFT HERE", 10.0, -5.0, 8.0, 20.0, -0.8, 0.03)
    panel = Panel(surface=replace(PLAIN, stencils=(text,), reflectance=0.5))
    values, height = paint(panel, rng).values, coat(panel)
    assert values.min() == pytest.approx(0.1, abs=0.005)
    np.testing.assert_allclose(1 - values / 0.5, 0.8 * height / 0.03, atol=1e-5)
    rows, columns = np.nonzero(height > 0.015)
    x, y = -150.1 + 0.1 * columns, -102.6 + 0.1 * rows
    c, s = math.cos(math.radians(20)), math.sin(math.radians(20))
    across = -s * (x - 10) + c * (y + 5)
    assert np.ptp(across) == pytest.approx(8.0, abs=0.3)
    assert abs(across.max() + across.min()) < 0.3
    # The F and the first L have their upright on the left: read along the line the letters are not mirrored.
    along = c * (x - 10) + s * (y + 5)
    first = along < along.min() + 1.0
    assert np.ptp(across[first]) > 7.5
    assert coat(Panel()).size == 0


def test_a_painted_ring_and_a_grease_pencil_cover_what_they_say(rng):
    ring = Patch("ring", 0.0, 0.0, (16.0, 16.0), contrast=-0.6, line_mm=1.5)
    values = paint(Panel(surface=replace(PLAIN, patches=(ring,))), rng).values
    assert (1 - values / 0.5).sum() * 0.01 / 0.6 == pytest.approx(math.pi * (8.0**2 - 6.5**2), rel=0.02)
    stroke = Stroke(((-20.0, 0.0), (20.0, 0.0)), 2.0, -0.6, 0.5)
    covered = 1 - paint(Panel(surface=replace(PLAIN, strokes=(stroke,))), rng).values / 0.5
    assert 0.3 < covered.sum() * 0.01 / (0.6 * 40 * 2.0) < 0.7


def test_only_motion_along_the_normal_moves_the_pattern_and_unlike_in_both_cameras(spec):
    rig = make_rig(spec)
    pose = Pose(*aim_frame(rig))
    left, right = (sway_of(rig, side, pose, "x") for side in ("left", "right"))
    assert left.pattern[:2].tolist() == [0.0, 0.0]
    assert left.pattern[2] * right.pattern[2] < 0
    # A panel 1 µm nearer: where the left camera's ray through the aim point meets it, the projector's column.
    aim = aim_frame(rig)[1]
    ray, normal = (aim - rig.left.centre), pose.R[:, 2]
    there = aim + ray / (ray @ normal) * 1e-3
    expected = rig.projector.project(there)[0] - rig.projector.project(aim)[0]
    assert left.pattern[2] * 1e-3 == pytest.approx(expected, rel=1e-3)


def test_random_clutter_is_added_to_the_same_panel_and_holds_enough_letters():
    for seed in range(5):
        bare = random_panel(np.random.default_rng(seed))
        full = random_panel(np.random.default_rng(seed), clutter=Clutter())
        assert [replace(r, slot=None) for r in full.rivets] == [replace(r, slot=None) for r in bare.rivets]
        assert full.skin == bare.skin
        assert sum(len(s.text.replace(" ", "")) for s in full.surface.stencils) >= 20
        for hole in full.holes:
            assert all(math.hypot(hole.x_mm - r.x_mm, hole.y_mm - r.y_mm) > hole.diameter_mm for r in bare.rivets)


def test_flicker_scales_frames_alike_in_both_cameras_and_a_still_scan_has_none(make_spec, panel, stage):
    still = fringe_light(make_spec(panel), stage, np.random.default_rng(1))
    lamp = fringe_light(make_spec(panel, disturbances=Disturbances(flicker=0.03)), stage, np.random.default_rng(1))
    ratio = {side: np.median(lamp[side] / still[side], axis=(1, 2)) for side in ("left", "right")}
    np.testing.assert_allclose(ratio["left"], ratio["right"], atol=2e-3)
    assert 0.01 < ratio["left"].std() < 0.06


def test_a_vibrating_panel_shifts_each_frames_pattern_by_its_motion_along_the_normal(make_spec, panel, stage, spec):
    shaken = make_spec(panel, disturbances=Disturbances(vibration_mm=0.1))
    rng = np.random.default_rng(1)
    rng.normal(0, 1, spec.fringe.frames)  # the projector's own shifts are drawn first
    moves = 0.1 * rng.standard_normal((spec.fringe.frames, 3))
    seen, still = (fringe_light(s, stage, np.random.default_rng(1))["left"] for s in (shaken, spec))
    projector = stage.rig.projector
    stripes = project_stripes(spec.fringe, projector.width, projector.height, spec.projector)
    shifts = moves @ sway_of(stage.rig, "left", stage.pose, "x").pattern
    pattern_alone = receive_stripes(stage.left, stripes, shifts)
    skin = (slice(60, 140), slice(200, 240))  # away from edges, evenly painted
    np.testing.assert_allclose(seen[:, *skin], pattern_alone[:, *skin], atol=0.3)
    assert np.abs(seen[:, *skin] - still[:, *skin]).max() > 1.0


def test_gaps_between_projector_pixels_keep_the_mean_light_and_show_when_it_is_sharp():
    values = np.full((1, 8), 0.7)
    whole, grid_of = (_spread(values, Beamer(blur_px=0.2, fill=fill))[0][13 * 32 : 19 * 32] for fill in (1.0, 0.8))
    assert grid_of.mean() == pytest.approx(whole.mean(), rel=1e-3)
    assert np.ptp(whole) < 1e-3
    assert np.ptp(grid_of) > 0.1

"""The truth beside a scene against the panel's own surface, sampled."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator.pack import pack
from simulator.panel import Panel, Rivet, Seam, Skin
from simulator.relief import HEAD
from simulator.rig import aim_frame, virtual_rig
from simulator.survey import plate_heights, survey
from simulator.truth import Pose, section, stations, truth
from tests.support.whole_panel import surface_heights


@pytest.fixture
def rig(rng):
    return virtual_rig(rng)


def posed(rig, degrees=(0.0, 0.0, 0.0)):
    R, t = aim_frame(rig)
    return Pose(R @ Rotation.from_euler("xyz", degrees, degrees=True).as_matrix(), t)


def test_rivet_truth_is_the_mean_of_its_head(rig):
    rivet = Rivet("R", -40.0, 25.0, 8.0, 0.15, 0.6, 130.0, crown_mm=0.24)
    panel = Panel(skin=Skin(1000, 2500, 10), rivets=(rivet,))
    relief, pose = pack(panel), posed(rig, (3, 5, 2))
    told = truth(panel, relief, rig, pose).rivets[0]
    x, y = np.meshgrid(np.linspace(-45, -35, 1001), np.linspace(20, 30, 1001))
    z, kinds = surface_heights(relief, x.ravel(), y.ravel())
    head = np.stack([x.ravel(), y.ravel(), z], axis=1)[kinds == HEAD]
    point, normal = survey(relief, -40.0, 25.0)
    heights = (head - point) @ normal
    assert told.height_mean_mm == pytest.approx(heights.mean(), abs=2e-4)
    np.testing.assert_allclose(pose.to_panel(np.array(told.xyz_mm)), head.mean(axis=0), atol=2e-2)
    np.testing.assert_allclose(told.uv_px, rig.left.project(told.xyz_mm), atol=1e-9)
    assert told.head_edge_rise_mm == pytest.approx(4.0 * np.sin(np.radians(0.6)))
    assert told.visible


def test_step_and_width_follow_the_papers_equations_on_a_plane(rig):
    seam = Seam("J", ((-20.0, -110.0), (10.0, 110.0)), (1.0, 1.6), (0.3,), chamfer_mm=0.4)
    panel = Panel(seams=(seam,))
    relief = pack(panel)
    xi = stations(0, relief, panel)
    left, right, step, width = section(relief, 0, xi)
    np.testing.assert_allclose(step, 0.3, atol=1e-9)
    length = np.hypot(30, 220)
    np.testing.assert_allclose(width, 1.0 + 0.6 * xi / length, atol=1e-5)
    np.testing.assert_allclose(left.skin[:, 2], 0.15, atol=1e-12)
    np.testing.assert_allclose(left.inflection[:, 2], 0.15 - 0.4, atol=1e-12)
    np.testing.assert_allclose(right.ideal[:, 2], -0.15, atol=1e-9)


def test_step_is_free_of_curvature(rig):
    seam = Seam("J", ((0.0, -110.0), (0.0, 110.0)), (5.0,), (0.2,), chamfer_mm=0.5)
    flat, curved = (pack(Panel(skin=skin, seams=(seam,))) for skin in (Skin(), Skin(600, 900, 20)))
    xi = np.linspace(60, 160, 11)
    np.testing.assert_allclose(section(flat, 0, xi)[2], section(curved, 0, xi)[2], atol=0.002)


@pytest.mark.parametrize("course", [((0.0, -110.0), (5.0, 110.0)), ((-150.0, 10.0), (150.0, -5.0))])
def test_step_is_side_b_minus_side_a_whichever_way_the_course_runs(rig, course):
    told = []
    for points, step in ((course, 0.25), (course[::-1], -0.25)):
        panel = Panel(seams=(Seam("J", points, (1.5,), (step,)),))
        told.append(truth(panel, pack(panel), rig, posed(rig)).seams[0])
    np.testing.assert_allclose(np.median(told[0].step_mm), np.median(told[1].step_mm), atol=1e-9)
    # By sight: the plate at larger u (or v) is higher where the step is positive.
    relief, pose = pack(panel), posed(rig)
    axis = 0 if course[0][0] == 0.0 else 1
    beside = np.array([[20.0, 30.0], [-20.0, -30.0]]) if axis == 0 else np.array([[20.0, 30.0], [20.0, -30.0]])
    z, _ = surface_heights(relief, beside[:, 0].copy(), beside[:, 1].copy())
    uv = rig.left.project(pose.to_rig(np.column_stack([beside, z])))
    b = int(uv[1, axis] > uv[0, axis])
    assert np.sign(z[b] - z[1 - b]) == np.sign(np.median(told[0].step_mm))


def test_stations_are_a_millimetre_apart_and_seen_from_border_to_border(rig):
    panel = Panel(skin=Skin(1200, 2000), seams=(Seam("J", ((-30.0, -110.0), (-22.0, 0.0), (-30.0, 110.0)), (2.0,)),))
    told = truth(panel, pack(panel), rig, posed(rig)).seams[0]
    gaps = np.linalg.norm(np.diff(told.xyz_mm, axis=0), axis=1)
    np.testing.assert_allclose(gaps, 1.0, atol=0.02)
    visible = np.array(told.visible)
    assert 190 <= visible.sum() < len(visible)
    assert not visible[0]
    np.testing.assert_allclose(told.uv_px, rig.left.project(np.array(told.xyz_mm)), atol=1e-9)


def test_what_is_out_of_view_or_at_a_crossing_is_not_visible(rig):
    far = Rivet("far", 145.0, 0.0, 6.0)
    near = Rivet("near", 10.0, 30.0, 6.0)
    seams = (Seam("A", ((0.0, -110.0), (0.0, 110.0)), (2.0,)), Seam("B", ((-160.0, 0.0), (160.0, 0.0)), (1.0,)))
    panel = Panel(width_mm=400.0, rivets=(far, near), seams=seams)
    pose = posed(rig)
    shifted = Pose(pose.R, pose.t + pose.R @ np.array([30.0, 0.0, 0.0]))
    told = truth(panel, pack(panel), rig, shifted)
    assert [r.visible for r in told.rivets] == [False, True]
    for seam in told.seams:
        xyz = shifted.to_panel(np.array(seam.xyz_mm))
        crossing = np.hypot(xyz[:, 0], xyz[:, 1]) < 1.0
        assert not np.array(seam.visible)[crossing].any()
    assert np.array(told.seams[0].visible).any()


def test_truth_does_not_depend_on_where_the_panel_stands(rig):
    panel = Panel(skin=Skin(1500), rivets=(Rivet("R", 20.0, 10.0, 6.0, 0.1),),
                  seams=(Seam("J", ((0.0, -110.0), (0.0, 110.0)), (2.0,), (0.1, 0.2)),))  # fmt: skip
    relief = pack(panel)
    here, there = (truth(panel, relief, rig, posed(rig, d)) for d in ((0, 0, 0), (6, -5, 3)))
    assert here.rivets[0].height_mean_mm == there.rivets[0].height_mean_mm
    np.testing.assert_allclose(here.seams[0].step_mm, there.seams[0].step_mm, atol=1e-12)
    np.testing.assert_allclose(here.seams[0].width_mm, there.seams[0].width_mm, atol=1e-12)


def test_filled_seam_joins_both_edges():
    seam = Seam("J", ((0.0, -110.0), (0.0, 110.0)), (2.0,), (0.3,), filled=True, depth_mm=0.0)
    relief = pack(Panel(seams=(seam,)))
    x = np.array([-1.5, -0.999999, 0.0, 0.999999, 1.5])
    z, _ = surface_heights(relief, x, np.zeros(5))
    np.testing.assert_allclose(z, [0.15, 0.15, 0.0, -0.15, -0.15], atol=1e-6)
    assert plate_heights(relief, x[:1], np.zeros(1), np.array([1]))[0] == pytest.approx(0.15)


@pytest.mark.parametrize("angle", [15.0, 30.0, 60.0, 80.0])
@pytest.mark.parametrize("step", [1.5, -1.5])
def test_sides_of_a_high_step_are_those_of_the_skins(rig, angle, step):
    # The camera sees a high edge aside of where it stands: that decides nothing.
    c, s = 60.0 * np.cos(np.radians(angle)), 60.0 * np.sin(np.radians(angle))
    lap = Seam("J", ((-c, -s), (c, s)), (0.0,), (step,), joint="lap")
    panel = Panel(seams=(lap,))
    (told,) = truth(panel, pack(panel), rig, posed(rig, (8, -8, 0))).seams
    # The panel's y points up: the sheet to the left of the course lies above it or to its left in the image, side A.
    np.testing.assert_allclose(told.step_mm, -step, atol=1e-6)

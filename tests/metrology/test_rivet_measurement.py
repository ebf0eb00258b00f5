"""Heads on synthetic clouds: heights, tilts and crowns come back; what cannot be measured says why."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from metrology.cloud import PixelFlag
from metrology.results import Rivet, SeamLine
from metrology.rivets import RivetSettings, detect_rivets, measure_rivets
from metrology.rivets.ellipse import ellipse_of_shape
from metrology.rivets.geometry import lay_on_plane
from tests.support.reference_scans import reference_scan
from tests.support.rivet_scan import Head, Skin, rig_of, scan, truth_detection

CURVED = Skin(radius_x=1800.0, radius_y=900.0)
# In reading order: the skin's y runs up the image.
HEADS = (
    Head(-35, 22, 8.0, 0.12, 0.4, 30),
    Head(0, 24, 5.0, -0.08, 0.3, 200),
    Head(34, 20, 9.5, 0.30, 0.0),
    Head(-32, -20, 6.4, 0.0, 0.6, 120),
    Head(2, -22, 12.0, -0.15, 0.2, 310),
    Head(36, -21, 4.0, 0.05, 0.0),
)


def measured(skin: Skin, heads: tuple[Head, ...], rng: np.random.Generator | None, **settings: object) -> list[Rivet]:
    reconstruction = scan(skin, heads, rng)
    detections = [truth_detection(reconstruction, skin, head) for head in heads]
    return measure_rivets(detections, reconstruction, (), RivetSettings(**settings))  # type: ignore[arg-type]


def test_without_noise_heights_and_tilts_are_exact() -> None:
    for head, rivet in zip(HEADS, measured(CURVED, HEADS, None), strict=True):
        assert rivet.height_mean_mm == pytest.approx(head.height, abs=2e-4)
        assert rivet.tilt_deg == pytest.approx(head.tilt_deg, abs=0.02)
        assert rivet.diameter_mm == pytest.approx(head.diameter, rel=2e-3)
        rise = head.diameter / 2 * np.tan(np.radians(head.tilt_deg))
        assert rivet.height_max_mm - rivet.height_min_mm == pytest.approx(2 * rise, abs=2e-3)


def test_plane_reference_is_biased_by_the_curvature_and_the_quadric_is_not() -> None:
    """The mean over the annulus of a quadric of radius R lies r²/4R below its vertex in each direction."""
    quadric = measured(CURVED, HEADS, None)
    plane = measured(CURVED, HEADS, None, reference="plane")
    for a, b in zip(quadric, plane, strict=True):
        assert b.height_mean_mm - a.height_mean_mm > 0.003
    flat = Skin()
    for a, b in zip(measured(flat, HEADS, None), measured(flat, HEADS, None, reference="plane"), strict=True):
        assert b.height_mean_mm == pytest.approx(a.height_mean_mm, abs=1e-4)


def test_moving_the_rig_changes_nothing(rng: np.random.Generator) -> None:
    """The same skin nearer and otherwise slanted: heights and tilts are the skin's own."""
    for slant in ((10.0, -6.0), (-12.0, 14.0)):
        for head, rivet in zip(HEADS, measured(replace(CURVED, slant_deg=slant), HEADS, None), strict=True):
            assert rivet.height_mean_mm == pytest.approx(head.height, abs=2e-4)
            assert rivet.tilt_deg == pytest.approx(head.tilt_deg, abs=0.02)


def test_a_head_that_is_mostly_saturated_is_not_measured_by_what_is_left_of_it() -> None:
    """What is left is its darkest part, such as the floor of a recess."""
    reconstruction = scan(CURVED, HEADS, None)
    detections = [truth_detection(reconstruction, CURVED, head) for head in HEADS]
    v, u = np.indices(reconstruction.flags.shape)
    for head, from_row in ((detections[0], -0.1), (detections[1], 0.15)):  # of its height, from its centre down
        lost = np.hypot(u - head.u_px, v - head.v_px) < 0.52 * head.major_px
        lost &= v > head.v_px + from_row * head.major_px
        reconstruction.flags[lost] |= np.uint16(PixelFlag.SATURATED)
        reconstruction.points[lost] = np.nan
    said = measure_rivets(detections, reconstruction)
    assert (said[0].height_mean_mm, said[0].decision) == (None, "not measured")
    assert "of it is saturated; take a shorter exposure as well" in str(said[0].reason)
    assert said[1].height_mean_mm == pytest.approx(HEADS[1].height, abs=2e-3)


@pytest.mark.parametrize("correlated_px", [0.0, 1.5])
def test_u95_covers_the_errors(correlated_px: float) -> None:
    skin = replace(CURVED, correlated_px=correlated_px)
    errors, limits = [], []
    for seed in range(14):
        for head, rivet in zip(HEADS, measured(skin, HEADS, np.random.default_rng(seed)), strict=True):
            errors.append(abs(rivet.height_mean_mm - head.height))
            limits.append(rivet.height_u95_mm)
    coverage = np.mean(np.array(errors) <= limits)
    assert 0.88 <= coverage <= 1.0
    # Not by being timid: the errors' own spread is comparable with the limits.
    assert np.quantile(errors, 0.95) > 0.5 * np.median(limits)


def test_scan_after_scan_agrees() -> None:
    """Ten scans of a 9.5 mm head scatter by less than a micrometre (the paper's: 2.3)."""
    heights = [measured(CURVED, HEADS, np.random.default_rng(seed))[2].height_mean_mm for seed in range(10)]
    assert np.std(heights) < 0.001


def test_the_same_seed_gives_the_same_numbers() -> None:
    once, again = (measured(CURVED, HEADS, np.random.default_rng(5)) for _ in range(2))
    assert once == again


def test_a_dome_reports_its_crown_and_a_flat_head_none(rng: np.random.Generator) -> None:
    heads = (Head(-20, 0, 10.0, 0.1, crown=0.2), Head(20, 0, 10.0, 0.1))
    dome, flat = measured(Skin(), heads, rng)
    assert dome.crown_mm == pytest.approx(0.2, rel=0.1)
    assert dome.height_mean_mm == pytest.approx(0.1, abs=0.006)
    assert dome.height_max_mm == pytest.approx(0.2, abs=0.012)
    assert flat.crown_mm is None


def test_a_seam_through_the_annulus_is_cut_out(rng: np.random.Generator) -> None:
    """A panel edge 0.3 mm lower, 7 mm beside the head, is no skin of this head once the seam is known."""
    skin, head = Skin(), Head(0, 0, 8.0, 0.1)
    reconstruction = scan(skin, [head], rng)
    local = skin.frame.local(reconstruction.points.astype(float))
    local[..., 2] -= 0.3 * (local[..., 0] > 7.0)
    lowered = replace(reconstruction, points=skin.frame.rig(local).astype(np.float32))
    ends = reconstruction.rig.left.project(skin.frame.rig([[7.0, -30.0, 0.0], [7.0, 30.0, 0.0]]))
    line = ends[0] + np.linspace(0, 1, 400)[:, None] * (ends[1] - ends[0])
    seam = SeamLine("S01", line, np.full(400, 6.0), 1.0, True)
    (rivet,) = measure_rivets([truth_detection(reconstruction, skin, head)], lowered, [seam])
    assert rivet.height_mean_mm == pytest.approx(0.1, abs=0.004)


@pytest.mark.parametrize(("offset", "turn_deg"), [(0.0, 0.0), (0.4, 50.0), (-1.5, 110.0)])
def test_a_crease_of_the_skin_under_the_head_is_followed(offset: float, turn_deg: float) -> None:
    """The slope changes by 0.01 along a line through the head: its height is that over the line's skin."""
    skin, head = replace(CURVED, correlated_px=0.5), Head(0, 0, 8.0, 0.1)
    across = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    for seed in range(3):
        flat = scan(skin, [head], np.random.default_rng(seed))
        local = skin.frame.local(flat.points.astype(float))
        t = np.where(np.hypot(local[..., 0], local[..., 1]) < 4.2, 0.0, local[..., :2] @ across)
        local[..., 2] += 0.005 * np.abs(t - offset)
        creased = replace(flat, points=skin.frame.rig(local).astype(np.float32))
        (rivet,) = measure_rivets([truth_detection(flat, skin, head)], creased)
        assert abs(rivet.height_mean_mm - 0.1) < rivet.height_u95_mm < 0.01


def test_skin_beyond_a_seam_is_another_plate(rng: np.random.Generator) -> None:
    """A step of 30 µm, two standard deviations of a point, makes no outliers: what lies beyond must not count."""
    skin, head = Skin(), Head(0, 0, 8.0, 0.1)
    reconstruction = scan(skin, [head], rng)
    local = skin.frame.local(reconstruction.points.astype(float))
    local[..., 2] -= 0.03 * (local[..., 0] > 6.5)
    lowered = replace(reconstruction, points=skin.frame.rig(local).astype(np.float32))
    ends = reconstruction.rig.left.project(skin.frame.rig([[6.5, -30.0, 0.0], [6.5, 30.0, 0.0]]))
    line = ends[0] + np.linspace(0, 1, 400)[:, None] * (ends[1] - ends[0])
    seam = SeamLine("S01", line, np.full(400, 2.0), 1.0, True)
    detection = truth_detection(reconstruction, skin, head)
    for cut, same in (([seam], True), ([], False)):
        level, stepped = (measure_rivets([detection], cloud, cut)[0] for cloud in (reconstruction, lowered))
        assert (abs(level.height_mean_mm - stepped.height_mean_mm) < 1e-6) == same
        assert (level.n_outer, level.rms_outer_mm) == (stepped.n_outer, stepped.rms_outer_mm) or not same


@pytest.mark.parametrize("cross", [False, True])
def test_a_slot_and_its_mixed_edges_are_cut_out_of_the_head(rng: np.random.Generator, cross: bool) -> None:
    """Blur makes the slot's walls slopes: points on them that lie within the noise of the head pull it down."""
    skin, head = Skin(), Head(0, 0, 9.5, 0.1, 0.3, 40)
    reconstruction = scan(skin, [head], rng)
    local = skin.frame.local(reconstruction.points.astype(float))
    along, across = np.abs(local[..., 0]), np.abs(local[..., 1])
    slot = (along < 3.3) & (across < 0.45)
    if cross:
        slot |= (across < 3.3) & (along < 0.45)
    local[..., 2] -= 0.5 * cv2.GaussianBlur(slot.astype(float), (0, 0), 0.75)
    slotted = replace(reconstruction, points=skin.frame.rig(local).astype(np.float32))
    (rivet,) = measure_rivets([truth_detection(reconstruction, skin, head)], slotted)
    assert abs(rivet.height_mean_mm - 0.1) < rivet.height_u95_mm < 0.006
    assert abs(rivet.tilt_deg - 0.3) < rivet.tilt_u95_deg < 0.15
    assert rivet.crown_mm is None


def test_points_to_one_side_leave_the_middle_uncertain(rng: np.random.Generator) -> None:
    """What blur adds beside a recess leans the points that are left: U95 covers what that does to the middle."""
    skin, head = Skin(), Head(0, 0, 8.0, 0.1)
    whole = scan(skin, [head], rng)
    local = skin.frame.local(whole.points.astype(float))
    on_head = np.hypot(local[..., 0], local[..., 1]) < 4.0
    local[..., 2] += on_head * 0.02 * (local[..., 0] - 1.8)
    points = skin.frame.rig(local).astype(np.float32)
    points[on_head & (local[..., 0] < 1.0)] = np.nan
    detection = truth_detection(whole, skin, head)
    (rivet,) = measure_rivets([detection], replace(whole, points=points))
    assert 0.03 < abs(rivet.height_mean_mm - 0.1) < rivet.height_u95_mm
    assert 0.8 < rivet.tilt_deg < rivet.tilt_u95_deg


def test_the_floor_of_a_wide_slot_is_not_taken_for_the_head(rng: np.random.Generator) -> None:
    skin, head = Skin(), Head(0, 0, 8.0, 0.1)
    reconstruction = scan(skin, [head], rng)
    local = skin.frame.local(reconstruction.points.astype(float))
    local[..., 2] -= 0.4 * (np.hypot(local[..., 0], local[..., 1]) < 2.4)
    recessed = replace(reconstruction, points=skin.frame.rig(local).astype(np.float32))
    (rivet,) = measure_rivets([truth_detection(reconstruction, skin, head)], recessed)
    assert abs(rivet.height_mean_mm - 0.1) < rivet.height_u95_mm < 0.05


def test_a_head_whose_points_lie_on_no_surface_is_not_measured(rng: np.random.Generator) -> None:
    """What blur leaves of a narrow slot on a small head: its points scatter, and no one of them is far off."""
    head = Head(0, 0, 4.8, 0.1)
    reconstruction = scan(Skin(), (head,), rng)
    local = Skin().frame.local(reconstruction.points.astype(float))
    inside = np.hypot(local[..., 0], local[..., 1]) < 2.4
    local[..., 2] += np.where(inside, rng.uniform(-0.06, 0.06, inside.shape), 0.0)
    rough = replace(reconstruction, points=Skin().frame.rig(local).astype(np.float32))
    (rivet,) = measure_rivets([truth_detection(reconstruction, Skin(), head)], rough)
    assert rivet.height_mean_mm is None
    assert "scatter" in rivet.reason
    assert "the skin's" in rivet.reason


def test_domes_do_not_widen_the_limits_of_flat_heads(rng: np.random.Generator) -> None:
    """A dome's own shape is no noise: what is left of it over a plane must not enter how points scatter."""
    flat = tuple(Head(x, 18, 9.0, 0.1) for x in (-30, 0, 30))
    domes = tuple(Head(x, -18, 9.0, 0.1, crown=0.2) for x in (-30, 0, 30))
    skin = Skin()
    with_domes, without = measured(skin, flat + domes, rng), measured(skin, flat, rng)
    for a, b in zip(with_domes[:3], without, strict=True):
        assert a.height_u95_mm < 1.5 * b.height_u95_mm
    for dome in with_domes[3:]:
        assert abs(dome.height_mean_mm - 0.1) < 2 * dome.height_u95_mm < 0.02


def test_a_neighbour_is_cut_out(rng: np.random.Generator) -> None:
    heads = (Head(-6, 0, 8.0, 0.1), Head(6, 0, 8.0, 0.8))
    low, high = measured(Skin(), heads, rng)
    assert low.height_mean_mm == pytest.approx(0.1, abs=0.006)
    assert high.height_mean_mm == pytest.approx(0.8, abs=0.006)


def test_flagged_points_do_not_count(rng: np.random.Generator) -> None:
    skin, head = Skin(), Head(0, 0, 8.0, 0.1)
    reconstruction = scan(skin, [head], rng)
    local = skin.frame.local(reconstruction.points.astype(float))
    wrong = np.hypot(local[..., 0], local[..., 1] - 2) < 1.5
    local[..., 2] += 0.05 * wrong
    flags = np.where(wrong, np.uint16(PixelFlag.EDGE), np.uint16(0)).astype(np.uint16)
    spoilt = replace(reconstruction, points=skin.frame.rig(local).astype(np.float32), flags=flags)
    (rivet,) = measure_rivets([truth_detection(reconstruction, skin, head)], spoilt)
    assert rivet.height_mean_mm == pytest.approx(0.1, abs=0.004)


@pytest.mark.parametrize(("region", "word"), [("inside", "head"), ("outside", "skin"), ("all", "no points")])
def test_what_cannot_be_measured_says_why(region: str, word: str) -> None:
    skin, head = Skin(), Head(0, 0, 8.0, 0.1)
    reconstruction = scan(skin, [head], None)
    local = skin.frame.local(reconstruction.points.astype(float))
    r = np.hypot(local[..., 0], local[..., 1])
    gone = {"inside": r < 4, "outside": r > 4, "all": r >= 0}[region]
    points = np.where(gone[..., None], np.nan, reconstruction.points).astype(np.float32)
    detection = truth_detection(reconstruction, skin, head)
    (rivet,) = measure_rivets([detection], replace(reconstruction, points=points))
    assert rivet.height_mean_mm is None
    assert rivet.height_u95_mm is None
    assert rivet.decision == "not measured"
    assert word in rivet.reason
    assert (rivet.u_px, rivet.v_px) == (detection.u_px, detection.v_px)


def test_a_wide_slot_right_across_leaves_two_parts_of_one_plane(rng: np.random.Generator) -> None:
    """Two levels in one head, as a wide slot makes them: the upper one is the head's."""
    skin, head = Skin(), Head(0, 0, 8.0, 0.1)
    reconstruction = scan(skin, [head], rng)
    local = skin.frame.local(reconstruction.points.astype(float))
    local[..., 2] -= 0.4 * (np.abs(local[..., 0]) < 1.2) * (np.hypot(local[..., 0], local[..., 1]) < 4)
    recessed = replace(reconstruction, points=skin.frame.rig(local).astype(np.float32))
    (rivet,) = measure_rivets([truth_detection(reconstruction, skin, head)], recessed)
    assert rivet.height_mean_mm == pytest.approx(0.1, abs=0.01)


def test_detection_and_measurement_end_to_end(rng: np.random.Generator) -> None:
    """Ellipses found in the texture lead to the heads' centres, sizes and heights; rows run from the top left."""
    reconstruction = scan(CURVED, HEADS, rng)
    detections = detect_rivets(reconstruction)
    rivets = measure_rivets(detections, reconstruction)
    assert [r.rivet_id for r in rivets] == [f"R{k:02d}" for k in range(1, 7)]
    for head, rivet in zip(HEADS, rivets, strict=True):
        centre = CURVED.frame.rig(
            [head.x, head.y, float(CURVED.height(np.array(head.x), np.array(head.y))) + head.height]
        )
        assert [rivet.x_mm, rivet.y_mm, rivet.z_mm] == pytest.approx(centre, abs=0.03)
        assert [rivet.u_px, rivet.v_px] == pytest.approx(reconstruction.rig.left.project(centre), abs=0.12)
        assert [rivet.u_right_px, rivet.v_right_px] == pytest.approx(reconstruction.rig.right.project(centre), abs=0.2)
        assert rivet.diameter_mm == pytest.approx(head.diameter, rel=0.01)
        assert rivet.height_mean_mm == pytest.approx(head.height, abs=0.006)


def test_a_painted_over_head_is_seen_in_the_height_map(rng: np.random.Generator) -> None:
    heads = (Head(-20, 0, 9.0, 0.15, contrast=0.0), Head(20, 0, 9.0, 0.15))
    rivets = measure_rivets(found := detect_rivets(reconstruction := scan(Skin(), heads, rng)), reconstruction)
    assert len(found) == 2
    assert found[0].rim_sigma_px is None
    assert rivets[0].height_mean_mm == pytest.approx(0.15, abs=0.006)
    assert rivets[0].diameter_mm == pytest.approx(9.0, rel=0.06)


@pytest.mark.parametrize("height", [0.18, -0.09])
def test_a_recessed_head_without_a_rim_is_seen_on_a_bent_skin(rng: np.random.Generator, height: float) -> None:
    """Its recess is deeper than it is high, and smoothing cuts 0.1 mm off the skin's bend."""
    skin = Skin(radius_x=420.0, radius_y=2000.0)
    heads = (Head(-20, 5, 9.0, height, contrast=0.0), Head(25, -5, 9.0, height, contrast=0.0))
    reconstruction = scan(skin, heads, rng)
    local = skin.frame.local(reconstruction.points.astype(float))
    for head in heads:
        x, y = np.abs(local[..., 0] - head.x), np.abs(local[..., 1] - head.y)
        recess = (np.minimum(x, y) < 0.7) & (np.maximum(x, y) < 2.6)
        local[..., 2] -= np.where(recess, 0.9, 0.0)
    found = detect_rivets(replace(reconstruction, points=skin.frame.rig(local).astype(np.float32)))
    assert [d.found_by for d in found] == ["relief", "relief"]
    for detection, head in zip(found, heads, strict=True):
        at = reconstruction.rig.left.project(skin.frame.rig([head.x, head.y, skin.height(head.x, head.y) + height]))
        assert (detection.u_px, detection.v_px) == pytest.approx(at, abs=2.0)


def test_a_faint_rim_under_strokes_is_fitted_where_the_relief_shows_a_head(rng: np.random.Generator) -> None:
    reconstruction = scan(Skin(), (Head(0, 0, 9.0, 0.12, contrast=8.0),), rng)
    texture = reconstruction.left.texture.copy()
    strokes = (((160, 205), (480, 265)), ((160, 290), (480, 230)), ((295, 60), (325, 420)), ((345, 60), (275, 420)))
    for start, end in strokes:
        cv2.line(texture, start, end, 20.0, 6)
    marked = replace(reconstruction, left=replace(reconstruction.left, texture=texture))
    (detection,) = detect_rivets(marked)
    assert detection.doubt is None


def test_holes_and_drawn_ellipses_are_no_rivets(rng: np.random.Generator) -> None:
    """A ring with nothing in it is a hole; an ellipse that no circle on this skin looks like is a drawing."""
    skin = Skin()
    reconstruction = scan(skin, [Head(-20, 0, 9.0, 0.0)], rng)
    local = skin.frame.local(reconstruction.points.astype(float))
    hole = np.hypot(local[..., 0] + 20, local[..., 1]) < 4.3
    points = np.where(hole[..., None], np.nan, reconstruction.points).astype(np.float32)
    r = np.hypot((local[..., 0] - 20) / 6.0, local[..., 1] / 3.5)
    drawn = reconstruction.left.texture - (40 * np.exp(-0.5 * ((r - 1) * 4.6 / 0.16) ** 2)).astype(np.float32)
    view = replace(reconstruction.left, texture=drawn.astype(np.float32))
    assert detect_rivets(replace(reconstruction, points=points, left=view)) == []


def test_the_ellipse_centre_is_not_the_circle_centre() -> None:
    """Seen at a slant the ellipse's middle lies off the image of the circle's; laid on the plane it does not."""
    skin = Skin(slant_deg=(30.0, 20.0))
    rig = rig_of()
    frame = skin.frame
    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    circle = frame.rig(np.stack([8 * np.cos(t) + 3, 8 * np.sin(t) - 5, 0 * t], axis=-1))
    pixels = rig.left.project(circle)
    middle = 0.5 * (pixels.min(axis=0) + pixels.max(axis=0))
    centred = pixels - pixels.mean(axis=0)
    moments = ellipse_of_shape(middle[0], middle[1], 2 * centred.T @ centred / len(t))
    x, y, radius = lay_on_plane(rig.left, moments, frame)
    image = rig.left.project(frame.rig([3.0, -5.0, 0.0]))
    assert np.hypot(*(image - middle)) > 0.05
    assert (x, y) == pytest.approx((3.0, -5.0), abs=0.02)
    assert radius == pytest.approx(8.0, rel=2e-3)


@pytest.mark.parametrize("name", ["standard-part", "skin", "skin-worn", "skin-shiny"])
def test_reference_scans(shared: Path, name: str) -> None:
    """All rivets of independently rendered scans, none else; heights to a micrometre or two, centres to 0.02 mm."""
    reconstruction, truth = reference_scan(shared / "scenes" / name)
    rivets = measure_rivets(detect_rivets(reconstruction), reconstruction)
    assert len(rivets) == len(truth["rivets"])
    errors, tilts, diameters, centres = [], [], [], []
    for t in truth["rivets"]:
        rivet = min(rivets, key=lambda r: np.hypot(r.u_px - t["uv_px"][0], r.v_px - t["uv_px"][1]))
        centres.append(np.linalg.norm(np.array([rivet.x_mm, rivet.y_mm, rivet.z_mm]) - t["xyz_mm"]))
        diameters.append(rivet.diameter_mm / t["diameter_mm"] - 1)
        errors.append(rivet.height_mean_mm - t["height_mean_mm"])
        tilts.append(rivet.tilt_deg - t["tilt_deg"])
    assert max(centres) < 0.02
    assert np.abs(diameters).max() < 0.008
    assert np.mean(np.abs(errors)) < 0.0020
    assert np.abs(errors).max() < 0.006
    assert abs(np.mean(errors)) < 0.0008
    assert np.mean(np.abs(tilts)) < 0.06

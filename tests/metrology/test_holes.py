"""Open holes: found in the cloud, measured in both pictures, and named after the fastener that is missing."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from metrology.cloud import PixelFlag, Reconstruction
from metrology.fastening import detect_fasteners
from metrology.holes import measure_holes
from metrology.holes.bore import _outermost as outermost
from metrology.holes.countersink import Countersink, countersink
from metrology.holes.measure import _cone as about_its_axis
from metrology.holes.measure import _smeared as smeared
from metrology.holes.measure import measure_sighted
from metrology.holes.rim import Edges, RimCircle, leans, rim_circle
from metrology.kinds import HOLE
from metrology.limits import Limit, PanelSpec
from metrology.panel import NominalRivet
from metrology.registration.openings import explained, missing_fasteners
from metrology.results import Hole, Rivet, SeamLine
from metrology.rivets.ground import ground_of
from metrology.rivets.patch import blocked_pixels, cut_patch
from metrology.rivets.settings import RivetSettings
from metrology.sighted import Sighted
from metrology.tolerance import judge
from tests.support.rivet_scan import Head, Skin, scan, truth_detection

SKIN = Skin()
DEEP = 4.0


def on_skin(reconstruction: Reconstruction) -> tuple[np.ndarray, np.ndarray]:
    local = SKIN.frame.local(reconstruction.points.astype(float))
    return local[..., 0], local[..., 1]


def darkened(
    reconstruction: Reconstruction, x: float, y: float, radius: float, share: float = 0.9, deep: float = 0.0
) -> Reconstruction:
    """Both pictures with a dark disc so deep below the skin, blurred to 0.75 pixels, as a hole without light is."""
    rig, views = reconstruction.rig, []
    for view, camera in ((reconstruction.left, rig.left), (reconstruction.right, rig.right)):
        v, u = np.mgrid[: camera.height, : camera.width].astype(float)
        rays = camera.rays(np.stack([u, v], axis=-1)) @ SKIN.frame.axes.T
        eye = SKIN.frame.local(camera.centre)
        reach = (-deep - eye[2]) / rays[..., 2]
        away = np.hypot(eye[0] + reach * rays[..., 0] - x, eye[1] + reach * rays[..., 1] - y) - radius
        sigma = 0.75 * 700.0 / rig.left.K[0, 0]
        inside = 0.5 - 0.5 * np.tanh(0.85 * away / sigma)
        views.append(replace(view, texture=(view.texture * (1 - share * inside)).astype(np.float32)))
    return replace(reconstruction, left=views[0], right=views[1])


def moved(reconstruction: Reconstruction, inside: np.ndarray, height: np.ndarray | float) -> Reconstruction:
    """The cloud with a part lifted (mm); NaN takes its points away."""
    local = SKIN.frame.local(reconstruction.points.astype(float))
    local[..., 2] += np.where(inside, height, 0.0)
    return replace(reconstruction, points=SKIN.frame.rig(local).astype(np.float32))


@pytest.mark.parametrize("floor", [-DEEP, np.nan])
@pytest.mark.parametrize("diameter", [3.0, 5.0, 8.0])
def test_a_hole_is_found_and_its_diameter_measured(rng: np.random.Generator, diameter: float, floor: float) -> None:
    reconstruction = scan(SKIN, (Head(-30, 10), Head(30, 10)), rng)
    x, y = on_skin(reconstruction)
    reconstruction = moved(reconstruction, np.hypot(x - 2, y + 5) < diameter / 2, floor)
    found = detect_fasteners(darkened(reconstruction, 2.0, -5.0, diameter / 2))
    (hole,) = measure_holes(found.openings, reconstruction := darkened(reconstruction, 2.0, -5.0, diameter / 2))
    assert len(found.rivets) == 2
    assert (hole.hole_id, hole.kind, hole.decision) == ("H01", "open hole", "no limit")
    assert hole.diameter_mm == pytest.approx(diameter, abs=0.05)
    assert abs(hole.diameter_mm - diameter) < hole.diameter_u95_mm < 0.15
    assert [hole.x_mm, hole.y_mm, hole.z_mm] == pytest.approx(SKIN.frame.rig([2.0, -5.0, 0.0]), abs=0.05)
    assert hole.countersink_diameter_mm is None


def test_a_countersink_has_diameter_depth_and_angle(rng: np.random.Generator) -> None:
    reconstruction = scan(SKIN, (), rng)
    x, y = on_skin(reconstruction)
    r = np.hypot(x, y)
    slope = 1 / np.tan(np.radians(50))
    cone = np.where(r > 2.5, -(5.0 - r) * slope, -DEEP)
    reconstruction = darkened(moved(reconstruction, r < 5.0, cone), 0.0, 0.0, 2.5, deep=2.5 * slope)
    (hole,) = measure_holes(detect_fasteners(reconstruction).openings, reconstruction)
    assert hole.countersink_diameter_mm == pytest.approx(10.0, abs=0.2)
    assert hole.countersink_angle_deg == pytest.approx(100.0, abs=5.0)
    assert hole.countersink_depth_mm == pytest.approx(2.5 * slope, abs=0.25)
    assert hole.diameter_mm == pytest.approx(5.0, abs=0.3)


def test_an_edge_below_the_skin_is_no_plain_hole(rng: np.random.Generator) -> None:
    """A countersink whose cone the cloud does not show: its bore is 1.2 mm deep, one camera sees it left, one right."""
    reconstruction = scan(SKIN, (), rng)
    x, y = on_skin(reconstruction)
    reconstruction = darkened(moved(reconstruction, np.hypot(x, y) < 4.0, np.nan), 0.0, 0.0, 2.5, deep=1.2)
    (hole,) = measure_holes(detect_fasteners(reconstruction).openings, reconstruction)
    assert (hole.diameter_mm, hole.decision) == (None, "not measured")
    assert re.search(r"1\.[123] mm below the skin: a countersink", hole.reason)


def test_a_bore_below_a_broken_edge_is_narrower_by_up_to_twice_its_depth(rng: np.random.Generator) -> None:
    """Pictures show the edge 0.25 mm below the skin: at 45° the bore begins there, or as far below again."""
    reconstruction = scan(SKIN, (), rng)
    x, y = on_skin(reconstruction)
    reconstruction = darkened(moved(reconstruction, np.hypot(x, y) < 2.5, np.nan), 0.0, 0.0, 2.5, deep=0.25)
    (hole,) = measure_holes(detect_fasteners(reconstruction).openings, reconstruction)
    assert hole.diameter_mm == pytest.approx(4.75, abs=0.1)
    assert 0.25 < hole.diameter_u95_mm < 0.5


PIXEL_MM = 0.2


def edges_of(circles: list[tuple[float, float, float, int]], rng: np.random.Generator) -> tuple[Edges, np.ndarray]:
    """Edges of circles (x, y, radius, in so many directions of 72) as seen from the origin, and their radii there."""
    turn, directions, radii = np.arange(72) * (2 * np.pi / 72), [], []
    for x, y, radius, shown in circles:
        some = np.sort(rng.permutation(72)[:shown])
        along = x * np.cos(turn[some]) + y * np.sin(turn[some])
        directions.append(some)
        radii.append(along + np.sqrt(along**2 - x**2 - y**2 + radius**2) + rng.normal(0, 0.01, shown))
    direction, radius = np.concatenate(directions), np.concatenate(radii)
    x, y = radius * np.cos(turn[direction]), radius * np.sin(turn[direction])
    return Edges(x, y, direction, np.zeros(len(x)), 0.08), radius


@pytest.mark.parametrize(
    ("circles", "expected"),
    [
        ([(0.0, 0.0, 2.0, 69), (0.0, 0.0, 1.5, 70)], 2.0),
        ([(0.16, 0.12, 1.72, 60), (0.0, 0.0, 1.42, 64)], 1.72),  # the bore lies a pixel off the countersink's axis
        ([(0.0, 0.0, 2.0, 40), (0.0, 0.0, 1.5, 70)], 1.5),  # a shadow's border on the cone
    ],
)
def test_the_outermost_of_well_supported_circles_is_the_bore(
    circles: list[tuple[float, float, float, int]], expected: float, rng: np.random.Generator
) -> None:
    edges, radius = edges_of(circles, rng)
    radii = np.arange(2.8, 0.8, -0.25 * PIXEL_MM)
    bore = outermost(edges, radius, radii, PIXEL_MM)
    assert bore is not None
    assert bore.radius == pytest.approx(expected, abs=0.02)


def test_edges_of_no_circle_are_no_bore(rng: np.random.Generator) -> None:
    edges, radius = edges_of([(0.0, 0.0, 1.5, 15)], rng)
    assert outermost(edges, radius, np.arange(2.8, 0.8, -0.25 * PIXEL_MM), PIXEL_MM) is None


def test_a_steep_cone_down_to_the_ground_is_a_bent_wall() -> None:
    """Its border is not known well, but the skin's edge lies a pixel inside; a countersink ends above the ground."""
    cone = Countersink(8.94, 0.42, 1.81, 66.0)
    rim = RimCircle(0.0, 0.0, 4.1, 0.027, 72)
    assert smeared(cone, rim, 0.25, -1.86)
    assert not smeared(cone, rim, 0.25, -5.0)
    assert not smeared(cone, replace(rim, radius=4.46), 0.25, -1.86)


def test_a_wall_that_matching_bends_is_no_countersink(rng: np.random.Generator) -> None:
    reconstruction = scan(SKIN, (), rng)
    x, y = on_skin(reconstruction)
    away = np.hypot(x, y) - 2.5
    floor = -2.0 * np.clip(0.5 - away / 0.8, 0, 1)  # over four pixels
    reconstruction = darkened(moved(reconstruction, away < 1.0, floor), 0.0, 0.0, 2.5)
    (hole,) = measure_holes(detect_fasteners(reconstruction).openings, reconstruction)
    assert hole.countersink_diameter_mm is None
    assert hole.diameter_mm == pytest.approx(5.0, abs=0.05)


def test_a_dark_sheet_behind_a_hole_is_no_sunk_head(rng: np.random.Generator) -> None:
    reconstruction = scan(SKIN, (), rng)
    x, y = on_skin(reconstruction)
    behind = darkened(moved(reconstruction, np.hypot(x, y) < 4.0, -1.6), 0.0, 0.0, 4.0, share=0.75)
    (hole,) = measure_holes(detect_fasteners(behind).openings, behind)
    assert (hole.diameter_mm, hole.depth_mm) == pytest.approx((8.0, 1.6), abs=0.1)


def test_holes_of_bent_skin_are_found_where_noise_is_low(rng: np.random.Generator) -> None:
    """Smoothing cuts off more of the bend than noise is: the skin must not be left out for it."""
    bent = Skin(radius_x=700.0, radius_y=800.0, sigma_z=0.001)
    reconstruction = scan(bent, (), rng)
    places = [(-36.0, -20.0), (0.0, 22.0), (30.0, -18.0), (36.0, 20.0)]
    local = bent.frame.local(reconstruction.points.astype(float))
    for x, y in places:
        reconstruction = moved(reconstruction, np.hypot(local[..., 0] - x, local[..., 1] - y) < 4.0, -DEEP)
        reconstruction = darkened(reconstruction, x, y, 4.0)
    relief = ground_of(reconstruction, RivetSettings()).relief
    skin = relief.height[np.abs(relief.height) < 1.0]
    assert len(skin) > 0.9 * relief.height.size
    assert np.percentile(np.abs(skin - np.median(skin)), 95) < 0.25
    assert len(detect_fasteners(reconstruction).openings) == len(places)


def test_what_lies_behind_a_panel_does_not_bend_its_border(rng: np.random.Generator) -> None:
    bent = Skin(radius_x=500.0, radius_y=600.0, sigma_z=0.003)
    reconstruction = scan(bent, (), rng)
    points = reconstruction.points.copy()
    points[:90] *= 1.1  # 70 mm behind
    relief = ground_of(replace(reconstruction, points=points), RivetSettings()).relief
    assert np.nanpercentile(np.abs(relief.height[24:]), 95) < 0.05


@pytest.mark.parametrize("deep", [0.0, 0.6, 1.5])
def test_a_circle_of_edges_tells_how_deep_it_lies(rng: np.random.Generator, deep: float) -> None:
    turn = np.tile(np.arange(72) * np.pi / 36, 2)
    eyes = np.repeat([[-150.0, 0.0, 700.0], [150.0, 10.0, 690.0]], 72, axis=0)
    seen = 4.0 - 0.5 * 0.2**2 / 4.0 + deep * leans(np.full(144, 4.0), turn, eyes) + rng.normal(0, 0.01, 144)
    edges = Edges(
        seen * np.cos(turn), seen * np.sin(turn), np.tile(np.arange(72), 2), leans(seen, turn, eyes), 0.08, 1.0
    )
    circle = rim_circle(edges, 0.2)
    assert circle.deeper == pytest.approx(deep, abs=0.1)
    assert circle.radius == pytest.approx(4.0, abs=0.01)
    assert (circle.radius_sd > 0.1) == (deep > 0)


def test_one_camera_does_not_tell_how_deep_a_circle_lies(rng: np.random.Generator) -> None:
    turn = np.arange(72) * np.pi / 36
    r = 4.0 + rng.normal(0, 0.01, 72)
    lean = leans(r, turn, np.array([-150.0, 0.0, 700.0]))
    circle = rim_circle(Edges(r * np.cos(turn), r * np.sin(turn), np.arange(72), lean, 0.08), 0.2)
    assert circle.deeper == 0.0
    assert circle.radius_sd < 0.03


@pytest.mark.parametrize(("times", "holes"), [(1.2, 0), (0.4, 1)])
def test_a_piece_of_a_gap_is_no_hole_and_a_hole_across_a_seam_is_one(
    rng: np.random.Generator, times: float, holes: int
) -> None:
    reconstruction = scan(SKIN, (Head(-30, 10), Head(30, 10)), rng)
    x, y = on_skin(reconstruction)
    reconstruction = darkened(moved(reconstruction, np.hypot(x - 2, y + 5) < 4.0, -DEEP), 2.0, -5.0, 4.0)
    found = detect_fasteners(reconstruction)
    (opening,) = found.openings
    course = np.stack([np.full(401, opening.ellipse.u), opening.ellipse.v + np.linspace(-200, 200, 401)], axis=1)
    seam = SeamLine("S01", course, np.full(401, times * 2 * opening.ellipse.b), 0.9, relief=True)
    rows = measure_sighted(Sighted(reconstruction, found.rivets, [seam], {}, found.openings), None)
    assert len(rows) == holes


def test_paint_and_sunk_heads_are_no_holes(rng: np.random.Generator) -> None:
    heads = (Head(-30, 0, height=-1.0), Head(30, 0, height=-0.3))
    painted = darkened(scan(SKIN, heads, rng), 0.0, 0.0, 4.0, share=0.75)
    assert detect_fasteners(painted).openings == []


def test_black_paint_without_points_is_unconfirmed(rng: np.random.Generator) -> None:
    reconstruction = scan(SKIN, (), rng)
    x, y = on_skin(reconstruction)
    black = darkened(moved(reconstruction, np.hypot(x, y) < 4.0, np.nan), 0.0, 0.0, 4.0, share=0.75)
    (hole,) = measure_holes(detect_fasteners(black).openings, black)
    assert hole.decision == "unconfirmed"
    assert "paint" in hole.reason


def test_a_temporary_fastener_is_named_and_not_measured(rng: np.random.Generator) -> None:
    reconstruction = scan(SKIN, (), rng)
    x, y = on_skin(reconstruction)
    proud = moved(reconstruction, np.hypot(x, y) < 4.0, 8.0)
    found = detect_fasteners(proud)
    assert found.rivets == []
    (hole,) = judge(HOLE, measure_holes(found.openings, proud), PanelSpec("P", "A"))
    assert (hole.kind, hole.decision, hole.diameter_mm) == ("temporary fastener", "not measured", None)


def test_a_temporary_fastener_is_named_where_its_shadow_lies_beside_it(rng: np.random.Generator) -> None:
    reconstruction = scan(SKIN, (), rng)
    x, y = on_skin(reconstruction)
    body = np.hypot(x, y) < 4.0
    shadowed = moved(moved(reconstruction, body, 8.0), (np.abs(y) < 4.0) & (x > 0) & (x < 9.0) & ~body, np.nan)
    (opening,) = detect_fasteners(shadowed).openings
    assert opening.inside_mm == pytest.approx(8.0, abs=0.5)
    middle = reconstruction.rig.left.project(SKIN.frame.rig([0.0, 0.0, 0.0]))
    assert [opening.ellipse.u, opening.ellipse.v] == pytest.approx(middle, abs=3.0)


def test_saturated_skin_is_no_hole(rng: np.random.Generator) -> None:
    reconstruction = scan(SKIN, (), rng)
    x, y = on_skin(reconstruction)
    bright = np.hypot(x, y) < 4.0
    flags = np.where(bright, np.uint16(PixelFlag.SATURATED), reconstruction.flags)
    assert detect_fasteners(replace(moved(reconstruction, bright, np.nan), flags=flags)).openings == []


def test_a_hole_beside_skin_that_the_other_camera_sees_too_bright_is_found(rng: np.random.Generator) -> None:
    """Grain makes stripes of skin without a counterpart; they are as bright as the skin that has one."""
    reconstruction = scan(SKIN, (), rng)
    x, y = on_skin(reconstruction)
    hole = np.hypot(x, y) < 4.0
    columns = np.arange(hole.shape[1]) % 12 < 8
    reconstruction = darkened(moved(reconstruction, (columns & (y > -2.0)) | hole, np.nan), 0.0, 0.0, 4.0)
    (found,) = measure_holes(detect_fasteners(reconstruction).openings, reconstruction)
    assert found.diameter_mm == pytest.approx(8.0, abs=0.1)


def test_a_round_recess_is_no_hole(rng: np.random.Generator) -> None:
    """The same hole without a head round it is one; so is a countersink with a ring at its border."""
    reconstruction = scan(SKIN, (Head(0, 0, 6.4, 0.05),), rng)
    x, y = on_skin(reconstruction)
    r = np.hypot(x, y)
    recessed = darkened(moved(reconstruction, r < 1.6, -1.8), 0.0, 0.0, 1.6, deep=0.0)
    (head,) = detect_fasteners(recessed).rivets
    assert detect_fasteners(recessed).openings == []
    assert head.major_px == pytest.approx(6.4 * 5, rel=0.05)
    sunk = np.where(r < 1.6, -1.8, -(3.2 - r) / np.tan(np.radians(50)) - 0.05)
    countersunk = darkened(moved(reconstruction, r < 3.2, sunk), 0.0, 0.0, 1.6)
    found = detect_fasteners(countersunk)
    assert found.rivets == []
    assert len(found.openings) == 1


def test_a_countersink_is_found_about_its_own_axis(rng: np.random.Generator) -> None:
    """A chip that lies in a countersink moves the middle of what is open by more than a cone allows."""
    reconstruction = scan(SKIN, (), rng)
    nothing = np.zeros(reconstruction.flags.shape, bool)
    patch = cut_patch(truth_detection(reconstruction, SKIN, Head(0.4, 0.0, 11.0)), (), reconstruction,
                      blocked_pixels(reconstruction), nothing, RivetSettings())  # fmt: skip
    assert not isinstance(patch, str)
    away = np.hypot(patch.x + 0.4, patch.y)
    height = np.where(away < 2.0, np.nan, np.where(away < 5.0, (away - 5.0) / np.tan(np.radians(50)), 0.0))
    assert countersink(np.hypot(patch.x, patch.y), height, 0.2, 7.0) is None
    cone, axis = about_its_axis(RimCircle(-0.4, 0.0, 5.0, 0.05, 70), patch, height, 0.2, 7.0)
    assert axis == (-0.4, 0.0)
    assert cone is not None
    assert cone.angle_deg == pytest.approx(100.0, abs=3.0)
    assert cone.diameter_mm == pytest.approx(10.0, abs=0.2)


def test_an_open_hole_is_a_finding_unless_a_limit_asks_for_it() -> None:
    hole = Hole("H01", x_mm=0.0, y_mm=0.0, z_mm=700.0, u_px=1.0, v_px=2.0, kind="open hole", diameter_mm=8.02,
                diameter_u95_mm=0.06)  # fmt: skip
    (found,) = judge(HOLE, [hole], PanelSpec("P", "A"))
    assert (found.decision, found.reason) == ("conditional fail", "open hole of 8.0 mm where no limit asks for one")
    assert found.severity is None  # outside of nothing: drawn as what has no limit
    asked = PanelSpec("P", "A", {"default": {"hole_diameter_mm": Limit(lower=7.9, upper=8.2)}})
    assert judge(HOLE, [hole], asked)[0].decision == "pass"


def test_a_hole_where_the_pattern_has_a_rivet_is_a_missing_fastener() -> None:
    hole = Hole("H01", x_mm=0.0, y_mm=0.0, z_mm=700.0, u_px=1.0, v_px=2.0, kind="open hole", diameter_mm=8.02,
                x_panel_mm=10.4, y_panel_mm=5.0, z_panel_mm=0.0)  # fmt: skip
    (named,) = missing_fasteners([hole], [NominalRivet("R05", (10.0, 5.0, 0.0), 8.0), NominalRivet("R06", (40, 5, 0))])
    (judged,) = judge(HOLE, [named], PanelSpec("P", "A"))
    assert (judged.kind, judged.fastener_id, judged.decision) == ("missing fastener", "R05", "fail")
    assert judged.reason == "missing fastener R05: open hole of 8.0 mm"
    (elsewhere,) = missing_fasteners([hole], [NominalRivet("R06", (40.0, 5.0, 0.0), 8.0)])
    assert elsewhere == hole
    absent = Rivet("R05", x_mm=None, y_mm=None, z_mm=None, u_px=1.0, v_px=2.0, u_right_px=None, v_right_px=None,
                   diameter_mm=8.0, major_px=1.0, minor_px=1.0, angle_deg=0.0, confidence=0.0,
                   reason="missing: no head found where the pattern has one")  # fmt: skip
    assert explained([absent], [named])[0].reason == "missing: open hole of 8.0 mm (H01)"

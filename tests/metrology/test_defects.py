"""Dents, bumps and steps on clouds of known truth: what is found, how deep it is, and what is no defect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from metrology.cloud import PixelFlag, Reconstruction
from metrology.defects.cells import _steep
from metrology.defects.measure import measure_defects
from metrology.defects.row import Defect, DefectKind
from metrology.fits import FittedDefect
from metrology.kinds import DEFECT
from metrology.limits import Limit, PanelSpec
from metrology.panel import NominalRivet, NominalSeam, PanelLayout, Placement
from metrology.registration import Registration, with_others
from metrology.registration.known import with_known_names
from metrology.results import Rivet, RivetDetection, SeamLine, SeamStation
from metrology.sighted import Sighted
from metrology.tolerance import as_measured, judge
from tests.support.rivet_scan import Head, Skin, scan

CURVED = Skin(radius_x=400.0, radius_y=900.0, sigma_z=0.012, correlated_px=0.8)
FLAT = replace(CURVED, radius_x=np.inf, radius_y=np.inf)
Heights = Callable[[np.ndarray, np.ndarray], np.ndarray]


def bowl(x: float, y: float, depth: float, length: float, width: float, turn_deg: float = 0.0) -> Heights:
    """A cos² bowl with its axes at half depth."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))

    def height(px: np.ndarray, py: np.ndarray) -> np.ndarray:
        dx, dy = px - x, py - y
        r = np.hypot((c * dx + s * dy) / (0.5 * length), (c * dy - s * dx) / (0.5 * width))
        return np.asarray(-depth * np.cos(0.25 * np.pi * np.minimum(r, 2.0)) ** 2)

    return height


def bent(cloud: Reconstruction, skin: Skin, *heights: Heights) -> Reconstruction:
    """The cloud with heights added."""
    local = skin.frame.local(np.asarray(cloud.points, float))
    x, y = local[..., 0].copy(), local[..., 1].copy()
    for height in heights:
        local[..., 2] += height(x, y)
    return replace(cloud, points=skin.frame.rig(local).astype(np.float32))


def sighted(cloud: Reconstruction, skin: Skin, heads: tuple[Head, ...] = (), seam_x: float | None = None) -> Sighted:
    """The scan with its heads and a straight seam where they are."""
    detections, rivets, lines, stations = [], [], [], []
    for k, head in enumerate(heads):
        place = skin.frame.rig([head.x, head.y, skin.height(np.array(head.x), np.array(head.y))])
        u, v = (float(c) for c in cloud.rig.left.project(place))
        across = head.diameter * 5.0
        detections.append(RivetDetection(u, v, across, across, 0.0, 1.0))
        x, y, z = (float(c) for c in place)
        rivets.append(
            Rivet(f"R{k}", x_mm=x, y_mm=y, z_mm=z, u_px=u, v_px=v, u_right_px=None, v_right_px=None, confidence=1.0,
                  diameter_mm=head.diameter, major_px=across, minor_px=across, angle_deg=0.0)
        )  # fmt: skip
    if seam_x is not None:
        y = np.linspace(-60, 60, 121)
        places = skin.frame.rig(np.stack([np.full_like(y, seam_x), y, skin.height(np.full_like(y, seam_x), y)], axis=1))
        course = cloud.rig.left.project(places)
        inside = cloud.rig.left.inside(course)
        lines.append(SeamLine("S01", course[inside], np.full(inside.sum(), 8.0), 1.0, relief=True))
        stations = [
            SeamStation("S01", float(k), x_mm=p[0], y_mm=p[1], z_mm=p[2], u_px=q[0], v_px=q[1], width_mm=1.0)
            for k, (p, q) in enumerate(zip(places[inside].tolist(), course[inside].tolist(), strict=True))
        ]
    return Sighted(cloud, detections, lines, {"rivet": rivets, "seam station": stations})


@pytest.mark.parametrize("skin", [FLAT, CURVED], ids=["flat", "0.4 m"])
@pytest.mark.parametrize(("depth", "length", "width"), [(0.05, 18.0, 15.0), (-0.1, 14.0, 14.0), (0.6, 24.0, 16.0)])
def test_depth_and_extents_are_true(
    rng: np.random.Generator, skin: Skin, depth: float, length: float, width: float
) -> None:
    cloud = bent(scan(skin, (), rng), skin, bowl(5.0, -4.0, depth, length, width, 30.0))
    (found,) = measure_defects(sighted(cloud, skin))
    assert found.kind == ("dent" if depth > 0 else "bump")
    assert found.depth_mm is not None
    assert found.depth_u95_mm is not None
    assert abs(found.depth_mm - depth) < max(0.005, 0.03 * abs(depth))
    assert abs(found.depth_mm - depth) < 1.5 * found.depth_u95_mm < 0.02
    assert found.length_mm == pytest.approx(length, rel=0.05)
    assert found.width_mm == pytest.approx(width, rel=0.06)
    volume = np.pi * length * width / 4 * depth * 4 * (0.5 - 2 / np.pi**2)
    assert found.volume_mm3 == pytest.approx(volume, rel=0.1)
    assert found.hidden_by is None
    vague = found.bottom_radius_mm is None
    assert (found.reason == "bottom radius not measured: it may be sharper than the points show") == vague
    if not vague:
        bottom = 2 * width**2 / (np.pi**2 * abs(depth))
        assert abs((found.bottom_radius_mm or 0.0) - bottom) < (found.bottom_radius_u95_mm or 0.0) < 0.5 * bottom
    assert (found.straight_edge_depth_mm is None) == (depth < 0)


def pointed(x: float, y: float, depth: float, length: float, width: float, fold: bool) -> Heights:
    """(1 − ρ/r)², at half depth at ρ = 1: a cone's point, or a fold along the length with cos² ends."""
    r = 1 / (1 - np.sqrt(0.5))

    def height(px: np.ndarray, py: np.ndarray) -> np.ndarray:
        p, q = np.abs(px - x) / (0.5 * length), np.abs(py - y) / (0.5 * width)
        rho = q if fold else np.hypot(p, q)
        along = np.cos(0.25 * np.pi * np.minimum(p, 2.0)) ** 2 if fold else 1.0
        return np.asarray(-depth * along * np.maximum(1 - rho / r, 0.0) ** 2)

    return height


@pytest.mark.parametrize("fold", [False, True], ids=["point", "fold"])
def test_a_pointed_bottom_is_as_deep_as_it_is(rng: np.random.Generator, fold: bool) -> None:
    cloud = bent(scan(FLAT, (), rng), FLAT, pointed(3.0, -4.0, 0.25, 22.0, 13.0, fold))
    (found,) = measure_defects(sighted(cloud, FLAT))
    assert found.depth_mm == pytest.approx(0.25, abs=0.0075)
    assert abs((found.depth_mm or 0.0) - 0.25) < (found.depth_u95_mm or 0.0) < 0.02
    assert found.bottom_radius_mm is None  # smaller than points show
    assert found.length_mm == pytest.approx(22.0, rel=0.035)  # a fold's outline has corners where it is longest
    assert found.width_mm == pytest.approx(13.0, rel=0.035)


def test_u95_covers_shallow_points_that_look_like_bowls_and_round_ones() -> None:
    depth = 0.06
    covered, u95 = np.zeros(2, int), np.zeros((2, 6))
    for seed in range(6):
        rng = np.random.default_rng([22, seed])
        shapes = pointed(3.0, -4.0, depth, 9.0, 7.0, False), bowl(3.0, -4.0, depth, 9.0, 7.0)
        for k, shape in enumerate(shapes):
            (found,) = measure_defects(sighted(bent(scan(FLAT, (), rng), FLAT, shape), FLAT))
            u95[k, seed] = found.depth_u95_mm or 0.0
            covered[k] += abs((found.depth_mm or 0.0) - depth) <= u95[k, seed]
    assert covered.min() >= 5  # of the point three before its flanks were looked at
    assert u95.mean(axis=1).max() < 0.18 * depth


@pytest.mark.parametrize("depth", [0.15, 0.3])
def test_a_scratch_has_a_depth_where_it_is_wide_enough_and_is_a_line_else(
    rng: np.random.Generator, depth: float
) -> None:
    def groove(width: float) -> Heights:
        def height(px: np.ndarray, py: np.ndarray) -> np.ndarray:
            off = np.hypot(np.maximum(np.abs(px - 3.0) - 15.0, 0.0), py + 4.0) / (0.5 * width)
            return np.asarray(-depth * np.cos(0.25 * np.pi * np.minimum(off, 2.0)) ** 2)

        return height

    bare = scan(FLAT, (), rng)
    (wide,) = measure_defects(sighted(bent(bare, FLAT, groove(2.0)), FLAT))
    assert wide.kind == "scratch"
    assert abs((wide.depth_mm or 0.0) - depth) < max(wide.depth_u95_mm or 0.0, 0.1 * depth)
    assert wide.length_mm == pytest.approx(30.0, rel=0.15)
    (narrow,) = measure_defects(sighted(bent(bare, FLAT, groove(0.5)), FLAT))
    assert narrow.kind == "scratch"
    assert narrow.depth_mm is None
    assert narrow.decision == "not measured"
    assert "line without measurable depth" in (narrow.reason or "")


def test_two_defects_whose_feet_meet_are_two(rng: np.random.Generator) -> None:
    large, small = bowl(-12.0, 0.0, 0.4, 24.0, 24.0), bowl(16.0, 4.0, 0.1, 9.0, 8.0)
    found = measure_defects(sighted(bent(scan(FLAT, (), rng), FLAT, large, small), FLAT))
    depths = sorted(defect.depth_mm or 0.0 for defect in found)
    assert depths == pytest.approx([0.1, 0.4], abs=0.01)


@pytest.mark.parametrize(("deep", "shallow", "apart"), [(0.4, 0.1, 23.0), (0.3, 0.2, 20.0)])
def test_a_shallow_defect_within_the_foot_of_a_deeper_one_is_one_of_its_own(
    rng: np.random.Generator, deep: float, shallow: float, apart: float
) -> None:
    """Depth is what both have made of the skin, and the outline of the shallower one ends at the ridge between them."""
    both = bowl(-12.0, 0.0, deep, 20.0, 20.0), bowl(apart - 12.0, 4.0, shallow, 10.0, 9.0)
    found = measure_defects(sighted(bent(scan(FLAT, (), rng), FLAT, *both), FLAT))
    small, large = sorted(found, key=lambda defect: defect.depth_mm or 0.0)
    assert large.depth_mm == pytest.approx(deep, abs=0.005)
    assert large.length_mm == pytest.approx(20.0, rel=0.03)
    assert shallow - 0.005 < (small.depth_mm or 0.0) < 1.1 * shallow
    assert 8.0 < (small.width_mm or 0.0) <= (small.length_mm or 0.0) < 15.0


def test_a_rough_bottom_is_one(rng: np.random.Generator) -> None:
    large, small = bowl(0.0, 0.0, 0.3, 30.0, 26.0), [bowl(x, 0.0, 0.04, 4.0, 4.0) for x in (-8.0, 8.0)]
    (found,) = measure_defects(sighted(bent(scan(FLAT, (), rng), FLAT, large, *small), FLAT))
    assert found.length_mm == pytest.approx(30.0, rel=0.04)


def test_a_raised_edge_is_a_bump_at_a_seam(rng: np.random.Generator) -> None:
    def edge(px: np.ndarray, py: np.ndarray) -> np.ndarray:
        away = np.where(px > -10.0, (px + 10.0) / 9.0, 2.0)
        return np.asarray(0.3 * np.exp(-0.5 * (away**2 + ((py - 5.0) / 12.0) ** 2)) * (away < 2.5))

    (found,) = measure_defects(sighted(bent(scan(FLAT, (), rng), FLAT, edge), FLAT, seam_x=-10.0))
    assert found.kind == "raised edge"
    assert found.length_mm is not None
    assert found.length_u95_mm is None  # beyond the seam it may go on
    assert "seam" in (found.reason or "")
    assert found.seam_distance_mm == pytest.approx(0.0, abs=1.5)


@pytest.mark.parametrize("skin", [FLAT, CURVED], ids=["flat", "0.4 m"])
def test_bare_skin_with_heads_has_none(rng: np.random.Generator, skin: Skin) -> None:
    heads = (Head(-30, 10), Head(30, 10, height=-0.15), Head(0, -20, height=0.3))
    assert measure_defects(sighted(scan(skin, heads, rng), skin, heads)) == []


def test_a_step_that_changes_along_a_seam_is_no_dent_and_hides_none(rng: np.random.Generator) -> None:
    def step(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where(x > -10, 0.1 * np.interp(y, [-60, -30, -10, 12, 30, 60], [0, 1, -1, 2, 0, 1]), 0.0)

    bare = bent(scan(CURVED, (), rng), CURVED, step)
    assert measure_defects(sighted(bare, CURVED, seam_x=-10.0)) == []
    cloud = bent(bare, CURVED, bowl(25.0, 5.0, 0.12, 16.0, 14.0))
    (found,) = measure_defects(sighted(cloud, CURVED, seam_x=-10.0))
    assert found.depth_mm == pytest.approx(0.12, abs=0.006)
    assert found.seam_distance_mm == pytest.approx(35.0 - 8.0 - 0.5, abs=1.5)


def test_what_runs_out_of_view_is_at_least_that_deep(rng: np.random.Generator) -> None:
    skin = FLAT
    cloud = bent(scan(skin, (), rng), skin, bowl(62.0, 0.0, 0.4, 30.0, 30.0))
    (found,) = measure_defects(sighted(cloud, skin))
    assert found.hidden_by == "view"
    assert "at least" in (found.reason or "")
    (judged,) = judge(DEFECT, [found], PanelSpec("P", "1", {"default": {"defect_depth_mm": Limit(upper=2.0)}}))
    assert judged.decision == "not measured"
    (judged,) = judge(DEFECT, [found], PanelSpec("P", "1", {"default": {"defect_depth_mm": Limit(upper=0.05)}}))
    assert judged.decision == "fail"


def test_a_fasteners_own_pull_in_is_no_dent_unless_it_stands_out(rng: np.random.Generator) -> None:
    heads = tuple(Head(x, y) for x in (-35.0, 0.0, 35.0) for y in (-20.0, 20.0))
    usual = [bowl(head.x, head.y, 0.05, 12.0, 12.0) for head in heads]
    cloud = bent(scan(FLAT, heads, rng), FLAT, *usual)
    assert measure_defects(sighted(cloud, FLAT, heads)) == []
    deeper = bent(cloud, FLAT, bowl(heads[2].x, heads[2].y, 0.4, 16.0, 16.0))
    (found,) = measure_defects(sighted(deeper, FLAT, heads))
    assert found.fastener_distance_mm == 0.0


def test_limits_judge_depth_ratio_and_distance(rng: np.random.Generator) -> None:
    cloud = bent(scan(FLAT, (), rng), FLAT, bowl(0.0, 0.0, 0.3, 20.0, 15.0))
    (found,) = measure_defects(sighted(cloud, FLAT))

    def judged(**limits: Limit) -> Defect:
        return judge(DEFECT, [found], PanelSpec("P", "1", {"default": limits}))[0]

    def decision(**limits: Limit) -> str:
        return judged(**limits).decision

    assert decision(defect_depth_mm=Limit(upper=0.5, lower=-0.5)) == "pass"
    assert decision(defect_depth_mm=Limit(upper=0.2, lower=-0.2)) == "fail"
    assert decision(defect_width_to_depth=Limit(lower=30.0)) == "pass"
    assert decision(defect_width_to_depth=Limit(lower=100.0)) == "fail"
    # No fastener in view, so that this limit says nothing of it: an inspector must not miss it for that.
    assert decision(defect_fastener_distance_mm=Limit(lower=10.0)) == "conditional fail"
    unlimited = judged()
    assert unlimited.severity is None  # outside of nothing: drawn as what has no limit
    assert unlimited.reason == "dent without a limit that judges it: to be decided"
    assert as_measured(DEFECT, unlimited) == found


def test_points_matched_by_chance_do_not_lower_a_small_dent(rng: np.random.Generator) -> None:
    cloud = bent(scan(FLAT, (), rng), FLAT, bowl(0.0, 0.0, 0.08, 10.0, 9.0))
    points = cloud.points.copy()
    u, v = np.rint(cloud.rig.left.project(FLAT.frame.rig([1.0, 1.0, 0.0]))).astype(int)
    points[v, u] *= 1 + 3.0 / 700
    (found,) = measure_defects(sighted(replace(cloud, points=points), FLAT))
    assert found.depth_mm == pytest.approx(0.08, abs=0.008)
    assert found.length_mm == pytest.approx(10.0, rel=0.1)


def test_a_defect_is_judged_by_the_zone_of_what_is_nearest() -> None:
    layout = PanelLayout(
        rivets=(NominalRivet("R01", (0.0, 0.0, 0.0), zone="row"),),
        seams=(NominalSeam("S01", ((50.0, 0.0, 0.0), (50.0, 80.0, 0.0)), "edge", stretches=((40.0, 80.0, "corner"),)),),
    )
    place = Placement(np.eye(3), np.zeros(3))
    rows = [
        Defect(f"D{k}", x_mm=x, y_mm=y, z_mm=0.0, u_px=0.0, v_px=0.0, kind="dent")
        for k, (x, y) in enumerate([(10.0, 0.0), (45.0, 10.0), (52.0, 70.0)])
    ]
    found = with_others(Registration("recognised", place, (), ()), {DEFECT.name: rows}, layout)
    assert [row.zone for row in found.others[DEFECT.name]] == ["row", "edge", "corner"]


def test_defects_keep_their_names_from_scan_to_scan() -> None:
    def defect(name: str, x: float, kind: DefectKind = "dent", length: float = 20.0) -> Defect:
        return Defect(
            name, x_mm=None, y_mm=None, z_mm=None, u_px=0.0, v_px=0.0, kind=kind, length_mm=length,
            x_panel_mm=x, y_panel_mm=0.0, z_panel_mm=0.0,
        )  # fmt: skip

    earlier = [defect("D01", 0.0), defect("D02", 100.0), defect("D04", 200.0), defect("D01", 500.0)]
    rows = [defect("D01", 104.0), defect("D02", 2.0, "bump"), defect("D03", -4.0), defect("D04", 212.0)]
    named = with_known_names(rows, earlier)
    # A bump where a dent was is another; 12 mm away at 20 mm of length is another, too.
    assert {row.defect_id: row.x_panel_mm for row in named} == {"D01": -4.0, "D02": 104.0, "D05": 2.0, "D06": 212.0}
    assert [row.defect_id for row in with_known_names(rows, [])] == ["D01", "D02", "D03", "D04"]


def test_the_form_of_a_defect_is_its_map_and_two_sections(rng: np.random.Generator) -> None:
    """Across a cylinder the straight-edge lies level on the rims, and the gap under it is less than the depth."""
    skin = replace(FLAT, radius_x=400.0)
    cloud = bent(scan(skin, (), rng), skin, bowl(4.0, 2.0, 0.5, 24.0, 14.0, 0.0))
    (found,) = measure_defects(sighted(cloud, skin))
    assert isinstance(found, FittedDefect)
    form, depth = found.form, found.depth_mm
    assert form is not None
    assert depth is not None
    assert np.nanmin(form.heights) == pytest.approx(-depth, abs=0.03)
    row, column = np.unravel_index(int(np.nanargmin(form.heights)), form.heights.shape)
    middle = np.array(form.corner) + form.step_mm * np.array([column, row])
    assert np.hypot(*middle) < 3.0
    assert 2 * np.hypot(*form.outline.T).max() == pytest.approx(found.length_mm, rel=0.15)
    for section, extent in zip(form.shown(), (24.0, 14.0), strict=True):
        deep = section.t[section.skin - section.surface > 0.5 * depth]
        assert np.ptp(deep) == pytest.approx(extent, rel=0.1)
        assert section.edge[np.abs(section.t) < 5.0] == pytest.approx(0.0, abs=1e-6)
        assert section.surface.max() == pytest.approx(0.0, abs=1e-6)
    # Over the round of the cylinder a straight-edge bridges little of it; along its line nearly all.
    assert form.along.gap(5.0) < 0.5 * depth < 0.9 * depth < form.across.gap(5.0) < 1.02 * depth


@pytest.mark.parametrize("gap", [0, 24], ids=["at once", "with few points between"])
def test_what_lies_behind_the_panels_end_is_no_dent(rng: np.random.Generator, gap: int) -> None:
    """39 mm behind it; in a strip beside the end a few pixels were matched by chance."""
    cloud = scan(FLAT, (), rng)
    points, flags = cloud.points.copy(), cloud.flags.copy()
    points[:60] *= 1 + 39.0 / 700.0
    strip = np.s_[60 - gap : 60]
    flags[strip] |= np.uint16(PixelFlag.EDGE)
    flags[44:48, 200:204] = flags[52:56, 400:404] = 0
    assert measure_defects(sighted(replace(cloud, points=points, flags=flags), FLAT)) == []
    # A few points on the way down, and it is one piece with the skin.
    flags[strip][:, 300:340] = 0
    points[strip] *= 1 + np.linspace(39.0, 0.0, gap)[:, None, None] / 700.0
    assert measure_defects(sighted(replace(cloud, points=points, flags=flags), FLAT)) == []


def test_a_flank_is_no_defect_of_its_own(rng: np.random.Generator) -> None:
    cloud = bent(scan(FLAT, (), rng), FLAT, bowl(-8.0, 0.0, 0.5, 24.0, 18.0), bowl(10.0, 0.0, 0.1, 10.0, 8.0))
    for found in measure_defects(sighted(cloud, FLAT, seam_x=1.0)):
        assert found.kind == "dent"  # what a seam cuts off is no crease
        assert found.depth_u95_mm is not None
        assert found.depth_u95_mm < 0.5 * (found.depth_mm or 0.0)


@pytest.mark.parametrize("share", [0.25, 0.35, 0.45])
def test_a_scan_of_scattered_points_ends_without_a_crash(rng: np.random.Generator, share: float) -> None:
    """Half as many points as a fine grid asks for: the dent is measured from what there is, or left out."""
    cloud = bent(scan(FLAT, (), rng), FLAT, bowl(5.0, -4.0, 0.3, 12.0, 10.0))
    points = np.where(rng.random(cloud.flags.shape)[..., None] < share, cloud.points, np.nan).astype(np.float32)
    flags = np.where(np.isfinite(points[..., 2]), cloud.flags, np.uint16(PixelFlag.UNMATCHED))
    for found in measure_defects(sighted(replace(cloud, points=points, flags=flags), FLAT)):
        assert found.depth_mm is None or abs(found.depth_mm - 0.3) < 0.06


def test_where_no_two_points_are_neighbours_nothing_is_steep() -> None:
    assert not _steep(np.full((64, 64, 3), np.nan)).any()


def test_a_foot_that_the_reference_follows_makes_a_depth_at_least_that(rng: np.random.Generator) -> None:
    cloud = bent(scan(FLAT, (), rng), FLAT, pointed(3.0, -4.0, 0.1, 40.0, 38.0, False))
    (found,) = measure_defects(sighted(cloud, FLAT))
    assert (found.depth_mm or 1.0) < 0.08
    assert found.hidden_by == "reference"
    assert "its depth and extents are at least these" in (found.reason or "")
    assert judge(DEFECT, [found], PanelSpec("P", "1", {}))[0].decision == "not measured"


def test_a_foot_that_bends_even_a_wider_reference_makes_a_depth_at_least_that(rng: np.random.Generator) -> None:
    """Half as much more round it not taken for skin moves nothing: the polynomial is bent under it all the same."""
    cloud = bent(scan(FLAT, (), rng), FLAT, pointed(3.0, -4.0, 0.1, 64.0, 60.0, False))
    found = max(measure_defects(sighted(cloud, FLAT)), key=lambda row: row.depth_mm or 0.0)
    assert (found.depth_mm or 1.0) < 0.08
    assert found.hidden_by == "reference"

"""Seam measurement: section geometry, the gap as two cameras see it, the paper's piecewise fit, the reference scans."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from metrology.errors import UsageError
from metrology.seams import SeamSettings, detect_seams, measure_seams
from metrology.seams.blur import EdgeResponse, PixelBlur, blurred_steps
from metrology.seams.gap import floor, model, shape, solver
from metrology.seams.gap.fit import fit_gap
from metrology.seams.gap.floor import Floor, possible_floors
from metrology.seams.gap.levels import courses
from metrology.seams.gap.piecewise import fit_pieces, project_onto, side_of_section
from metrology.seams.gap.prior import LEAN_CHANGE, Prior
from metrology.seams.gap.width import GapEdge, gap_width
from metrology.seams.skins.other_seams import beyond
from metrology.seams.skins.sections import Section, SkinLine
from metrology.seams.skins.skin_lines import fit_skin_lines
from metrology.seams.skins.step import step_height
from metrology.seams.skins.track import lay_on_skin
from metrology.surfaces import Frame
from tests.support import gap_render
from tests.support.gap_render import Gap, profiles, seen
from tests.support.seam_scan import SHAPE, seam_scan

# Columns of the basis that change a region's brightness and are none.
CHANGES = [model.SLOPE_A, model.SLOPE_B, model.SKY]


def chamfered_section(width, step, chamfer, noise, rng):
    """Points of a gap with walls, 45° chamfers and a floor 2.5 mm down; side B is `step` higher."""
    x = np.sort(rng.uniform(-12, 12, 1200))
    half = width / 2
    a = -np.clip(x + half + chamfer, 0, chamfer)
    b = step - np.clip(half + chamfer - x, 0, chamfer)
    y = np.where(x < -half, a, np.where(x > half, b, -2.5))
    return x, y + rng.normal(0, noise, x.size)


@pytest.mark.parametrize(("width", "step", "chamfer"), [(2.3, 0.1, 0.3), (3.0, -0.4, 0.5), (2.0, 0.25, 0.0)])
def test_paper_s_procedure_on_exact_sections(width, step, chamfer):
    x, y = chamfered_section(width, step, chamfer, 0.01, np.random.default_rng(3))
    a = side_of_section(x, y, 0.05, np.deg2rad(20))
    b = side_of_section(-x[::-1], y[::-1], 0.05, np.deg2rad(20))
    assert a is not None
    assert b is not None
    (x_a, height_a), (x_b, height_b) = project_onto(a), project_onto(b)
    assert height_b - height_a == pytest.approx(step, abs=0.01)
    # Both corners are free within the tolerance: the method is that coarse, which is why it is not the default.
    assert -x_b - x_a == pytest.approx(width, abs=3 * 0.05)


def test_pieces_keep_to_the_tolerance():
    rng = np.random.default_rng(4)
    x, y = chamfered_section(2.0, 0.2, 0.3, 0.005, rng)
    pieces = fit_pieces(x, y, 0.05)
    assert pieces[0].first == 0
    assert pieces[-1].end == len(x)
    assert all(p.end == q.first for p, q in itertools.pairwise(pieces))


def section(step, slope=0.0):
    """Two parallel skins, B higher by `step` along their normal, in a frame tilted by `slope`."""
    rise = step * np.hypot(1.0, slope)
    frame = Frame(np.zeros(3), np.eye(3))
    a, b = SkinLine(np.array([0.0, slope, 0.0]), 100), SkinLine(np.array([rise, slope, 0.0]), 100)
    return Section(frame, a, b, np.eye(5) * 1e-6, 1.0)


@pytest.mark.parametrize("slope", [0.0, 0.1, -0.3])
def test_step_is_signed_and_blind_to_the_frame_s_tilt(slope):
    assert step_height(section(0.2, slope), -1.2, 1.2) == pytest.approx(0.2)
    assert step_height(section(-0.2, slope), -1.2, 1.2) == pytest.approx(-0.2)


def test_width_is_measured_along_the_skin():
    a, b = GapEdge(-1.0, 0.3), GapEdge(1.0, 0.3)
    assert gap_width(section(0.0), a, b) == pytest.approx(2.0)
    assert gap_width(section(0.0, 0.2), a, b) == pytest.approx(2.0 * np.hypot(1.0, 0.2))


def test_edge_response_is_a_blurred_step():
    for gradient in ((0.2, 0.0), (0.14, -0.14), (0.03, 0.19)):
        response = EdgeResponse.along(gradient, PixelBlur(0.5, 0.1))
        assert response.values[0] == pytest.approx(0, abs=1e-5)
        assert response.values[-1] == pytest.approx(1, abs=1e-5)
        assert np.allclose(response.values + response.values[::-1], 1, atol=1e-6)
        assert np.allclose(np.gradient(response.values, response.step)[1:-1], response.slopes[1:-1], atol=0.02)
        # Variances add: lens, pixel aperture (1/12 of a side squared), spill (2 q).
        x = response.step * (np.arange(len(response.values)) - len(response.values) // 2)
        variance = (response.slopes * x**2).sum() / response.slopes.sum()
        expected = (0.5**2 + 1 / 12 + 2 * 0.1) * np.hypot(*gradient) ** 2
        assert variance == pytest.approx(expected, rel=0.01)


GAPS = [
    Gap(2.3, 0.3, 0.11),
    Gap(1.2, 0.0, -0.5),
    Gap(4.0, 0.5, -0.8),
    Gap(0.5, 0.3, 0.3),
    Gap(1.5, 0.0, 0.4, 0.0, True),
]


def basis_of(samples, outline, sealed, tilt, eye, lamp, px_mm, table):
    """(n, LEVELS) of one outline, as the fit goes about it."""
    n, x, h = len(samples), np.empty(model.VERTICES), np.empty(model.VERTICES)
    pieces = np.empty((model.PIECES, model.COLUMNS))
    count = model.cut(outline, sealed, tilt, lamp, x, h, pieces)
    ends, shown = np.empty(model.PIECES + 1), np.empty(model.PIECES + 1, np.int64)
    found = model.visible(pieces, count, eye, 0.5 * (x[1] + x[6]), ends, shown)
    borders = np.array([model.project(x[k], h[k], *eye) for k in (1, 6)])
    spans, blurred = np.empty((model.PIECES, 2), np.int64), np.empty((1, model.PIECES, n))
    model.steps_at(samples, n, ends, found - 1, px_mm, table, spans, blurred)
    basis = np.empty((model.LEVELS, n))
    model.basis_at(samples, n, pieces, shown, found, borders, spans, blurred[0], basis)
    return basis.T


def test_steps_and_their_changes_between_nodes():
    normal, blur = (0.9, np.sqrt(0.19)), PixelBlur(0.4, 0.06)
    samples, end, px_mm = np.linspace(-1.5, 1.5, 301), 0.13, 6.0

    def at(lens, spill, end=end):
        [table] = blurred_steps(np.array([normal]), np.array([lens]), spill, model.NODES_PER_PX, 6.0)
        spans, blurred = np.empty((1, 2), np.int64), np.empty((4, 1, len(samples)))
        model.steps_at(samples, len(samples), np.array([end]), 1, px_mm, table, spans, blurred)
        blurred[:, 0, : spans[0, 0]] = blurred[:, 0, spans[0, 1] :] = 0
        blurred[0, 0, spans[0, 1] :] = 1
        return blurred[:, 0]

    step, slope, by_spill, by_lens = at(blur.lens_px, blur.spill)
    assert np.interp(end, samples, step) == pytest.approx(0.5, abs=1e-3)
    [fine] = blurred_steps(np.array([normal]), np.array([blur.lens_px]), blur.spill, 40 * model.NODES_PER_PX, 6.0)
    places = (np.arange(fine.shape[1]) - fine.shape[1] // 2) / (40 * model.NODES_PER_PX)
    assert step == pytest.approx(np.interp((samples - end) * px_mm, places, fine[0]), abs=1e-5)
    assert slope == pytest.approx(
        (at(0.4, 0.06, end - 1e-5)[0] - at(0.4, 0.06, end + 1e-5)[0]) / 2e-5 / px_mm, abs=2e-4
    )
    assert by_spill == pytest.approx((at(0.4, 0.0601)[0] - at(0.4, 0.0599)[0]) / 2e-4, abs=2e-3)
    assert by_lens == pytest.approx((at(0.401, 0.06)[0] - at(0.399, 0.06)[0]) / 2e-3, abs=2e-4)


@pytest.mark.parametrize("gap", GAPS)
def test_picture_of_a_gap_is_what_single_rays_meet(gap):
    eye, lamp, px_mm = np.array([-160.0, 680.0]), np.array([60.0, 690.0]), 5.0
    samples = np.linspace(-4, 4, 801)
    outline = np.array([
        -gap.width_mm / 2 - gap.chamfer_mm, gap.width_mm / 2 + gap.chamfer_mm, gap.chamfer_mm, gap.chamfer_mm,
        gap.depth_mm, 0.0, 1.0,
    ])  # fmt: skip
    # A blur of a hundredth of a pixel.
    [table] = blurred_steps(np.array([[1.0, 0.0]]), np.array([0.05]), 0.0, model.NODES_PER_PX, 3.0)
    tilt = np.array([-gap.step_mm / 2, 0.0])
    basis = basis_of(samples, outline, gap.sealed, tilt, eye, lamp, px_mm, table)
    regions = {
        gap_render.SKIN_A: (model.SKIN_A, model.SKIN_A), gap_render.SKIN_B: (model.SKIN_B, model.SKIN_B),
        gap_render.CHAMFER_A: (model.CHAMFER_A, model.DARK_FLOOR),
        gap_render.CHAMFER_B: (model.CHAMFER_B, model.DARK_FLOOR),
        gap_render.WALL_A: (model.LIT_WALL, model.DARK_WALL),
        gap_render.WALL_B: (model.LIT_WALL, model.DARK_WALL),
        gap_render.FLOOR: (model.LIT_FLOOR, model.DARK_FLOOR),
    }  # fmt: skip
    assert np.allclose(np.delete(basis, CHANGES, axis=1).sum(axis=1), 1)
    clear = basis.max(axis=1) > 0.999
    # Within half a pixel of a border both mix.
    assert clear.mean() > 0.5
    for x, row in zip(samples[clear], np.delete(basis, CHANGES, axis=1)[clear], strict=True):
        piece, lit = seen(gap, float(x), eye, lamp)
        expected = regions[piece][0 if lit else 1]
        assert row[expected - (expected > model.SLOPE_A)] > 0.99


@pytest.mark.parametrize("gap", [Gap(4.0, 0.3, 0.5, 2.0), Gap(2.5, 0.0, -0.3, 3.0), Gap(0.5, 0.3)])
def test_floor_darkens_as_its_walls_hide_the_sky(gap):
    x, h = gap.outline.T
    for place in gap.width_mm * np.array([-0.49, -0.3, 0.0, 0.4]):
        assert model._sky(x.copy(), h.copy(), place) == pytest.approx(gap_render.sky_seen(gap, place), abs=0.005)


def test_wide_gap_over_a_floor_dark_at_its_walls(rng):
    gap = Gap(4.4, 0.3, -0.8, 2.1, sky=0.03)
    fit = fit_gap(profiles(gap, 24, rng), possible_floors(2.1))
    widths = fit.borders @ [-1.0, 1.0] - fit.chamfers_mm.sum()
    assert np.abs(widths - gap.width_mm).mean() < 0.01


def test_walls_that_lean_as_none_are_cut_widen_the_width_s_uncertainty(rng):
    some = profiles(Gap(1.5, 0.3, 0.2), 3, rng)
    known = Prior(some, Floor(False))
    shared = known.mean.copy()
    assert known.strain(shared) == 1
    shared[LEAN_CHANGE] = 0.03  # as far as they usually are
    assert known.strain(shared) == 1
    shared[LEAN_CHANGE] = 0.084
    assert known.strain(shared) == pytest.approx(2.8 / np.sqrt(3))
    shared[LEAN_CHANGE] = 0.21  # by chance nothing is: the other directions do not make it less
    assert known.strain(shared) == pytest.approx(7)


def test_normal_equations_are_the_cost_s_derivatives(rng):
    some = profiles(Gap(1.5, 0.3, 0.2), 3, rng)
    known = Prior(some, Floor(False))
    shared = known.mean.copy()
    borders = np.outer(some.half_widths, [-1.0, 1.0]) + 0.05
    state = solver._state_at(some, borders, shared, known)
    # Half of the cost's slope downhill is the gradient: the levels have settled, so only θ moves it.
    for k, size in (
        (0, 1e-4),
        (1, 1e-4),
        (2, 1e-4),
        (4, 1e-4),
        (5, 1e-4),
        (6, 1e-4),
        (8, 1e-4),
        (9, 1e-4),
        (13, 1e-3),
        (26, 1e-3),
    ):
        costs = []
        for sign in (-1, 1):
            b, s = borders.copy(), shared.copy()
            if k < 2:
                b[:, k] += sign * size
            else:
                s[k - 2] += sign * size
            costs.append(solver._state_at(some, b, s, known).costs)
        slope = (costs[1] - costs[0]) / (2 * size)
        scale = np.sqrt(state.normals[:, k, k] * state.costs)
        assert np.allclose(-2 * state.gradients[:, k] / scale, slope / scale, atol=0.05)
    assert np.allclose(state.normals, state.normals.transpose(0, 2, 1), rtol=1e-6, atol=1e-6 * state.normals.max())


@pytest.mark.parametrize("gap", GAPS)
def test_gap_is_measured_from_its_pictures(gap, rng):
    some = profiles(gap, 16, rng)
    fit = fit_gap(some, possible_floors(None))
    widths = fit.borders @ [-1.0, 1.0] - fit.chamfers_mm.sum()
    u95 = 1.96 * np.hypot(fit.sigma_own_mm, fit.sigma_common_mm)
    assert fit.sound.all()
    assert np.abs(widths - gap.width_mm).mean() < 0.03
    assert np.mean(np.abs(widths - gap.width_mm) < u95) > 0.8
    assert np.median(u95) < 0.15


@pytest.mark.parametrize(("gap", "seed"), [(Gap(0.08, 0.4, 0.05, 2.5), 2), (Gap(0.08, 0.3), 1)])
def test_a_tight_gap_between_chamfers_that_looks_like_a_shallow_one_is_within_u95(gap, seed):
    """Two pixels of a V: its ground may be the floor of a gap five times as wide."""
    some = profiles(gap, 12, np.random.default_rng(seed), noise=0.03, lens_px=1.1)
    fit = fit_gap(some, possible_floors(None))
    widths = fit.borders @ [-1.0, 1.0] - fit.chamfers_mm.sum()
    u95 = 1.96 * np.hypot(fit.sigma_own_mm, fit.sigma_common_mm)
    assert np.mean(np.abs(widths - gap.width_mm) < u95) > 0.8


def test_paint_where_the_fit_starts_does_not_lead_it_astray(rng):
    """Five of the six stations that the start is looked for at have paint on side A."""
    gap = Gap(0.8, 0.5, 0.1)
    some = profiles(gap, 24, rng)
    starts = shape._evenly(24, 6)[:5]
    grey = some.grey.copy()
    grey[starts] *= np.where(some.x[starts] < -1.0, 0.2, 1.0)
    fit = fit_gap(replace(some, grey=grey), possible_floors(None))
    widths = fit.borders @ [-1.0, 1.0] - fit.chamfers_mm.sum()
    assert np.median(np.abs(widths - gap.width_mm)) < 0.05
    assert np.allclose(fit.chamfers_mm, 0.5, atol=0.05)


@pytest.mark.parametrize("gap", [Gap(0.3, 0.0, sealed=True), Gap(0.06, 0.12)])
def test_band_within_the_blur_may_be_sealed_or_a_tight_gap(gap, rng):
    fit = fit_gap(profiles(gap, 16, rng), possible_floors(None))
    widths = fit.borders @ [-1.0, 1.0] - fit.chamfers_mm.sum()
    u95 = 1.96 * np.hypot(fit.sigma_own_mm, fit.sigma_common_mm)
    assert np.mean(np.abs(widths - gap.width_mm) < u95) > 0.9
    if fit.sealed:
        assert (u95 > widths - 0.07).all()


def test_sealant_that_broken_edges_could_not_imitate_keeps_its_width(rng):
    fit = fit_gap(profiles(Gap(1.5, 0.0, 0.1, sealed=True), 16, rng), possible_floors(None))
    assert fit.sealed
    assert fit.sigma_common_mm < 0.04


@pytest.mark.slow
def test_narrow_gaps_are_as_wide_as_stated():
    # What a seam's stations have in common errs once for all of them: several draws of noise, several gaps.
    covered = []
    for gap in (Gap(0.3, 0.45), Gap(0.4, 0.2, 0.5), Gap(0.5, 0.0, -0.3), Gap(0.35, 0.1)):
        for seed in range(3):
            fit = fit_gap(profiles(gap, 16, np.random.default_rng(seed)), possible_floors(None))
            widths = fit.borders @ [-1.0, 1.0] - fit.chamfers_mm.sum()
            u95 = 1.96 * np.hypot(fit.sigma_own_mm, fit.sigma_common_mm)
            error = np.abs(widths - gap.width_mm)
            assert error.mean() < 0.03
            covered.append(np.mean(error < u95))
    assert np.mean(covered) > 0.93


def test_chamfers_need_not_lie_at_the_drawn_angle(rng):
    gap = Gap(2.3, 0.3, chamfer_slope=0.75)
    fit = fit_gap(profiles(gap, 24, rng), possible_floors(3.0))
    widths = fit.borders @ [-1.0, 1.0] - fit.chamfers_mm.sum()
    assert np.abs(widths - gap.width_mm).mean() < 0.015
    assert 0.7 < fit.chamfer_slope < 0.9


@pytest.mark.parametrize("glints", [(0.33, 0.55), (0.7, 0.3)])
def test_glossy_chamfers_of_which_one_is_brighter(glints, rng):
    gap = Gap(2.0, 0.9, glints=glints)
    fit = fit_gap(profiles(gap, 24, rng, lens_px=0.8), possible_floors(None))
    widths = fit.borders @ [-1.0, 1.0] - fit.chamfers_mm.sum()
    assert np.abs(widths - gap.width_mm).mean() < 0.015
    assert fit.chamfers_mm == pytest.approx([0.9, 0.9], abs=0.03)


def test_gap_beside_a_highlight_that_changes_along_the_seam():
    # Profiles are relative to the skin: where it shines, all that does not is darker.
    gap = Gap(0.8, 0.3, 0.2)
    plain, dim = (profiles(replace(gap, dimmed=share), 32, np.random.default_rng(1)) for share in (1.0, 0.7))
    highlight = np.exp(-0.5 * (plain.places / 0.8) ** 2)[:, None, None]
    fit = fit_gap(replace(plain, grey=plain.grey + highlight * (dim.grey - plain.grey)), possible_floors(None))
    widths = fit.borders @ [-1.0, 1.0] - fit.chamfers_mm.sum()
    u95 = 1.96 * np.hypot(fit.sigma_own_mm, fit.sigma_common_mm)
    assert np.abs(widths - gap.width_mm).mean() < 0.015
    assert np.mean(np.abs(widths - gap.width_mm) < u95) > 0.9


def test_levels_course_along_a_seam(rng):
    places = np.linspace(-1, 1, 40)
    true = 0.1 * places**3 - 0.05 * places + 0.02
    away = np.repeat(true[:, None, None], 2, axis=1) * np.ones(model.LEVELS)
    away += rng.normal(0, 0.005, away.shape)
    away[7] += 0.4
    course = courses(places, away)
    skin = [model.SKIN_A, model.SKIN_B, model.SLOPE_A, model.SLOPE_B]
    assert not course[:, :, skin].any()
    assert np.abs(np.delete(course, skin, axis=2) - true[:, None, None]).max() < 0.01
    assert not courses(places[:8], away[:8]).any()


@pytest.mark.parametrize("depth", [1.0, 2.5])
def test_floor_in_full_view_is_what_all_see_past_the_edges(depth):
    frame = Frame(np.zeros(3), np.eye(3))
    line = SkinLine(np.zeros(3), 100)
    section = Section(frame, line, line, np.eye(5), 1.0)
    centres, half = np.array([[-167.0, 3.0, 690.0], [131.0, -5.0, 691.0], [-19.0, 0.0, 713.0]]), 1.3
    low, high = floor._in_full_view(section, half, depth, centres)
    x = np.linspace(-half, half, 2001)
    # Where the way from the floor to each centre passes the height of the edges.
    passes = x + (centres[:, :1] - x) * depth / (depth + centres[:, 2:])
    full = x[(np.abs(passes) < half).all(axis=0)]
    assert (full.min(), full.max()) == (pytest.approx(low, abs=0.01), pytest.approx(high, abs=0.01))


@pytest.mark.parametrize(("width_px", "known"), [(4, False), (5, False), (16, True)])
def test_floor_has_a_depth_only_where_some_of_it_is_clear_of_the_edges(width_px, known, rng):
    scan = seam_scan([], [], rng, radius_mm=1e9, tilt=0.0)
    # Chamfers 3 px wide, and phases near an edge are mixed: the floor, 1.5 mm down, appears as the blur makes of it.
    row, column = 350, 450
    across = np.abs(np.arange(scan.points.shape[1]) - column)
    chamfer = 0.6 * np.clip((width_px / 2 + 3 - across) / 3, 0, 1)
    depth = gaussian_filter1d(np.where(across <= width_px / 2, 1.5, chamfer), 2.0)
    scan.points[...] *= (1.0 + depth / 700.0).astype(np.float32)[:, None]
    line = SkinLine(np.zeros(3), 100)
    sections, halves = [], []
    for v in range(row - 60, row + 60, 10):
        skin = scan.rig.left.normalized(np.array([column, v], float))
        origin = np.append(skin, 1.0) * (700.0 + 0.03 * (v - 349.5) * 700.0 / scan.rig.left.K[0, 0])
        frame = Frame(origin, np.diag([1.0, -1.0, -1.0]))
        sections.append(Section(frame, line, line, np.eye(5), 1.0))
        halves.append(0.5 * (width_px + 3) * 700.0 / scan.rig.left.K[0, 0])
    found = floor.floor_depth(sections, halves, scan, 2.0)
    assert (found == pytest.approx(1.5, abs=0.05)) if known else found is None


def test_slit_narrower_than_the_blur_is_known_to_be_poorly_known(rng):
    fit = fit_gap(profiles(Gap(0.15, 0.3), 12, rng), possible_floors(None))
    width = float(np.median(fit.borders @ [-1.0, 1.0] - fit.chamfers_mm.sum()))
    u95 = 1.96 * fit.sigma_common_mm
    assert abs(width - 0.15) < u95
    assert u95 > 0.03


def test_station_with_another_picture_is_not_measured_nor_does_it_harm(rng):
    gap = Gap(2.3, 0.3)
    some = profiles(gap, 16, rng)
    # A hole takes one station's edge away.
    grey = some.grey.copy()
    grey[7, :, some.x[7, 0] < 0] = 0.05
    fit = fit_gap(replace(some, grey=grey), possible_floors(2.95))
    assert not fit.sound[7]
    assert fit.sound.sum() == 15
    widths = (fit.borders @ [-1.0, 1.0] - fit.chamfers_mm.sum())[fit.sound]
    assert np.abs(widths - 2.3).max() < 0.03


@pytest.mark.parametrize(("stations", "cameras"), [(1, 2), (3, 2), (12, 1)])
def test_few_stations_and_one_camera_are_enough_for_a_width(stations, cameras, rng):
    some = profiles(Gap(2.3, 0.3), stations, rng)
    sizes = some.sizes.copy()
    sizes[:, cameras:] = 0
    fit = fit_gap(replace(some, sizes=sizes), possible_floors(2.95))
    widths = fit.borders @ [-1.0, 1.0] - fit.chamfers_mm.sum()
    u95 = 1.96 * np.hypot(fit.sigma_own_mm, fit.sigma_common_mm)
    assert np.all(np.abs(widths - 2.3) < 1.5 * u95)


def skin_points(rng, n=4000, noise=0.02, correlation=0.0):
    """Points of two skins with a gap of ±1 mm between them: the same bend, different heights and slopes."""
    x, y = rng.uniform(-12, 12, n), rng.uniform(-2, 2, n)
    x = x[np.abs(x) > 1]
    y = y[: len(x)]
    common = correlation * noise * rng.standard_normal(40)[((x + 12) / 24 * 40).astype(int)]
    a, b = 0.1 + 0.02 * x + 0.05 * y, 0.3 + 0.01 * x - 0.02 * y
    h = np.where(x < 0, a, b) + 3e-4 * x**2 + common + noise * rng.standard_normal(len(x))
    return np.stack([x, y, h, np.full(len(x), noise)], axis=1)


def test_skin_lines_are_least_squares(rng):
    points = skin_points(rng)
    points[:40, 2] += 1.0
    fit = fit_skin_lines(points, -1.0, 1.0, 3.0)
    assert fit is not None
    x, y, h, sigma = points[40:].T
    a, b = x < 0, x > 0
    design = np.stack([a, a * x, b, b * x, x**2, a * y, b * y], axis=1) / sigma[:, None]
    expected = np.linalg.lstsq(design, h / sigma, rcond=None)[0]
    assert np.allclose(fit.solution, expected, atol=2e-4)
    assert (
        np.abs((fit.solution - [0.1, 0.02, 0.3, 0.01, 3e-4, 0.05, -0.02]) / np.sqrt(np.diag(fit.covariance))).max() < 4
    )
    assert fit.chi == pytest.approx(1.0, abs=0.05)
    assert min(fit.n_a, fit.n_b) > 1700


def test_correlated_points_are_worth_fewer(rng):
    alone = np.mean([fit_skin_lines(skin_points(rng), -1.0, 1.0, 3.0).clumping for _ in range(40)])
    together = np.mean([fit_skin_lines(skin_points(rng, correlation=0.3), -1.0, 1.0, 3.0).clumping for _ in range(40)])
    assert alone == pytest.approx(1.0, abs=0.4)
    assert together > 3 * alone


def test_too_few_points_are_no_skin_line(rng):
    points = skin_points(rng)
    assert fit_skin_lines(points[points[:, 0] < 0], -1.0, 1.0, 3.0) is None


@pytest.mark.parametrize("angle", [0, 1.5, 40, 90])
def test_stations_lie_on_a_tilted_skin(angle, rng):
    # A plane, 1/z affine in the pixel: 0.06 mm deeper for each pixel to the right.
    v, u = np.indices(SHAPE).astype(float)
    scan = seam_scan([], [], rng)

    def depth(u, v):
        return 700 / (1 - 9e-5 * (u - 450) - 5e-5 * (v - 350))

    rays = np.concatenate([scan.rig.left.normalized(np.stack([u, v], axis=-1)), np.ones((*SHAPE, 1))], axis=-1)
    scan = replace(scan, points=(rays * depth(u, v)[..., None]).astype(np.float32))
    along = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
    line = np.array([450.3, 350.4]) + np.arange(-320.0, 320.0)[:, None] * along
    track = lay_on_skin(line, np.full(len(line), 8.0), scan, np.ones(SHAPE, bool), 3.0)
    assert track is not None
    assert track.points[:, 2] == pytest.approx(depth(*track.pixels.T), abs=5e-4)


def test_points_beyond_another_seam_lie_on_another_plate():
    course = np.array([[0.0, 50.0], [40.0, 52.0], [80.0, 50.0]])
    pixels = np.array([[30.0, 20.0], [30.0, 70.0], [75.0, 40.0], [40.0, 51.0]])
    assert beyond(pixels, np.array([30.0, 30.0]), [course]).tolist() == [False, True, False, False]
    # A seam that ends at this one parts what lies to its left and right.
    stem = np.array([[60.0, 20.0], [60.0, 45.0]])
    assert beyond(pixels, np.array([30.0, 30.0]), [course, stem]).tolist() == [False, True, True, False]


def test_settings_out_of_range():
    with pytest.raises(UsageError, match="edges"):
        SeamSettings(edges="guess")  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="chamfer_deg"):
        SeamSettings(chamfer_deg=90)


@pytest.mark.parametrize(("name", "seams"), [("skin", 1), ("skin-worn", 0)])
def test_reference_scans(shared, name, seams):
    from metrology.reconstruct import reconstruct
    from storage.rig import load_rig
    from storage.scene import load_scene

    scene = load_scene(shared / "scenes" / name)
    rig = load_rig(shared / "scenes" / "rig.json")
    cloud = reconstruct(scene.frames("left"), scene.frames("right"), rig, scene.code, scene.exposures)
    lines = detect_seams(cloud, ())
    assert sum(line.relief for line in lines) == seams
    stations = measure_seams(lines, cloud, ())
    assert len({station.seam_id for station in stations}) == seams
    if seams:
        truth = json.loads((shared / "scenes" / name / "truth.json").read_text())["seams"][0]
        v = np.array(truth["uv_px"])[:, 1]
        order = np.argsort(v)
        measured = [s for s in stations if s.width_mm is not None]
        for quantity, limit in (("step_mm", 0.004), ("width_mm", 0.030)):
            true = np.interp([s.v_px for s in measured], v[order], np.array(truth[quantity])[order])
            error = np.array([getattr(s, quantity) for s in measured]) - true
            assert np.abs(error).mean() < limit

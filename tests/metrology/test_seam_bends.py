"""What moves a seam's step: skin bent on one side, twisted skin at a border, a course that leaves the skin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrology.arrays import Array
from metrology.fits import SkinLine
from metrology.results import SeamStation
from metrology.seams import detect_seams, measure_seams
from metrology.seams.skins.one_sided import stand_out, step_moved_by_bends, with_one_sided_bends
from metrology.seams.skins.sections import Section, _twist_step, section_at, usable_points
from metrology.seams.skins.skin_lines import fit_skin_lines
from metrology.seams.skins.step import step_height
from metrology.surfaces import Frame
from tests.support.seam_scan import Relief, seam_scan
from tests.support.seam_textures import Band

EDGE, INNER, OUTER = 1.0, 1.8, 15.8
EDGES = (-EDGE, EDGE)
STEP = 0.1


def section(
    bend: float, rng: np.random.Generator, sigma: float, curvature: float = 3e-4, begins: float = EDGE
) -> Section:
    """A section of a bent skin whose side A bends by `bend` (1/mm) more from its edge on, or from farther out."""
    x = np.concatenate([-1, 1] * rng.uniform(INNER, OUTER, (900, 2)))
    y = rng.uniform(-2, 2, x.size)
    h = curvature * x**2 + np.where(x > 0, STEP, bend * np.maximum(-x - begins, 0.0) ** 2)
    h += sigma * rng.standard_normal(x.size)
    fit = fit_skin_lines(np.stack([x, y, h, np.full(x.size, max(sigma, 1e-4))], axis=1), -INNER, INNER, 3.0)
    a, b = SkinLine(fit.solution[[0, 1, 4]], fit.n_a), SkinLine(fit.solution[2:5], fit.n_b)
    frame = Frame(np.array([0.0, 0.0, 700.0]), np.eye(3))
    return Section(frame, a, b, fit.covariance[:5, :5], fit.clumping, fit.stretches, fit.misfit)


def station(one: Section, s: float, u95: float) -> SeamStation:
    step = step_height(one, *EDGES)
    return SeamStation("S01", s, x_mm=0.0, y_mm=s, z_mm=700.0, u_px=0.0, v_px=s, step_mm=step, step_u95_mm=u95)


@pytest.mark.parametrize("bend", [5e-4, -2e-4])
def test_a_bend_of_one_side_tells_how_far_it_moves_the_step(bend: float, rng: np.random.Generator) -> None:
    """Of a bend as it is reckoned with, all of the step's error; of one of both sides, nothing."""
    bent = section(bend, rng, 0.0)
    error = step_height(bent, *EDGES) - STEP
    assert abs(error) > 0.005
    (moved,) = step_moved_by_bends([bent], [EDGES])
    assert moved == pytest.approx(error, rel=0.1)
    (moved,) = step_moved_by_bends([section(0.0, rng, 0.0, curvature=bend)], [EDGES])
    assert abs(moved) < 1e-4


def test_u95_holds_the_step_s_error_beside_a_dent_s_foot_and_stays_elsewhere(rng: np.random.Generator) -> None:
    """The foot of a dent bends side A over 16 mm along the seam, by a tenth of a millimetre where the strip ends."""
    s = 2.0 * np.arange(50)
    bends = np.where(np.abs(s - 40.0) < 8.0, -4.5e-4, 0.0)
    sections = [section(bend, rng, 0.015) for bend in bends]
    rows = [station(one, at, 0.005) for one, at in zip(sections, s, strict=True)]
    errors = np.abs([row.step_mm - STEP for row in rows])
    assert errors[bends != 0].min() > 0.01
    told = np.array([row.step_u95_mm for row in with_one_sided_bends(rows, sections, [EDGES] * len(rows))])
    assert (errors <= told)[bends != 0].all()
    assert (told[np.abs(s - 40.0) > 16.0] == 0.005).mean() > 0.9


def test_a_foot_that_begins_farther_out_leans_the_line_and_widens_u95(rng: np.random.Generator) -> None:
    """A kink that changes along the seam is no twist of stiff plates; one that changes evenly may be."""
    s = 2.0 * np.arange(50)
    near = np.abs(s - 40.0) < 12.0
    sections = [section(-1.2e-3 if bent else 0.0, rng, 0.015, begins=6.0) for bent in near]
    rows = [station(one, at, 0.005) for one, at in zip(sections, s, strict=True)]
    errors = np.abs([row.step_mm - STEP for row in rows])
    assert errors[near].min() > 0.01
    told = np.array([row.step_u95_mm for row in with_one_sided_bends(rows, sections, [EDGES] * len(rows))])
    assert (errors <= told)[near].all()
    assert (told[np.abs(s - 40.0) > 26.0] == 0.005).all()
    twisted = []
    for k, one in enumerate(sections[30:]):
        b = replace(one.b, coefficients=one.b.coefficients + np.array([0.0, 1e-3 * k, 0.0]))
        twisted.append(replace(one, b=b))
    told = np.array([row.step_u95_mm for row in with_one_sided_bends(rows[30:], twisted, [EDGES] * 20)])
    assert (told == 0.005).mean() > 0.8


def test_stretches_without_points_and_short_seams_change_nothing(rng: np.random.Generator) -> None:
    one = section(-4.5e-4, rng, 0.015)
    rows = [station(one, 2.0 * k, 0.005) for k in range(5)]
    assert with_one_sided_bends(rows, [one] * 5, [EDGES] * 5) == rows
    one.misfit[0, 3] = 0
    assert np.isnan(step_moved_by_bends([one, None], [EDGES] * 2)).all()


def test_own_curvatures_move_the_step_as_a_fit_with_both_does(rng: np.random.Generator) -> None:
    x = np.concatenate([-1, 1] * rng.uniform(INNER, OUTER, (900, 2)))
    y = rng.uniform(-2, 2, x.size)
    h = np.where(x < 0, 7e-4, 3e-4) * x**2 + np.where(x > 0, STEP, 0.0) + 0.002 * rng.standard_normal(x.size)
    fit = fit_skin_lines(np.stack([x, y, h, np.full(x.size, 0.002)], axis=1), -INNER, INNER, 3.0)
    a, b = x < 0, x > 0
    assert (fit.n_a, fit.n_b) == (a.sum(), b.sum())
    both = np.stack([a, a * x, a * x**2, a * y, b, b * x, b * x**2, b * y], axis=1)
    own = np.linalg.lstsq(both, h)[0]
    assert abs(fit.own_curvatures_step) > 0.005
    assert fit.solution[2] - fit.solution[0] + fit.own_curvatures_step == pytest.approx(own[4] - own[0], abs=1e-6)


def test_steps_that_own_curvatures_move_along_a_stretch_have_that_in_u95(rng: np.random.Generator) -> None:
    """Over a stretch of 30 mm; what changes its sign from one station to the next is noise."""
    one = section(0.0, rng, 0.0)
    moved = np.where(np.arange(60) < 20, 0.008, 0.02 * (-1.0) ** np.arange(60))
    sections = [replace(one, own_curvatures_step=step) for step in moved]
    rows = [station(one, 2.0 * k, 0.005) for k in range(60)]
    told = np.array([row.step_u95_mm for row in with_one_sided_bends(rows, sections, [EDGES] * 60)])
    assert told[:12] == pytest.approx(0.008)
    assert (told[30:] == 0.005).all()


@pytest.mark.parametrize("from_y", [-2.0, 0.0])
def test_a_twisted_skin_of_which_a_border_cuts_the_strip_is_in_u95(from_y: float, rng: np.random.Generator) -> None:
    """With points to one side of the plane alone the slopes along the seam carry the step off by the twist."""
    x = np.concatenate([-1, 1] * rng.uniform(INNER, OUTER, (900, 2)))
    y = rng.uniform(from_y, 2, x.size)
    twist = 8e-4
    h = twist * x * y + np.where(x > 0, STEP, 0.0) + 0.002 * rng.standard_normal(x.size)
    fit = fit_skin_lines(np.stack([x, y, h, np.full(x.size, 0.002)], axis=1), -INNER, INNER, 3.0)
    off = fit.solution[2] - fit.solution[0] - STEP
    moved = _twist_step(fit, fit.covariance, y)
    if from_y == 0.0:
        assert 0.007 < abs(off) < moved + 0.003
    else:
        assert moved < 0.001
    one = replace(section(0.0, rng, 0.0), twist_step=moved)
    rows = [station(one, 2.0 * k, 0.004) for k in range(20)]
    told = [row.step_u95_mm for row in with_one_sided_bends(rows, [one] * 20, [EDGES] * 20)]
    assert told == pytest.approx([max(0.004, moved)] * 20)


@pytest.mark.parametrize("out_of_skin", [0.3, 0.6])
def test_a_course_that_leaves_the_skin_at_its_end_moves_no_step(out_of_skin: float, rng: np.random.Generator) -> None:
    """A section across such a course would be slanted, and its step too large by 1/cos: 0.04 and 0.16 of it."""
    reconstruction = seam_scan([Band((450.0, 350.0), 90.0)], [Relief(step_mm=0.2)], rng, sigma_z=0.004)
    points, usable = reconstruction.points, usable_points(reconstruction)
    place = 0.5 * (points[350, 440] + points[350, 460])
    along = points[380, 440] - points[320, 440]
    along /= np.linalg.norm(along)
    normal = np.cross(along, points[350, 440] - points[350, 420])
    slanted = along + out_of_skin * normal / np.linalg.norm(normal)

    def step(direction: Array) -> float:
        across = points[350, 460] - points[350, 440]
        arguments = place, direction / np.linalg.norm(direction), across, np.array([450.0, 350.0])
        section = section_at(reconstruction, usable, *arguments, 2.0, 16.0, 2.0, 150)
        assert isinstance(section, Section)
        return step_height(section, -1.0, 1.0)

    assert abs(step(along)) == pytest.approx(0.2, abs=0.004)
    assert step(slanted) == pytest.approx(step(along), abs=0.002)


def test_lines_that_a_bead_beside_the_seam_has_turned_stand_out(rng: np.random.Generator) -> None:
    one = section(0.0, rng, 0.002)

    def turned(by: float) -> Section:
        return replace(one, b=replace(one.b, coefficients=one.b.coefficients + np.array([0.0, by, 0.0])))

    assert not any(stand_out([turned(0.012 * k) for k in range(20)]))  # a dent's foot bends the skin more and more
    sections = [turned(-0.05) if k == 9 else None if k == 11 else one for k in range(20)]
    assert [k for k, off in enumerate(stand_out(sections)) if off] == [9]
    assert not any(stand_out([turned(-0.05), one, one]))


def test_a_station_beside_a_bead_is_not_measured(rng: np.random.Generator) -> None:
    scan = seam_scan([Band((450.0, 350.0), 90.0)], [Relief(step_mm=0.1)], rng, sigma_z=0.004)
    v, u = np.indices(scan.flags.shape)
    bead = (np.abs(v - 350) < 9) & (u > 460) & (u < 486)
    scan.points[..., 2] -= np.where(bead, 0.5 - 0.012 * (u - 460), 0.0)
    scan.points[(np.abs(v - 350) < 9) & (u > 486) & (u < 515)] = np.nan
    [line] = detect_seams(scan, [])
    rows = [row for row in measure_seams([line], scan, []) if row.v_px and abs(row.v_px - 350) < 100]
    off = [row for row in rows if row.step_mm is not None and abs(abs(row.step_mm) - 0.1) > 0.05]
    assert off == []
    assert any("something lies on the skin" in str(row.reason) for row in rows)

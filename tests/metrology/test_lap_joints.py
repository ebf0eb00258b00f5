"""Lap joints: found in the relief, typed, with a step and without a width."""

from dataclasses import replace

import numpy as np
import pytest

from metrology.fits import SkinLine
from metrology.kinds import SEAM_STATION
from metrology.limits import Limit, PanelSpec
from metrology.results import SeamLine
from metrology.seams import SeamSettings, detect_seams, measure_seams
from metrology.seams.finding import relief as found_relief
from metrology.seams.finding.bridges import bridged
from metrology.seams.gap.lap_shadow import gap_or_edge, shadow_alone
from metrology.seams.skins.residuals import shared_share
from metrology.seams.skins.sections import Section
from metrology.surfaces import Frame
from metrology.tolerance import judge
from tests.support import gap_render
from tests.support.gap_render import Gap
from tests.support.rows import station_at
from tests.support.seam_scan import Relief, seam_scan
from tests.support.seam_textures import Band


@pytest.mark.parametrize(("angle", "step"), [(80.0, -1.0), (10.0, 0.5)])
def test_edge_without_a_line_is_a_lap_joint(angle, step, rng):
    band = Band((450.0, 350.0), angle, 4.0, 0.0)
    scan = seam_scan([band], [Relief(0.0, step)], rng)
    (line,) = detect_seams(scan, ())
    assert line.relief
    assert line.joint == "lap"
    _, across = band.local(*line.centre_px.T)
    assert np.abs(across).max() < 2.0
    stations = measure_seams([line], scan, ())
    measured = np.array([s.step_mm for s in stations if s.step_mm is not None])
    assert len(measured) > 0.9 * len(stations)
    assert np.abs(np.abs(measured) - abs(step)).mean() < 0.005
    for station in stations:
        assert station.joint == "lap"
        assert station.width_mm is None
        assert station.width_u95_mm is None
        assert "no gap" in station.reason


def test_waves_and_paint_are_no_lap_joints(rng):
    assert detect_seams(seam_scan([Band((450.0, 350.0), 80.0, 4.0, 0.0)], [Relief(0.0, 0.1)], rng), ()) == []


def test_line_of_the_picture_along_an_edge_is_found_once(rng):
    scan = seam_scan([Band((450.0, 350.0), 80.0, 8.0, 40.0)], [Relief(1.0, 0.8)], rng)
    assert len(detect_seams(scan, ())) == 1


@pytest.mark.parametrize(("step", "turns", "lines"), [(0.8, False, 1), (0.0, False, 2), (0.8, True, 2)])
def test_pieces_of_a_line_are_one_where_the_step_runs_on_between_them(step, turns, lines, rng):
    """One joint; nothing between; and where the second piece begins, the other skin is on top."""
    band = Band((450.0, 350.0), 80.0, 4.0, 0.0)
    scan = seam_scan([band], [Relief(0.0, step)], rng)
    course = np.array([450.0, 350.0]) + np.arange(-260.0, 260.0)[:, None] * [
        np.cos(np.deg2rad(80.0)),
        np.sin(np.deg2rad(80.0)),
    ]
    pieces = []
    for piece, forward in ((course[:200][::-1], -1), (course[316:], -1 if turns else 1)):
        relief = found_relief.Relief(skin_share=1.0, groove_share=0.9, step_mm=0.8 * forward, step_share=1.0)
        pieces.append((SeamLine("", piece, np.full(len(piece), 4.0), 0.9, True), relief))
    found = bridged(pieces, scan, scan.valid, SeamSettings())
    assert len(found) == lines
    if lines == 1:
        (line, _), spacing = found[0], np.hypot(*np.diff(found[0][0].centre_px, axis=0).T)
        assert len(line.centre_px) == len(line.width_px)
        assert spacing.max() < 2.5
        assert np.abs(band.local(*line.centre_px.T)[1]).max() < 1.5


@pytest.mark.parametrize(
    ("gap", "lap"),
    [
        (Gap(0.02, 0.0, 1.2, sealed=True), True),
        (Gap(0.02, 0.0, -0.6, sealed=True), True),
        (Gap(0.8, 0.0, 0.6), False),
        (Gap(0.6, 0.3, -1.0), False),
        (Gap(0.1, 0.0, 0.05), False),
    ],
)
def test_wall_and_shadow_of_a_step_are_no_gap(gap, lap, rng):
    assert (shadow_alone(gap_render.profiles(gap, 8, rng)) is not None) == lap


@pytest.mark.parametrize(
    ("gap", "alike"),
    [(Gap(0.4, 0.0, 0.9, sealed=True), True), (Gap(0.4, 0.0, -0.7, sealed=True), True), (Gap(0.9, 0.0, 0.6), False)],
)
def test_narrow_gap_beside_a_high_step_may_be_a_broken_edge(gap, alike, rng):
    some = gap_render.profiles(gap, 8, rng)
    assert shadow_alone(some) is None
    under = gap_or_edge(some)
    assert (under is not None) == alike
    assert under is None or under > gap.width_mm


def test_limit_of_the_width_does_not_ask_a_lap_joint():
    spec = PanelSpec("P", "A", {"default": {"step_mm": Limit(-1.5, 1.5), "width_mm": Limit(1.0, 3.0)}})
    values = {"step_mm": 1.0, "step_u95_mm": 0.01, "reason": "lap joint: no gap", "joint": "lap"}
    station = station_at("S01", 0.0, (0.0, 0.0, 700.0), (1.0, 1.0), **values)
    judged = judge(SEAM_STATION, [station, replace(station, joint="butt")], spec)
    assert [s.decision for s in judged] == ["pass", "not measured"]


@pytest.mark.parametrize(("common", "least", "most"), [(0.0, 0.0, 0.15), (1.0, 0.35, 0.65)])
def test_errors_that_go_on_along_the_seam_are_told(common, least, most, rng):
    frame, line = Frame(np.array([0, 0, 700.0]), np.eye(3)), SkinLine(np.zeros(3), 500)
    same = common * rng.normal(size=8)
    same *= common and 1.0 / np.sqrt(np.mean(same**2))
    sections = [Section(frame, line, line, np.eye(5), 1.0, same + rng.normal(size=8)) for _ in range(60)]
    assert least <= shared_share(sections, 2.0 * np.arange(60), 2.0) <= most

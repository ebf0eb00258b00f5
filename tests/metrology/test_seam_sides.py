"""Sides A and B: the same ones all along a bent seam, in the table, in the fits that are kept, and for the wind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.fits import FittedStation
from metrology.panel import NominalSeam, Placement
from metrology.registration.courses import on_course
from metrology.results import SeamLine
from metrology.seams import SeamSettings, measure_seams
from metrology.seams.sides import is_upright, oriented, towards_b
from metrology.seams.skins.step import step_height
from tests.support.seam_scan import Relief, seam_scan
from tests.support.seam_textures import Band

STEP = 0.2
# From 2° beyond horizontal to 2° beyond vertical, and back: a seam of 45° as a whole.
BAND = Band((450.0, 350.0), 45.0, 8.0, 40.0, (-402.0, 402.0), 140.0, 800.0)
IDENTITY = Placement(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 700.0]))


def course(first: float, last: float) -> NDArray[np.float64]:
    """(n, 2) the band's own course between two places on its axis, px."""
    x = np.arange(first, last)
    y = BAND.bow_px * np.sin(2 * np.pi * x / BAND.period_px)
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2)
    return np.column_stack([x, y]) @ turn.T + BAND.through


def line(name: str, first: float, last: float) -> SeamLine:
    centre = course(first, last)
    return SeamLine(name, centre, np.full(len(centre), BAND.width_px), 1.0, True)


@pytest.fixture(scope="module")
def scan():
    # The side of larger v, which is that of smaller u, stands higher.
    return seam_scan([BAND], [Relief(2.0, STEP)], np.random.default_rng(1))


def measured(lines, scan, settings=None) -> list[FittedStation]:
    rows = measure_seams(lines, scan, [], settings or SeamSettings())
    assert all(isinstance(row, FittedStation) for row in rows if row.step_mm is not None)
    return [row for row in rows if row.step_mm is not None]


@pytest.mark.parametrize("upright", [True, False])
def test_a_bent_seam_has_the_same_sides_all_along(scan, upright):
    # Both ends of the band lie at 45°; a few more millimetres of one or the other decide.
    whole = line("S01", -400.0, 400.0)
    ends = whole.centre_px + np.linspace(0, 4, len(whole.centre_px))[:, None] * ([0, 1] if upright else [1, 0])
    rows = measured([replace(whole, centre_px=ends)], scan)
    assert is_upright(ends) is upright
    assert len(rows) > 60
    # Side B is the right one, lower here, of an upright seam, else the one below, higher here.
    assert [row.step_mm for row in rows] == pytest.approx([-STEP if upright else STEP] * len(rows), abs=0.03)
    higher = np.array([row.fit.frame.axes[0] for row in rows]) * (-1 if upright else 1)
    beside = scan.rig.left.project(np.array([row.fit.frame.origin for row in rows]) + 4.0 * higher)
    assert (BAND.offsets(beside) > 0).all()


def test_the_kept_fit_gives_the_row_s_step(scan):
    settings = SeamSettings(half_length_mm=1.5, skin_extent_mm=9.0, station_step_mm=6.0, guard_px=6.0)
    for row in measured([line("S01", -400.0, 400.0)], scan, settings):
        assert step_height(row.fit, *row.fit.edges_mm) == row.step_mm
        assert row.fit.half_length_mm == 1.5
        assert row.fit.outer_mm - row.fit.inner_mm == pytest.approx(9.0)


def test_pieces_of_one_seam_get_the_same_sides_and_the_wind_follows(scan):
    pieces = [measured([line(name, *ends)], scan) for name, *ends in (("P1", -390.0, -230.0), ("P2", -120.0, 120.0))]
    # By its own chord the first piece is flat and the second upright: opposite signs.
    assert {np.sign(row.step_mm) for row in pieces[0]} == {1.0}
    assert {np.sign(row.step_mm) for row in pieces[1]} == {-1.0}
    nominal = IDENTITY.to_panel([(r.x_mm, r.y_mm, r.z_mm) for piece in pieces for r in piece])
    # Up and to the right across the seam, which falls to the right: side A of an upright seam is upstream.
    seam = NominalSeam("J01", tuple(map(tuple, nominal[::4])), airflow=(1.0, 1.0, 0.0))
    for given in (seam, replace(seam, course=seam.course[::-1])):
        rows = on_course(pieces, given, IDENTITY)
        assert [row.step_mm for row in rows] == pytest.approx([-STEP] * len(rows), abs=0.03)
        assert [step_height(row.fit, *row.fit.edges_mm) for row in rows] == pytest.approx([r.step_mm for r in rows])
        into = [row.step_into_wind_mm for row in rows if row.step_into_wind_mm is not None]
        assert len(into) > 0.9 * len(rows)
        assert into == pytest.approx([-STEP] * len(into), abs=0.03)


@pytest.mark.parametrize("angle", [0.0, 30.0, 44.0, 46.0, 90.0, 120.0, 134.0, 136.0, 170.0])
def test_sides_of_straight_seams_are_those_of_the_design(angle):
    along = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    for pixels in (np.outer([-1.0, 1.0], along), np.outer([1.0, -1.0], along)):
        direction = np.append(np.diff(oriented(pixels), axis=0)[0], 0.0)
        across = towards_b(direction, np.array([0.0, 0.0, 700.0]), is_upright(pixels))
        assert across[0 if is_upright(pixels) else 1] > 0
        assert abs(across @ direction) < 1e-12

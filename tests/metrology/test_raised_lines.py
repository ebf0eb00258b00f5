"""Cables, beads and tape lie on the skin: neither seams nor skin beside one."""

from dataclasses import replace

import numpy as np
import pytest

from metrology.seams import detect_seams, measure_seams
from tests.support.seam_scan import SHAPE, Relief, seam_scan
from tests.support.seam_textures import Band

ALONG = Band((450.0, 350.0), 10.0, 16.0, 10.0)
ACROSS = Band((450.0, 350.0), 85.0, 10.0, 60.0)


@pytest.mark.parametrize(("height", "contrast"), [(0.6, 10.0), (4.0, 10.0), (2.0, 60.0)])
def test_a_cable_is_shown_once_and_is_no_lap_joint(height, contrast, rng):
    cable = replace(ALONG, contrast=contrast)
    (line,) = detect_seams(seam_scan([cable], [Relief(-height, 0.0)], rng), ())
    assert not line.relief
    assert line.joint is None


def test_skin_under_a_cable_is_not_measured_for_a_seam(rng):
    scan = seam_scan([ACROSS, ALONG], [Relief(2.0, 0.15), Relief(-4.0, 0.0)], rng)
    lines = detect_seams(scan, ())
    assert [line.relief for line in lines] == [True, False]
    steps = np.array([row.step_mm for row in measure_seams(lines, scan, ()) if row.step_mm is not None])
    assert len(steps) > 20
    assert np.abs(np.abs(steps) - 0.15).max() < 0.02


@pytest.mark.parametrize("painted", [True, False])
def test_a_narrow_line_of_thick_paint_is_no_gap_however_little_light_comes_back(painted, rng):
    narrow = replace(ALONG, width_px=4.0, contrast=60.0)
    lit = np.arange(SHAPE[1]) > 40 * np.ones((SHAPE[0], 1))
    seen = seam_scan([narrow], [Relief(-0.1, 0.0)], rng, sigma_z=0.01, lit=lit)
    dark = lit & (seen.left.texture < 0.75 * np.median(seen.left.texture))
    modulation = np.where(dark, 0.5 * seen.left.modulation * seen.left.texture / 110, seen.left.modulation)
    points = seen.points if painted else np.where(dark[..., None], np.float32(np.nan), seen.points)
    scan = replace(seen, left=replace(seen.left, modulation=modulation.astype(np.float32)), points=points)
    (line,) = detect_seams(scan, ())
    assert line.relief == (not painted)

"""Seams: section geometry, the paper's piecewise fit, the grey-level model, and the reference scans."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest

from metrology.errors import UsageError
from metrology.results import SeamStation
from metrology.seams import LineSettings, SeamSettings, detect_seams, measure_seams, summarize
from metrology.seams.bands import fit_bands
from metrology.seams.blur import EdgeResponse, PixelBlur
from metrology.seams.gap import GapEdge, gap_width, step_height
from metrology.seams.piecewise import fit_pieces, paper_gap, side_of_section
from metrology.seams.sections import Section, SkinLine
from metrology.surfaces import Frame


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
    mirrored = type(b)(-b.slope, b.intercept, (-b.inflection[0], b.inflection[1]), b.n)
    height, gap = paper_gap(a, mirrored)
    assert height == pytest.approx(abs(step), abs=0.01)
    # Both corners are free within the tolerance: the method is that coarse, which is why it is not the default.
    assert gap == pytest.approx(width, abs=3 * 0.05)


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


def test_band_fit_is_unbiased_and_its_covariance_right():
    rng = np.random.default_rng(5)
    response = EdgeResponse.along((0.2, 0.02), PixelBlur(0.5, 0.05))
    grid = response.step * (np.arange(len(response.values)) - len(response.values) // 2)
    scores = []
    for _ in range(200):
        x = rng.uniform(-1, 1, 400)
        s0, s1 = (np.interp(x - edge, grid, response.values, 0, 1) for edge in (0.02, 0.32))
        grey = 120 + 5 * (x - 0.02) * (1 - s0) - 70 * s0 - 30 * s1 + rng.normal(0, 2, 400)
        fit = fit_bands(x, grey, [-0.05, 0.3], response, slopes=(True, False))
        assert fit is not None
        scores.append((fit.edges - (0.02, 0.32)) / np.sqrt(np.diag(fit.covariance)))
    assert np.abs(np.mean(scores, axis=0)).max() < 0.25
    assert np.std(scores, axis=0) == pytest.approx([1, 1], abs=0.15)


def test_summary():
    rows = [SeamStation("S01", s, 0, 0, 0, 0, 0, step_mm=s / 10, width_mm=None) for s in range(11)]
    summary = summarize(rows, "step_mm")[0]
    assert (summary.stations, summary.measured) == (11, 11)
    assert (summary.minimum, summary.maximum, summary.mean) == (0, 1, pytest.approx(0.5))
    assert np.isnan(summarize(rows, "width_mm")[0].mean)


def test_settings_out_of_range():
    with pytest.raises(UsageError, match="edges"):
        SeamSettings(edges="guess")  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="min_contrast"):
        LineSettings(min_contrast=2)


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

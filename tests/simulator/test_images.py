"""Light, blur and noise of the rendered frames."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import erf, ndtr

from metrology.errors import SpecError
from metrology.fringe import FringeCode
from simulator.panel import Panel, Skin, Surface
from simulator.projection import Beamer, project_image, project_stripes, receive_image
from simulator.random_panel import ring_reflectance
from simulator.relief import BACKGROUND
from simulator.scene import expose, fringe_light, make_rig, set_up, simulate
from simulator.sensor import Sensor
from simulator.spec import Camera, Disturbances, Lighting
from simulator.trace import four, spread
from tests.support.shown_image import look_at_image
from tests.support.whole_panel import meet, surface_heights


def test_samples_have_the_blurs_moments_and_cover_edges_evenly(rng):
    offsets = spread(64, 0.75)
    np.testing.assert_allclose(offsets.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(np.cov(offsets.T, bias=True), 0.75**2 * np.eye(2), atol=1e-12)
    np.testing.assert_allclose(four(0.75).T @ four(0.75) / 4, 0.75**2 * np.eye(2))
    angle = rng.uniform(0, math.pi, 300)
    edge = rng.uniform(-2, 2, 300)
    along = offsets @ np.stack([np.cos(angle), np.sin(angle)])
    error = (along < edge).mean(axis=0) - ndtr(edge / 0.75)
    assert np.abs(error).max() < 0.04
    assert np.abs(error).mean() < 0.01


def test_samples_come_from_where_the_rig_model_says(stage, spec):
    for side in ("left", "right"):
        hits, device = getattr(stage, side), getattr(stage.rig, side)
        count = np.diff(hits.first)
        column = np.add.reduceat(hits.column, hits.first[:-1]) / count
        row = np.add.reduceat(hits.row, hits.first[:-1]) / count
        v, u = np.divmod(np.flatnonzero(count == 4)[::97], hits.width)
        eye = stage.pose.to_panel(device.centre)
        rays = device.rays(np.stack([u, v], axis=1)) @ stage.pose.R
        points, kinds = meet(stage.relief, eye, rays)
        expected = stage.rig.projector.project(stage.pose.to_rig(points))
        skin = kinds != BACKGROUND
        got = np.stack([column, row], axis=1)[v * hits.width + u]
        # The mean of four samples about the centre: what is left is the perspective's curvature.
        np.testing.assert_allclose(got[skin], expected[skin], atol=1e-4)


def test_phase_of_the_fringes_is_the_projector_coordinate(stage, spec, rng):
    hits = stage.left
    smooth = np.flatnonzero(np.diff(hits.first) == 4)[::53]
    column = np.add.reduceat(hits.column, hits.first[:-1])[smooth] / 4
    direct = np.add.reduceat(hits.direct, hits.first[:-1])[smooth]
    light = fringe_light(spec, stage, rng)["left"].reshape(12, -1)[:, smooth]
    inside = (direct > 0) & (column > 10) & (column < 1270)
    for k, count in enumerate(spec.fringe.counts):
        one, two, three, four_ = light[4 * k : 4 * k + 4]
        phase = np.arctan2(four_ - two, one - three)
        expected = 2 * np.pi * count * (column + 0.5) / 1280
        slip = (phase - expected + np.pi) % (2 * np.pi) - np.pi
        # The projector's 256 levels shift the phase a little, the same for both cameras.
        assert np.abs(slip[inside]).max() < 4e-3
        assert abs(slip[inside].mean()) < 5e-4


def test_ideal_projector_has_no_phase_error():
    code = FringeCode("x", 4, (7, 6, 5))
    stripes = project_stripes(code, 128, 80, Beamer(bits=0, blur_px=1.0, black=0.0))
    at = (np.arange(20, 100) + 0.5 + 12) * 32 - 0.5
    lines = np.stack([np.interp(at, np.arange(stripes.light.shape[1]), line) for line in stripes.light])
    phase = np.arctan2(lines[3] - lines[1], lines[0] - lines[2])
    expected = 2 * np.pi * 7 * (np.arange(20, 100) + 0.5) / 128
    assert np.abs((phase - expected + np.pi) % (2 * np.pi) - np.pi).max() < 1e-3


def test_gamma_bends_the_fringes_but_both_cameras_see_the_same(spec):
    code = FringeCode("x", 4, (7, 6, 5))
    plain = project_stripes(code, 128, 80, Beamer(gamma=1.0))
    bent = project_stripes(code, 128, 80, Beamer(gamma=2.2))
    middle = plain.light.shape[1] // 2
    assert bent.light[:, middle - 640 : middle + 640].mean() < plain.light[:, middle - 640 : middle + 640].mean() - 0.05


@pytest.mark.parametrize("level", [10.0, 60.0, 180.0])
def test_noise_is_shot_noise_plus_readout_plus_quantisation(rng, level):
    sensor = Sensor(gain=0.016, read_noise=0.6, offset=3.0)
    frame = sensor.capture(np.full((400, 400), level, np.float32), 1.0, rng).astype(float)
    assert frame.mean() == pytest.approx(level + 3, abs=0.02)
    assert frame.var() == pytest.approx(0.016 * level + 0.36 + 1 / 12, rel=0.02)


def test_exposure_scales_light_and_saturates(rng):
    sensor = Sensor(gain=0.0, read_noise=0.0, offset=2.0)
    light = np.array([[10.0, 60.0, 300.0]], np.float32)
    np.testing.assert_array_equal(sensor.capture(light, 1.0, rng), [[12, 62, 255]])
    np.testing.assert_array_equal(sensor.capture(light, 0.2, rng), [[4, 14, 62]])
    assert Sensor(bits=16, gain=0, read_noise=0).capture(light, 1.0, rng).dtype == np.uint16
    with pytest.raises(SpecError, match="bits"):
        Sensor(bits=12)


def test_edge_of_the_panel_is_blurred_like_the_lens(rng, make_spec):
    # A flat panel whose border runs through the picture; the profile across it is a Gaussian's integral.
    panel = Panel(width_mm=20.0, height_mm=205.0, surface=Surface(brushing=0, blotches=0), background_reflectance=0.0)
    spec = make_spec(panel, light=Lighting(brightness=200.0, ambient=0.0))
    stage = set_up(spec, make_rig(spec), spec.placements[0])
    picture = receive_image(stage.left, np.ones((824 * 4, 1304 * 4), np.float32))
    for v in range(40, 160, 20):
        y = np.linspace(-60, 60, 2001)
        border = np.stack(
            [np.full_like(y, 10.0), y, surface_heights(stage.relief, np.full_like(y, 9.9999), y)[0]], axis=1
        )
        uv = stage.rig.left.project(stage.pose.to_rig(border))
        at = np.interp(v, np.sort(uv[:, 1]), uv[np.argsort(uv[:, 1]), 0])
        slope = np.gradient(uv[:, 0], uv[:, 1])[len(y) // 2]
        u = np.arange(int(at) - 5, int(at) + 6)
        inside = picture[v, int(at) - 8]
        expected = inside * 0.5 * (1 - erf((u - at) / math.hypot(1, slope) / (0.75 * math.sqrt(2))))
        # Shading changes by well under one per cent over these few pixels.
        np.testing.assert_allclose(picture[v, u], expected, atol=0.03 * inside)


def test_ring_reflectance_gives_the_contrast_asked_for():
    # A bar 0.2 mm wide under a blur of 0.75 px at 0.2 mm per px.
    x = np.linspace(-3, 3, 6001)
    kernel = np.exp(-0.5 * (x / 0.15) ** 2) / (0.15 * math.sqrt(2 * math.pi))
    reflectance = ring_reflectance(12.0, 0.2, 100.0, 0.75, 0.2)
    drop = 100 * (1 - reflectance) * kernel[np.abs(x) < 0.1].sum() * (x[1] - x[0])
    assert drop == pytest.approx(12.0, rel=0.01)


def test_projected_image_lands_where_the_projector_points(stage, spec):
    image = np.zeros((800, 1280))
    uv = stage.rig.projector.project(stage.pose.to_rig(np.array([-4.0, 2.0, 0.0])))
    at = np.rint(uv).astype(int)
    image[at[1] - 2 : at[1] + 3, at[0] - 2 : at[0] + 3] = 1.0
    colours = look_at_image(stage, spec, np.stack([image, 0 * image, image], axis=-1))
    for side in ("left", "right"):
        device = getattr(stage.rig, side)
        # The true point under the middle of the spot.
        eye = stage.pose.to_panel(stage.rig.projector.centre)
        point, _ = meet(stage.relief, eye, stage.rig.projector.rays(at[None].astype(float)) @ stage.pose.R)
        expected = device.project(stage.pose.to_rig(point))[0]
        picture = colours[side]
        red = picture[..., 0].astype(float) - picture[..., 1]
        np.testing.assert_allclose(picture[..., 0], picture[..., 2])
        v, u = np.mgrid[: red.shape[0], : red.shape[1]]
        found = np.array([(red * u).sum(), (red * v).sum()]) / red.sum()
        np.testing.assert_allclose(found, expected, atol=0.03)


def test_image_table_keeps_the_light_of_a_pixel():
    image = np.zeros((80, 128))
    image[40, 64] = 1.0
    table = project_image(image, Beamer(black=0.0, blur_px=1.0))
    assert table.sum() / 16 == pytest.approx(1.0, rel=1e-4)


def test_scans_repeat_but_for_their_noise(spec, panel, make_spec):
    twice = make_spec(panel, repeats=2)
    first, second = simulate(twice)
    again = next(iter(simulate(twice)))
    np.testing.assert_array_equal(first.left, again.left)
    assert first.left.shape == (1, 12, 200, 260)
    assert first.left.dtype == np.uint8
    assert first.truth == second.truth
    assert first.captured_at != second.captured_at
    difference = first.left.astype(float) - second.left
    assert 0.5 < difference.std() < 4
    assert abs(difference.mean()) < 0.02


def test_exposures_are_stacked_first(stage, panel, rng, make_spec):
    spec = make_spec(panel, camera=Camera(exposures=(0.5, 1.0), sensor=Sensor(gain=0, read_noise=0, offset=0)))
    light = fringe_light(spec, stage, rng)["right"]
    frames = expose(spec, light, rng).astype(float)
    assert frames.shape == (2, 12, 200, 260)
    unsaturated = frames[1] < 255
    assert np.abs(2 * frames[0] - frames[1])[unsaturated].max() <= 2


def test_disturbances_change_only_what_they_say(stage, panel, rng, make_spec):
    calm = fringe_light(make_spec(panel), stage, np.random.default_rng(1))["left"]
    drift = make_spec(panel, disturbances=Disturbances(ambient_drift=0.4))
    changed = fringe_light(drift, stage, np.random.default_rng(1))["left"]
    np.testing.assert_allclose((changed - calm)[0], -(changed - calm)[-1], atol=1e-3)
    shaken = fringe_light(make_spec(panel, disturbances=Disturbances(vibration_px=0.2)), stage, rng)["left"]
    assert 0.5 < (shaken - calm).std() < 20


def test_shine_brightens_towards_the_mirror_direction(panel, make_spec):
    means = []
    for specular in (0.0, 1.0):
        surface = Surface(brushing=0, blotches=0, specular=specular, roughness=0.3)
        spec = make_spec(Panel(skin=Skin(), surface=surface))
        stage = set_up(spec, make_rig(spec), spec.placements[0])
        means.append(stage.left.direct.mean())
    assert means[1] > 1.1 * means[0]

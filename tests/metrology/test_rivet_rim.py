"""A head's rim: steps of brightness by visibility and shadow, the fit against a plain model, traced heads."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import ndtr

from metrology.cloud import Reconstruction
from metrology.reconstruct import reconstruct
from metrology.results import Rivet
from metrology.rivets import detect_rivets, measure_rivets
from metrology.rivets.bilinear import sample_image
from metrology.rivets.rim_kernel import (
    BLACK,
    BLUR,
    BREAK,
    FLOOR,
    GAP,
    RADIUS,
    STEPS,
    UNKNOWNS,
    _model,
    fit_rim_kernel,
    rim_steps,
)  # fmt: skip
from simulator.panel import Panel
from simulator.panel import Rivet as PanelRivet
from simulator.rig import RigDesign
from simulator.scene import expose, fringe_light, make_rig, set_up
from simulator.spec import shipped_spec

TURN = np.arange(40) * (2 * np.pi / 40)
NORMALS = np.stack([np.cos(TURN), np.sin(TURN)], axis=1)
SLOPES = np.array([[-0.3, 0.05], [0.15, 0.05]])
LIGHT = np.array([-0.1, -0.15])
DISTANCES = np.arange(-0.7, 1.3, 0.1)


def steps(height: float, camera: float, light: float, gap: float = 0.15, edge: float = 0.05) -> tuple:
    at, by_gap, by_edge, level = np.empty(STEPS), np.empty(STEPS), np.empty(STEPS), np.zeros(STEPS + 1)
    rim_steps(height, camera, light, gap, edge, 0.3, 0.1, at, by_gap, by_edge, level)
    return at, by_gap, by_edge, level


def profiles(height: float, unknowns: np.ndarray, inside: float, outside: float) -> np.ndarray:
    """(2, k, m) the model of `metrology.rivets.rim`, written out: a staircase blurred by a Gaussian."""
    dx, dy, radius, gap, edge, floor, black, blur = unknowns
    result = np.empty((2, len(NORMALS), len(DISTANCES)))
    for c, slope in enumerate(SLOPES):
        for k, normal in enumerate(NORMALS):
            at, _, _, level = np.empty(STEPS), np.empty(STEPS), np.empty(STEPS), np.zeros(STEPS + 1)
            rim_steps(height, slope @ normal, LIGHT @ normal, gap, edge, floor, black, at, np.empty(STEPS),
                      np.empty(STEPS), level)  # fmt: skip
            level[0], level[-1] = inside, outside
            places = at + radius + normal @ [dx, dy]
            result[c, k] = inside + (np.diff(level) * ndtr((DISTANCES[:, None] - places) / blur)).sum(axis=1)
    return result


def test_a_flush_head_looks_alike_from_everywhere() -> None:
    for camera in (-0.4, 0.0, 0.4):
        at, *_ = steps(1e-9, camera, 0.2)
        assert at == pytest.approx([-0.05, 0.0, 0.0, 0.0, 0.15], abs=1e-6)


def test_a_proud_head_shows_its_wall_and_hides_the_gap_behind_it() -> None:
    towards, *_ = steps(1.0, 0.3, 0.0)
    assert towards[2] == pytest.approx(0.3)  # the wall ends
    assert towards[4] == pytest.approx(0.45)  # the gap's floor ends
    away, *_ = steps(1.0, -0.3, 0.0)
    assert away[1:] == pytest.approx([0.0, 0.0, 0.0, 0.0])


def test_a_shadow_lies_on_the_side_away_from_the_light() -> None:
    assert steps(1.0, 0.0, -0.4)[0][3] == pytest.approx(0.4)
    assert steps(1.0, 0.0, 0.4)[0][3] == pytest.approx(0.0)
    # In a sunk head the skin's edge throws it, on the side towards the light.
    assert steps(-1.0, 0.0, 0.4)[0][2] == pytest.approx(0.15 - 0.4)
    assert steps(-1.0, 0.0, -0.4)[0][2] == pytest.approx(0.15)


@pytest.mark.parametrize("height", [1.0, 0.2, -0.2, -0.8])
def test_steps_are_in_order_and_their_derivatives_right(height: float) -> None:
    for camera in np.linspace(-0.43, 0.43, 9):
        for light in np.linspace(-0.31, 0.31, 7):
            at, by_gap, by_edge, _ = steps(height, camera, light)
            assert (np.diff(at) >= -1e-12).all()
            d = 1e-7
            assert by_gap == pytest.approx((steps(height, camera, light, gap=0.15 + d)[0] - at) / d, abs=1e-4)
            assert by_edge == pytest.approx((steps(height, camera, light, edge=0.05 + d)[0] - at) / d, abs=1e-4)


@pytest.mark.parametrize("height", [0.8, -0.6])
def test_model_and_its_derivatives(height: float) -> None:
    unknowns = np.array([0.04, -0.03, -0.05, 0.12, 0.07, 0.25, 0.15, 0.15])
    c, k, m = 1, 7, 9

    def value(u: np.ndarray) -> tuple[float, np.ndarray]:
        at, by_gap, by_edge, level = np.empty(STEPS), np.empty(STEPS), np.empty(STEPS), np.zeros(STEPS + 1)
        towards = SLOPES[c] @ NORMALS[k], LIGHT @ NORMALS[k]
        rim_steps(height, *towards, *u[[GAP, BREAK, FLOOR, BLACK]], at, by_gap, by_edge, level)
        black = np.zeros(STEPS + 1, bool)
        black[[2, 3] if height > 0 else [3, 4]] = True
        row = np.empty(UNKNOWNS + 2)
        distance = DISTANCES[m] - u[RADIUS] - NORMALS[k] @ u[:2]
        return _model(distance, at, by_gap, by_edge, level, u[BLUR], 1.02, 0.97, *NORMALS[k], black, row), row

    model, row = value(unknowns)
    assert model == pytest.approx(profiles(height, unknowns, 1.02, 0.97)[c, k, m], abs=1e-6)
    for i in range(UNKNOWNS):
        moved = unknowns + 1e-5 * (np.arange(UNKNOWNS) == i)
        assert row[i] == pytest.approx((value(moved)[0] - model) / 1e-5, abs=2e-3)


@pytest.mark.parametrize("height", [1.0, 0.5, 0.0, -0.3, -0.8])
def test_fit_returns_centre_and_radius(height: float, rng: np.random.Generator) -> None:
    truth = np.array([0.04, -0.03, -0.05, 0.12, 0.07, 0.25, 0.15, 0.15])
    seen = profiles(height, truth, 1.02, 0.97) + rng.normal(0, 0.005, (2, len(NORMALS), len(DISTANCES)))
    start = np.array([0.0, 0.0, -0.075, 0.15, 0.08, 0.3, 0.15, 0.16])
    spread = np.array([1.0, 1.0, 1.0, 0.1, 0.08, 0.3, 0.07, 0.016])
    ends = np.stack([seen[..., :2].mean(axis=-1), seen[..., -2:].mean(axis=-1)], axis=-1)
    found = np.empty(UNKNOWNS + 1)
    assert fit_rim_kernel(
        seen, ends, DISTANCES[0], 0.1, NORMALS, height, SLOPES, LIGHT, start, spread, 20, found
    )  # fmt: skip
    assert found[:2] == pytest.approx(truth[:2], abs=0.004)
    if abs(height) >= 0.5:
        # What is hidden on one side and shown on the other tells the gap from its darkness.
        assert found[GAP] == pytest.approx(truth[GAP], abs=0.03)
        assert found[2] == pytest.approx(truth[2], abs=0.02)


def test_images_are_sampled_between_pixels() -> None:
    v, u = np.mgrid[:20, :30].astype(np.float32)
    pixels = np.array([[3.3, 4.7], [28.9, 18.2], [29.5, 3.0]])
    values = sample_image((2 * u - 3 * v).astype(np.float32), pixels)
    assert values[:2] == pytest.approx(2 * pixels[:2, 0] - 3 * pixels[:2, 1], abs=1e-4)
    assert np.isnan(values[2])


HEADS = (
    PanelRivet("R01", -22.0, 12.0, 8.0, 1.0, 0.1, 40.0),
    PanelRivet("R02", 22.0, 12.0, 8.0, -0.6, 0.2, 120.0),
    PanelRivet("R03", -22.0, -12.0, 8.0, 0.5, 0.1, 200.0, ring_width_mm=0.12),
    PanelRivet("R04", 22.0, -12.0, 8.0, 0.0, 0.1, 0.0),
)


@cache
def traced() -> tuple[Reconstruction, list[dict]]:
    """A small rig before four heads, turned so that the left camera looks from the side."""
    base = shipped_spec("standard_part")
    design = RigDesign(camera_width=460, camera_height=300, spread=0.0)
    placement = replace(base.placements[0], rotation_deg=(3.0, 9.0, 0.0))
    panel = Panel(120.0, 90.0, rivets=HEADS, surface=base.panel.surface)
    spec = replace(base, panel=panel, rig=replace(base.rig, design=design), placements=(placement,))
    stage = set_up(spec, make_rig(spec), placement)
    rng = np.random.default_rng(5)
    light = fringe_light(spec, stage, rng)
    left, right = (expose(spec, light[side], rng) for side in ("left", "right"))
    return reconstruct(left, right, stage.rig, spec.fringe, spec.camera.exposures), stage.truth.as_dict()["rivets"]


def nearest(rivets: list[Rivet], truth: dict) -> Rivet:
    return min(rivets, key=lambda r: np.hypot(r.u_px - truth["uv_px"][0], r.v_px - truth["uv_px"][1]))


def test_proud_and_sunk_heads_have_their_centres_in_space() -> None:
    """Walls and shadows pull the dark line by up to half a pixel; the head's centre stays within 0.015 mm."""
    cloud, truth = traced()
    detections = detect_rivets(cloud)
    rivets = measure_rivets(detections, cloud)
    assert len(rivets) == len(truth)
    for t in truth:
        rivet = nearest(rivets, t)
        assert [rivet.x_mm, rivet.y_mm, rivet.z_mm] == pytest.approx(t["xyz_mm"], abs=0.012)
        # The dark line's middle lies half a gap outside the head.
        ring = next(h.ring_width_mm for h in HEADS if h.id == t["id"])
        assert rivet.diameter_mm == pytest.approx(t["diameter_mm"] + ring, rel=0.01)

"""The joint adjustment: derivatives, truth within its covariance, and what the scale rests on."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from metrology.calibration.bundle import State, _Problem, adjust, lens_vector, on_plane, predict
from metrology.calibration.calibrate import projector_residuals
from metrology.calibration.distortion_model import PINHOLE, USUAL
from metrology.calibration.eccentricity import eccentricity
from metrology.calibration.lens import project
from metrology.calibration.observations import DeviceName, Sighting
from metrology.errors import CalibrationError
from tests.support.calibration_bench import bench_rig, bench_state, see, turn

FREE: dict[DeviceName, tuple[str, ...]] = dict.fromkeys(("left", "right", "projector"), PINHOLE + USUAL)


def without_eccentricity(state: State, sighting: Sighting) -> Sighting:
    if not sighting.radius.any():
        return sighting
    offset = eccentricity(lambda known: predict(state, sighting, known), sighting.known, sighting.radius)
    return replace(sighting, pixels=sighting.pixels - offset)


def test_projection_is_opencvs() -> None:
    rng = np.random.default_rng(1)
    device = bench_rig().left
    points = rng.uniform([-150, -110, 600], [150, 110, 800], (50, 3))
    assert project(points, lens_vector(device)).pixels == pytest.approx(device.project(points), abs=1e-9)


def test_derivatives_are_those_of_the_residuals() -> None:
    state = bench_state(bench_rig(), 2)
    rng = np.random.default_rng(2)
    seen = see(state, rng) + see(state, rng, devices=("projector",))
    problem = _Problem(state, seen, dict.fromkeys(state.devices, (*PINHOLE, *USUAL, "k3")))
    x = problem.pack()
    analytic = problem.jacobian(x)
    for k in range(len(x)):
        step = np.zeros_like(x)
        step[k] = 1e-6 * max(1.0, abs(x[k]))
        numeric = (problem.residuals(x + step) - problem.residuals(x - step)) / (2 * step[k])
        assert analytic[:, k] == pytest.approx(numeric, rel=1e-4, abs=1e-5 * np.abs(numeric).max()), problem.names[k]


def test_truth_lies_within_the_covariance() -> None:
    truth = bench_state(bench_rig())
    parameters = _Problem(truth, [], FREE).pack()
    deviations = []
    for seed in range(4):
        seen = [without_eccentricity(truth, s) for s in see(truth, np.random.default_rng(seed))]
        adjusted = adjust(truth, seen, FREE, robust=False)
        assert adjusted.chi2 / adjusted.freedom == pytest.approx(1, abs=0.06)
        found = _Problem(adjusted.state, [], FREE).pack()
        deviation = found - parameters
        n = len(deviation)
        deviations.append(deviation @ np.linalg.solve(adjusted.covariance, deviation) / n)
    # Each is χ² over its degrees of freedom.
    assert 0.6 < np.mean(deviations) < 1.5


def test_the_board_carries_the_scale() -> None:
    truth = bench_state(bench_rig(), 6)
    seen = [without_eccentricity(truth, s) for s in see(truth, np.random.default_rng(3))]
    larger = [replace(s, known=1.1 * s.known) if s.kind == "board" else s for s in seen]
    start = replace(
        truth,
        devices={name: replace(d, t=1.1 * d.t) for name, d in truth.devices.items()},
        translations={pose: 1.1 * t for pose, t in truth.translations.items()},
    )
    small, large = adjust(truth, seen, FREE).state, adjust(start, larger, FREE).state
    assert large.devices["right"].t == pytest.approx(1.1 * small.devices["right"].t, rel=1e-5)
    unscaled = large.devices["projector"].K
    assert unscaled == pytest.approx(small.devices["projector"].K, rel=1e-5, abs=1e-4)


def test_an_outlier_hardly_moves_a_robust_adjustment() -> None:
    truth = bench_state(bench_rig(), 6)
    seen = [without_eccentricity(truth, s) for s in see(truth, np.random.default_rng(4))]
    pixels = seen[0].pixels.copy()
    pixels[10] += 5.0
    spoilt = [replace(seen[0], pixels=pixels), *seen[1:]]
    plain = adjust(truth, seen, FREE).state.devices["left"].K
    robust = adjust(truth, spoilt, FREE).state.devices["left"].K
    crude = adjust(truth, spoilt, FREE, robust=False).state.devices["left"].K
    assert np.abs(robust - plain).max() < 0.1 * np.abs(crude - plain).max()


def test_a_dot_lies_where_the_projectors_ray_meets_the_board() -> None:
    rig = bench_rig()
    rotation, translation = turn(10, 20, 30), np.array([10.0, -20.0, 700.0])
    pixels = np.array([[100.0, 100.0], [640.0, 400.0], [1200.0, 700.0]])
    points = on_plane(rig.projector, pixels, rotation, translation)
    assert rig.projector.project(points) == pytest.approx(pixels, abs=1e-6)
    assert (points - translation) @ rotation[:, 2] == pytest.approx(0, abs=1e-9)


def test_projector_residuals_of_perfect_dots_vanish() -> None:
    state = bench_state(bench_rig(), 1)
    dots = [without_eccentricity(state, s) for s in see(state, np.random.default_rng(5), 0.0) if s.kind == "dots"]
    for sighting in dots:
        assert projector_residuals(state, sighting) == pytest.approx(0, abs=1e-5)


def test_parallel_boards_leave_the_focal_length_undetermined() -> None:
    truth = bench_state(bench_rig(), 4)
    flat = replace(truth, rotations=dict.fromkeys(truth.rotations, np.eye(3)))
    flat = replace(flat, devices={"left": flat.devices["left"]})
    seen = [without_eccentricity(flat, s) for s in see(flat, np.random.default_rng(6), devices=("left",), dots=False)]
    with pytest.raises(CalibrationError, match="tilted in different ways"):
        adjust(flat, seen, {"left": PINHOLE}, robust=False)


def test_rotation_vectors_near_half_a_turn_have_their_derivative() -> None:
    from metrology.calibration.lens import left_jacobian

    vector = np.array([0.1, -3.0, 0.4])
    step = np.array([1e-6, 2e-6, -1e-6])
    turned = cv2.Rodrigues(left_jacobian(vector) @ step)[0] @ cv2.Rodrigues(vector)[0]
    assert cv2.Rodrigues(vector + step)[0] == pytest.approx(turned, abs=1e-10)

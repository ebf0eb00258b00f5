"""Planes and quadrics: truth comes back, outliers do not matter, the covariance is that of the scatter."""

from __future__ import annotations

import numpy as np
import pytest

from metrology.surfaces import Frame, fit_surface, monomials

QUADRIC = np.array([0.12, 0.004, -0.007, 3e-4, -1e-4, 2e-4])


def scattered(rng: np.random.Generator, n: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    return rng.uniform(-8, 8, n), rng.uniform(-8, 8, n)


@pytest.mark.parametrize(("order", "unknowns"), [(1, 3), (2, 6), (3, 10)])
def test_polynomial_comes_back_exactly_without_noise(rng: np.random.Generator, order: int, unknowns: int) -> None:
    x, y = scattered(rng)
    truth = rng.normal(size=unknowns) * 10.0 ** -np.arange(unknowns)
    fit = fit_surface(x, y, monomials(x, y, order) @ truth, np.full(x.shape, 0.01), order, rng)
    assert fit is not None
    assert fit.coefficients == pytest.approx(truth, abs=1e-9)


def test_a_third_of_outliers_does_not_move_the_surface(rng: np.random.Generator) -> None:
    x, y = scattered(rng)
    h = monomials(x, y, 2) @ QUADRIC + rng.normal(0, 0.01, x.shape)
    h[: len(h) // 3] += rng.uniform(0.1, 2.0, len(h) // 3)
    fit = fit_surface(x, y, h, np.full(x.shape, 0.01), 2, rng)
    assert fit is not None
    error = fit.height(x, y) - monomials(x, y, 2) @ QUADRIC
    assert np.abs(error).max() < 0.006
    assert (fit.weights[: len(h) // 3] > 0).mean() < 0.02


def test_covariance_predicts_the_scatter_of_height_and_slope(rng: np.random.Generator) -> None:
    found, predicted = [], []
    x, y = scattered(rng, 300)
    sigma = rng.uniform(0.005, 0.03, x.shape)
    for _ in range(300):
        fit = fit_surface(x, y, monomials(x, y, 2) @ QUADRIC + rng.normal(0, sigma), sigma, 2, rng, trials=20)
        assert fit is not None
        value, covariance = fit.tangent(1.0, -2.0)
        found.append(value)
        predicted.append(np.sqrt(np.diag(covariance)))
    ratio = np.std(found, axis=0) / np.mean(predicted, axis=0)
    assert ratio == pytest.approx(np.ones(3), abs=0.15)


def test_weights_follow_sigma(rng: np.random.Generator) -> None:
    """Half of the points are ten times as noisy: they must hardly add to the error of the others alone."""
    x, y = scattered(rng, 400)
    sigma = np.where(np.arange(400) < 200, 0.005, 0.05)
    errors = []
    for _ in range(100):
        fit = fit_surface(x, y, rng.normal(0, sigma), sigma, 1, rng, trials=20)
        assert fit is not None
        errors.append(fit.coefficients[0])
    assert np.std(errors) < 1.2 * 0.005 / np.sqrt(200)


def test_tangent_is_the_derivative(rng: np.random.Generator) -> None:
    x, y = scattered(rng)
    fit = fit_surface(x, y, monomials(x, y, 2) @ QUADRIC, np.full(x.shape, 0.01), 2, rng)
    assert fit is not None
    (h, by_x, by_y), _ = fit.tangent(2.0, -3.0)
    step = 1e-4
    assert h == pytest.approx(float(fit.height(2.0, -3.0)))
    assert by_x == pytest.approx(float(fit.height(2 + step, -3.0) - fit.height(2 - step, -3.0)) / (2 * step))
    assert by_y == pytest.approx(float(fit.height(2.0, -3 + step) - fit.height(2.0, -3 - step)) / (2 * step))


def test_too_few_points_or_points_on_a_line_give_nothing(rng: np.random.Generator) -> None:
    line = np.linspace(0, 5, 100)
    sigma = np.full(100, 0.01)
    assert fit_surface(line[:5], line[:5], line[:5], sigma[:5], 1, rng) is None
    assert fit_surface(line, np.zeros(100), line, sigma, 1, rng) is None


def test_same_seed_same_surface(rng: np.random.Generator) -> None:
    x, y = scattered(rng)
    h = monomials(x, y, 2) @ QUADRIC + rng.normal(0, 0.02, x.shape)
    once, again = (fit_surface(x, y, h, np.full(x.shape, 0.02), 2, np.random.default_rng(3)) for _ in range(2))
    assert once is not None
    assert again is not None
    assert (once.coefficients == again.coefficients).all()


def test_frame_is_right_handed_looks_at_the_rig_and_inverts() -> None:
    frame = Frame.on_plane([10.0, -5.0, 700.0], [0.2, -0.1, 1.0])
    assert np.linalg.det(frame.axes) == pytest.approx(1.0)
    assert frame.axes[2, 2] < 0
    points = np.array([[12.0, 3.0, 690.0], [0.0, 0.0, 705.0]])
    assert frame.rig(frame.local(points)) == pytest.approx(points)


def test_height_sigma_is_the_part_of_the_ray_along_the_normal() -> None:
    """A point moved along its ray by δz rises by δz (ray · n)."""
    frame = Frame.on_plane([0.0, 0.0, 700.0], [0.3, 0.1, 1.0])
    point = np.array([[80.0, -40.0, 690.0]])
    moved = point + 0.01 * point / point[:, 2:]
    rise = frame.local(moved)[0, 2] - frame.local(point)[0, 2]
    assert frame.height_sigma(point, [0.01])[0] == pytest.approx(abs(rise))

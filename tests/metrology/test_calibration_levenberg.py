"""The adjustment's solver against scipy's, on problems with known answers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from metrology.arrays import Array
from metrology.calibration.levenberg import minimise
from metrology.errors import CalibrationError


def rosenbrock(x: Array) -> Array:
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def rosenbrock_slope(x: Array) -> Array:
    return np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


def test_a_curved_valley_is_followed_to_its_end() -> None:
    assert minimise(rosenbrock, rosenbrock_slope, np.array([-1.2, 1.0]), None) == pytest.approx([1, 1], abs=1e-5)


def test_hubers_loss_agrees_with_scipy() -> None:
    rng = np.random.default_rng(1)
    t = np.linspace(0, 3, 200)
    y = 2.5 * np.exp(-1.3 * t) + rng.normal(0, 0.02, t.size)
    y[::17] += 1.0

    def residuals(x: Array) -> Array:
        return (x[0] * np.exp(-x[1] * t) - y) / 0.02

    def slope(x: Array) -> Array:
        decay = np.exp(-x[1] * t)
        return np.column_stack([decay, -x[0] * t * decay]) / 0.02

    ours = minimise(residuals, slope, np.array([1.0, 1.0]), 3.0)
    scipys = least_squares(residuals, [1.0, 1.0], jac=slope, loss="huber", f_scale=3.0, xtol=1e-12, ftol=1e-12).x
    assert ours == pytest.approx(scipys, rel=1e-5)
    assert minimise(residuals, slope, np.array([1.0, 1.0]), None)[1] < ours[1] - 0.02


def test_a_start_from_which_nothing_can_be_seen_is_an_error() -> None:
    with pytest.raises(CalibrationError, match="start values"):
        minimise(lambda x: np.array([np.nan]), lambda x: np.eye(1), np.zeros(1), None)

"""Robust fits: outliers do not move them, and noise scatters them as little as it must."""

from __future__ import annotations

import numpy as np
import pytest

from metrology.robust import fit_circle, from_scratch


def test_a_third_of_the_points_elsewhere_does_not_move_a_line(rng: np.random.Generator) -> None:
    x = np.linspace(-1, 1, 300)
    y = 2.0 + 0.5 * x + rng.normal(0, 0.01, 300)
    y[::3] -= 0.8
    found = from_scratch(np.column_stack([np.ones_like(x), x]), y, absolute=7, iterations=12)
    assert found is not None
    assert found.values == pytest.approx([2.0, 0.5], abs=0.01)
    assert (found.weights[::3] == 0).all()


def test_points_that_tell_no_model_give_none() -> None:
    assert from_scratch(np.ones((20, 2)), np.arange(20.0), absolute=7, iterations=12) is None


def test_a_circle_is_found_through_two_thirds_of_its_points(rng: np.random.Generator) -> None:
    turn = rng.uniform(0, 2 * np.pi, 120)
    radius = np.where(np.arange(120) < 80, 3.0, 2.2) + rng.normal(0, 0.01, 120)
    found = fit_circle(0.4 + radius * np.cos(turn), -0.2 + radius * np.sin(turn), least=0.004)
    assert found is not None
    assert (found.x, found.y, found.radius) == pytest.approx((0.4, -0.2, 3.0), abs=0.006)
    assert (found.weights > 0).sum() == pytest.approx(80, abs=2)

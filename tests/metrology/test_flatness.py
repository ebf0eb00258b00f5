"""Flatness of points whose plane, bow and noise are known."""

from __future__ import annotations

import numpy as np
import pytest

from metrology.flatness import flatness


def tilted(h: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Points h above a plane that is tilted by 20° and stands 700 mm away."""
    c, s = np.cos(0.35), np.sin(0.35)
    return np.stack([c * x - s * h, y, 700 + s * x + c * h], axis=1)


@pytest.fixture
def places() -> tuple[np.ndarray, np.ndarray]:
    return tuple(a.ravel() for a in np.meshgrid(np.linspace(-20, 20, 81), np.linspace(-15, 15, 61)))  # type: ignore[return-value]


def test_noise_of_a_plane_is_found(places: tuple[np.ndarray, np.ndarray]) -> None:
    x, y = places
    rng = np.random.default_rng(2)
    off = 0.010 * rng.standard_normal(len(x))
    off[:20] = 1.0  # a chip
    found = flatness(tilted(off, x, y), np.full(len(x), 0.010 / np.cos(0.35)), rng)
    assert found is not None
    assert found.rms_mm == pytest.approx(0.010, rel=0.05)
    assert found.range_mm == pytest.approx(2 * 2.576 * 0.010, rel=0.1)
    assert found.noise_ratio == pytest.approx(1.0, abs=0.07)
    assert found.bow_mm < 0.003


def test_a_bow_is_told_from_noise(places: tuple[np.ndarray, np.ndarray]) -> None:
    x, y = places
    rng = np.random.default_rng(3)
    points = tilted(-(x**2) / (2 * 2000) + 0.001 * rng.standard_normal(len(x)), x, y)
    found = flatness(points, np.full(len(x), 0.001), rng)
    assert found is not None
    assert found.bow_mm == pytest.approx(20**2 / (2 * 2000), rel=0.02)
    assert found.noise_ratio == pytest.approx(1.0, abs=0.1)


def test_too_few_points_are_no_plane() -> None:
    assert flatness(np.eye(3)[:2] + 700, np.ones(2), np.random.default_rng(1)) is None
    assert flatness(np.eye(3) + 700, np.ones(3), np.random.default_rng(1)) is None

"""By how much correlated noise and wavy skin raise the variance of heights and slopes."""

from __future__ import annotations

import numpy as np
import pytest

from metrology.rivets import RivetSettings, detect_rivets, inflation, measure_rivets
from metrology.rivets.fits import Fits
from metrology.rivets.inflation import block_inflation, noise_inflation
from metrology.rivets.patch import Patch
from metrology.surfaces import Frame, fit_surface
from tests.support.rivet_scan import Head, Skin, scan

SIDE = 160


def patch_of(noise: np.ndarray) -> Fits:
    """A flat head and skin of SIDE × SIDE pixels with the given noise, in units of σ."""
    v, u = np.mgrid[:SIDE, :SIDE].reshape(2, -1)
    x, y = (u - SIDE / 2) / 5, (v - SIDE / 2) / 5
    h, sigma = 0.01 * noise.ravel(), np.full(u.size, 0.01)
    r = np.hypot(x, y)
    inner, outer = r < 4, r > 5
    always = np.ones(u.size, bool)
    rng = np.random.default_rng(0)
    head = fit_surface(x[inner], y[inner], h[inner], sigma[inner], 1, rng)
    skin = fit_surface(x[outer], y[outer], h[outer], sigma[outer], 2, rng)
    assert head is not None
    assert skin is not None
    frame = Frame(np.zeros(3), np.eye(3))
    return Fits(Patch(frame, 4.5, 0.5, 2.5, x, y, h, sigma, u, v, always, ~always), inner, outer, head, skin)


def test_independent_noise_is_not_inflated(rng: np.random.Generator) -> None:
    fits = [patch_of(rng.normal(size=(SIDE, SIDE))) for _ in range(4)]
    assert block_inflation(fits) == pytest.approx(1.0, abs=0.15)


def test_a_moving_mean_of_n_pixels_inflates_n_fold(rng: np.random.Generator) -> None:
    """Three pixels' mean, scaled back to unit variance, keeps the sums: a mean's variance is three times σ²/n."""
    fits = []
    for _ in range(4):
        white = rng.normal(size=(SIDE, SIDE + 2))
        fits.append(patch_of((white[:, :-2] + white[:, 1:-1] + white[:, 2:]) / np.sqrt(3)))
    assert block_inflation(fits) == pytest.approx(3.0, rel=0.15)


def test_controls_count_as_far_as_they_are_significant(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inflation, "block_inflation", lambda fits: 1.5)
    plain = [patch_of(rng.normal(size=(SIDE, SIDE))) for _ in range(6)]
    assert noise_inflation(plain, plain).height < 2.0
    # Heads that stand up to 30 µm off the skin where there are none: waves of the skin.
    lifted = []
    for k in range(6):
        noise = rng.normal(size=(SIDE, SIDE))
        v, u = np.mgrid[:SIDE, :SIDE] - SIDE / 2
        noise[np.hypot(u, v) < 21] += 0.6 * (k - 2.5)
        lifted.append(patch_of(noise))
    assert noise_inflation(plain, lifted).height > 50
    assert noise_inflation(plain, []).height == 1.5


def test_u95_follows_the_noise() -> None:
    """Twice the noise of the cloud, twice the limits."""
    limits = []
    for sigma in (0.01, 0.02):
        cloud = scan(Skin(sigma_z=sigma), [Head(0, 0, 9.0, 0.1)], np.random.default_rng(3))
        (rivet,) = measure_rivets(detect_rivets(cloud), cloud, (), RivetSettings(controls=0))
        limits.append(rivet.height_u95_mm)
    assert limits[1] / limits[0] == pytest.approx(2.0, rel=0.1)

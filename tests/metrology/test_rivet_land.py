"""Small recessed heads: blur mixes all points of their land with recess or skin, and the plane is told all the same."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter

from metrology.rivets.head import head_surface
from metrology.rivets.land import land_surface
from metrology.rivets.patch import Patch
from metrology.rivets.settings import RivetSettings
from metrology.surfaces import Frame

PIXEL, DIAMETER, SIGMA_PX, NOISE = 0.227, 4.8, 0.8, 0.015
FINE = 5  # parts of a pixel by which the scan is made


def recess(x: np.ndarray, y: np.ndarray, kind: str) -> np.ndarray:
    """Where a recess is open: a cross over six tenths of the head, or a hexagon over nine twentieths."""
    turned = 0.4
    u, v = np.cos(turned) * x + np.sin(turned) * y, np.cos(turned) * y - np.sin(turned) * x
    if kind == "cross":
        arm, half = 0.3 * DIAMETER, 0.06 * DIAMETER
        return ((np.abs(u) < arm) & (np.abs(v) < half)) | ((np.abs(v) < arm) & (np.abs(u) < half))
    ways = np.radians([0, 60, 120])
    return np.max([np.abs(np.cos(w) * u + np.sin(w) * v) for w in ways], axis=0) < 0.225 * DIAMETER


def patch(kind: str, height: float, tilt_deg: float, depth: float, rng: np.random.Generator) -> Patch:
    """A head's points: half as the left picture's blur makes them, half as the right one's with the matched window."""
    half = 45
    fine = (np.arange(-half * FINE, (half + 1) * FINE) + 0.5) / FINE * PIXEL - 0.5 * PIXEL
    x, y = np.meshgrid(fine, fine)
    on_head = np.hypot(x, y) < DIAMETER / 2
    truth = np.where(on_head, height + np.tan(np.radians(tilt_deg)) * x - depth * recess(x, y, kind), 0.0)
    left = gaussian_filter(truth, SIGMA_PX * FINE)
    mixed = 0.5 * (left + uniform_filter(left, (3 * FINE, 5 * FINE)))
    mean = mixed[: (2 * half + 1) * FINE, : (2 * half + 1) * FINE].reshape(2 * half + 1, FINE, 2 * half + 1, FINE)
    h = mean.mean(axis=(1, 3)) + NOISE * rng.standard_normal((2 * half + 1, 2 * half + 1))
    v, u = np.mgrid[: 2 * half + 1, : 2 * half + 1]
    near = np.hypot(u - half, v - half) < half
    u, v, h = u[near], v[near], h[near]
    settings = RivetSettings()
    guard_px = settings.guard_px + settings.guard_sigmas * SIGMA_PX
    every = np.ones(len(u), bool)
    return Patch(
        Frame(np.zeros(3), np.eye(3)), DIAMETER / 2, guard_px * PIXEL, guard_px, (u - half) * PIXEL, (v - half) * PIXEL,
        h, np.full(len(u), NOISE), u, v, every, ~every,
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["cross", "hex"])
@pytest.mark.parametrize(("height", "tilt_deg", "depth"), [(0.1, 0.0, 0.6), (-0.06, 0.4, 1.0), (0.02, 0.3, 0.35)])
def test_the_land_of_a_small_head_is_told_within_its_uncertainty(
    kind: str, height: float, tilt_deg: float, depth: float, rng: np.random.Generator
) -> None:
    """No point is clear of both edges, and the land's own points, taken as they are, would read tens of µm low."""
    scanned, settings = patch(kind, height, tilt_deg, depth, rng), RivetSettings()
    r = np.hypot(scanned.x, scanned.y)
    skin = scanned.surface(r > DIAMETER / 2 + scanned.guard, 2, rng)
    inner = r < max(DIAMETER / 2 - scanned.guard, DIAMETER / 4)
    surface, _ = head_surface(scanned, inner, skin, settings, rng)
    (found, by_x, by_y), covariance = surface.tangent(0.0, 0.0)
    assert abs(found - height) < min(0.012, 3 * np.sqrt(covariance[0, 0]))
    assert abs(by_x - np.tan(np.radians(tilt_deg))) < 3 * np.sqrt(covariance[1, 1])
    assert abs(by_y) < 3 * np.sqrt(covariance[2, 2])
    assert np.sqrt(covariance[0, 0]) < 0.03


def test_a_head_of_which_the_recess_leaves_no_land_is_not_measured(rng: np.random.Generator) -> None:
    scanned = patch("hex", 0.1, 0.0, 0.6, rng)
    r = np.hypot(scanned.x, scanned.y)
    skin = scanned.surface(r > DIAMETER / 2 + scanned.guard, 2, rng)
    sunk = np.where((r < 0.95 * DIAMETER / 2) & (r > 0.3 * DIAMETER), np.nan, scanned.h)
    gone = Patch(**{**vars(scanned), "h": sunk, "usable": np.isfinite(sunk)})
    assert isinstance(land_surface(gone, skin, SIGMA_PX), str)


def test_what_a_recess_mixes_into_the_land_does_not_pull_it_down(rng: np.random.Generator) -> None:
    """Each head is told to some µm; many of them have no error in common."""
    errors = []
    for height, tilt_deg, depth in ((0.1, 0.0, 0.7), (-0.06, 0.4, 0.35), (0.02, 0.3, 0.5)) * 3:
        scanned = patch("hex", height, tilt_deg, depth, rng)
        skin = scanned.surface(np.hypot(scanned.x, scanned.y) > DIAMETER / 2 + scanned.guard, 2, rng)
        surface, _ = land_surface(scanned, skin, SIGMA_PX)
        errors.append(surface.height(0.0, 0.0) - height)
    assert abs(np.mean(errors)) < 0.0045


def test_a_recess_that_fills_all_that_is_clear_of_the_rim_is_not_taken_for_the_head(rng: np.random.Generator) -> None:
    scanned, settings = patch("hex", 0.05, 0.0, 0.4, rng), RivetSettings()
    r = np.hypot(scanned.x, scanned.y)
    skin = scanned.surface(r > DIAMETER / 2 + scanned.guard, 2, rng)
    surface, _ = head_surface(scanned, r < 0.6, skin, settings, rng)
    assert abs(surface.height(0.0, 0.0) - 0.05) < 0.012


def test_sealant_across_the_rim_of_a_recessed_head_is_no_land(rng: np.random.Generator) -> None:
    scanned = patch("cross", -0.05, 0.0, 0.6, rng)
    drop = np.clip((1.1 - np.hypot(scanned.x - 1.9, scanned.y)) / 0.3 + 0.5, 0.0, 1.0)
    scanned = Patch(**{**vars(scanned), "h": scanned.h + 0.5 * drop})
    skin = scanned.surface(np.hypot(scanned.x, scanned.y) > DIAMETER / 2 + scanned.guard, 2, rng)
    surface, _ = land_surface(scanned, skin, SIGMA_PX)
    assert abs(surface.height(0.0, 0.0) + 0.05) < 0.015

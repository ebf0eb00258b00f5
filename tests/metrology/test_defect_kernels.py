"""Compiled parts of how defects are measured, against plain twins."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solveh_banded

from metrology.defects.outline import crossings
from metrology.defects.reference import Reference
from metrology.defects.ruled_kernel import bin_medians, robust_polyline
from metrology.robust import MAD, TUKEY, tukey
from metrology.surfaces import Frame


def test_medians_of_bins(rng: np.random.Generator) -> None:
    low = rng.integers(0, 12, 200)
    low = low[(low != 3) & (low != 11)]
    values = rng.normal(size=len(low))
    found = bin_medians(low, values, 12)
    for b in set(range(12)) - {3, 11}:
        here = np.sort(values[low == b])
        assert found[b] == here[len(here) // 2]
    assert found[3] == pytest.approx(0.5 * (found[2] + found[4]))
    assert found[11] == found[10]


def test_robust_polyline_is_weighted_least_squares(rng: np.random.Generator) -> None:
    count, held = 9, 1e-3
    place = rng.uniform(0, count - 1.01, 400)
    low = place.astype(int)
    share = place - low
    sd = rng.uniform(0.5, 2.0, 400)
    values = np.sin(place) + 0.02 * sd * rng.normal(size=400)
    values[:30] += 3.0
    start = np.sin(np.arange(count))
    heights = start.copy()
    variance = robust_polyline(low, share, values, sd, held, heights)

    design = np.zeros((400, count))
    design[np.arange(400), low], design[np.arange(400), low + 1] = 1 - share, share
    own, w = start, np.ones(400)
    for number in range(4):
        if number:
            normal = design.T @ (design * w[:, None])
            hold = held * np.diag(normal).max() * (np.diff(np.eye(count), axis=0).T @ np.diff(np.eye(count), axis=0))
            banded = np.array([np.diag(normal + hold), [*np.diag(normal + hold, 1), 0.0]])
            own = solveh_banded(banded, design.T @ (w * values), lower=True)
        residual = np.abs(values - design @ own) / sd
        scale = MAD * np.sort(residual)[200]
        w = tukey(residual / (TUKEY * scale)) / sd**2
    assert heights == pytest.approx(own, abs=1e-9)
    assert variance == pytest.approx(scale**2 / (design.T @ w), rel=1e-6)
    assert heights == pytest.approx(np.sin(np.arange(count)), abs=0.08)


def test_a_references_height_solves_its_equation(rng: np.random.Generator) -> None:
    """h = design(x, y, h) · coefficients, for waves up to the eighth degree."""
    waves = np.array([(i, j) for i in range(9) for j in range(9) if 3 <= i + j <= 8])
    c = np.concatenate([0.05 * rng.normal(size=6), [0.3], 0.01 * rng.normal(size=len(waves))])
    frame = Frame(np.zeros(3), np.eye(3))
    reference = Reference(frame, np.array([60.0, 90.0]), waves, c, np.eye(len(c)))
    x, y = rng.uniform(-60, 60, 50), rng.uniform(-90, 90, 50)
    h = reference.smooth(x, y)
    assert reference.design(x, y, h) @ c * reference.extent == pytest.approx(h, abs=1e-9)
    points = np.stack([x, y, h + 0.1], axis=1)[None]
    depth = np.full((1, 50), np.nan)
    reference.depths(points, np.arange(50)[None] != 7, depth)
    assert np.isnan(depth[0, 7])
    assert (depth[0, :7] < 0).all()


def test_crossings_of_a_level() -> None:
    """A cone of radius 5 whose left part the view cuts off, and a bit of its right one a seam."""
    y, x = np.mgrid[-8.0:9.0, -8.0:9.0]
    depth = 1 - np.hypot(x, y) / 10
    plate = (x > -4) & (x < 5)
    cells = (depth > 0.5) & plate
    at = np.empty((2, 4 * int(cells.sum())))
    on_plate, by_view, by_seam = crossings(depth, 0.5, cells, plate, x < 0, x, y, *at)
    assert np.hypot(*at[:, :on_plate]) == pytest.approx(5.0, abs=0.1)
    assert by_view == (cells[:, 5] & ~plate[:, 4]).sum()
    assert by_seam == (cells[:, 12] & ~plate[:, 13]).sum()
    # What the window's border cuts off is cut off by the view.
    part = np.s_[:, 4:9]
    whole = crossings(*(np.ascontiguousarray(a[part]) if np.ndim(a) else a for a in (depth, 0.5, cells, plate)),
                      *(np.ascontiguousarray(a[part]) for a in (x < 0, x, y)), *at)  # fmt: skip
    assert whole[1] == by_view + cells[:, 8].sum()

"""Compiled parts of how defects are measured, against plain twins."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from metrology.defects.outline import crossings
from metrology.defects.reference import Reference
from metrology.defects.ruled_kernel import add_polylines, bin_medians, stiffest
from metrology.defects.split import bottoms
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


def polyline(low: np.ndarray, share: np.ndarray, count: int) -> np.ndarray:
    """Columns of a polyline, plainly."""
    every, columns = np.arange(len(low)), np.zeros((len(low), count))
    columns[every, low], columns[every, low + 1] = 1 - share, share
    return columns


def test_polylines_are_columns_of_normal_equations(rng: np.random.Generator) -> None:
    design, weights, target, lever = rng.normal(size=(300, 3)), *rng.uniform(0.5, 2.0, (3, 300))
    place = rng.uniform(0, [[5.0], [3.0]], (2, 300))
    low, share = place.astype(int), place % 1
    lines = [lever[:, None] * polyline(low[k], share[k], count) for k, count in enumerate((6, 4))]
    whole = np.hstack([design, *lines])
    normal, right = np.zeros((13, 13)), np.zeros(13)
    normal[:3, :3], right[:3] = design.T @ (design * weights[:, None]), design.T @ (weights * target)
    add_polylines(low + np.array([[3], [9]]), share, lever, design, weights, target, normal, right)
    assert np.triu(normal) == pytest.approx(np.triu(whole.T @ (whole * weights[:, None])))
    assert right == pytest.approx(whole.T @ (weights * target))


@pytest.mark.parametrize("bend", [1e-4, 1e-2])
def test_values_tell_how_stiff_a_polyline_is(rng: np.random.Generator, bend: float) -> None:
    """Heights drawn with second differences of a known size; the evidence is that of the plain Gaussian model."""
    count, scale, least = 120, 0.004, 1e-5
    heights = np.cumsum(np.cumsum(bend * rng.normal(size=count)))
    place = rng.uniform(0, count - 1.01, 2400)
    columns = polyline(place.astype(int), place % 1, count)
    values = columns @ heights + scale * rng.normal(size=2400)
    normal, right = columns.T @ columns, columns.T @ values
    found = stiffest(np.diag(normal).copy(), np.append(np.diag(normal, 1), 0.0), right, scale, least)
    assert scale / np.sqrt(found) == pytest.approx(bend, rel=0.9)

    def evidence(stiffness: float) -> float:
        bends = np.diff(np.eye(count), 2, axis=0)
        whole = normal + stiffness * bends.T @ bends
        best = right @ np.linalg.solve(whole, right) / scale**2
        return float((count - 2) * np.log(stiffness) - np.linalg.slogdet(whole)[1] + best)

    tried = [(scale / least) ** 2 / 10.0**k for k in range(9)]
    assert found == pytest.approx(max(tried, key=evidence))


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
    at, skin = np.empty((3, 4 * int(cells.sum()))), y > -4
    on_plate, by_view, by_seam = crossings(depth, 0.5, cells, plate, x < 0, skin, x, y, *at)
    assert np.hypot(*at[:2, :on_plate]) == pytest.approx(5.0, abs=0.1)
    assert (at[2, :on_plate] == (at[1, :on_plate] >= -3)).all()  # a head hides the topmost part
    assert by_view == (cells[:, 5] & ~plate[:, 4]).sum()
    assert by_seam == (cells[:, 12] & ~plate[:, 13]).sum()
    # What the window's border cuts off is cut off by the view.
    part = np.s_[:, 4:9]
    whole = crossings(*(np.ascontiguousarray(a[part]) if np.ndim(a) else a for a in (depth, 0.5, cells, plate)),
                      *(np.ascontiguousarray(a[part]) for a in (x < 0, skin, x, y)), *at)  # fmt: skip
    assert whole[1] == by_view + cells[:, 8].sum()


def test_basins_are_filled_up_to_their_ridges(rng: np.random.Generator) -> None:
    """Each part holds, as one piece, what a level just above the ridge to the next one leaves round its bottom."""
    y, x = np.mgrid[0:40, 0:60]
    middles = ((12.0, 20.0, 1.0), (33.0, 20.0, 0.6), (33.0, 36.0, 0.05))
    bumps = [d * np.exp(-0.5 * ((x - u) ** 2 + (y - v) ** 2) / 36.0) for u, v, d in middles]
    depth = np.sum(bumps, axis=0) + 1e-4 * rng.normal(size=x.shape)
    member = depth > 0.02
    parts = bottoms(depth, member, np.full(depth.shape, 0.03), 8)
    assert (np.sum(parts, axis=0) == member).all()
    assert len(parts) == 2  # the third does not stand out
    ridge = float(depth[20, 12:34].min())
    _, labels = cv2.connectedComponents((depth > ridge + 1e-3).astype(np.uint8), connectivity=4)
    for u in (12, 33):
        (part,) = (p for p in parts if p[20, u])
        assert part[labels == labels[20, u]].all()

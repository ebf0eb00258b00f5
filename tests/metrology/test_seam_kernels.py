"""Compiled kernels of seam detection against plain numpy: line points, linking, the band model and its fit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import convolve1d
from scipy.optimize import least_squares

from metrology.ridges import RidgeMap, gaussian_kernels, ridge_points
from metrology.seams.blur import EdgeResponse, PixelBlur
from metrology.seams.finding.band_kernel import (
    borders_at_nodes,
    gather,
    model,
    normal_equations,
    start_levels,
)
from metrology.seams.finding.bands import fit_bands
from metrology.seams.finding.linking import link
from metrology.seams.finding.medians import row_medians
from metrology.seams.finding.segments import _longest_run
from tests.support.seam_textures import Band, paint


def test_line_points(rng):
    image = paint([Band((60, 50), 30, 6.0, 40.0), Band((60, 50), 100, 5.0, -30.0)], (100, 120), rng)
    found = ridge_points(image, 1.5, 1.0, "both", threads=1)
    smooth, first, second = (k.astype(float) for k in gaussian_kernels(1.5))

    def filtered(along_u, along_v):
        # Derivatives are correlations: an odd kernel turns round in a convolution.
        rows = convolve1d(image.astype(float), along_u[::-1], axis=1, mode="mirror")
        return convolve1d(rows, along_v[::-1], axis=0, mode="mirror")

    gradient = np.stack([filtered(first, smooth), filtered(smooth, first)], axis=-1)
    mixed = filtered(first, first)
    hessian = np.stack(
        [np.stack([filtered(second, smooth), mixed], axis=-1), np.stack([mixed, filtered(smooth, second)], axis=-1)],
        axis=-1,
    )
    values, vectors = np.linalg.eigh(hessian)
    strongest = np.abs(values).argmax(axis=-1)
    curvature = np.take_along_axis(values, strongest[..., None], axis=-1)[..., 0]
    normal = np.take_along_axis(vectors, strongest[..., None, None], axis=-1)[..., 0]
    t = -np.sum(gradient * normal, axis=-1) / curvature
    held = (np.abs(curvature) > 1.0) & (np.abs(t[..., None] * normal).max(axis=-1) <= 0.6)
    agree = (found.strength != 0) == held
    # Single precision decides some points on the limits differently.
    assert agree.mean() > 0.999
    both = held & (found.strength != 0)
    assert both.sum() > 150
    assert np.allclose(found.strength[both], curvature[both], rtol=1e-3, atol=1e-3)
    v, u = np.nonzero(both)
    assert np.abs(found.u[both] - (u + (t * normal[..., 0])[both])).max() < 2e-3
    assert np.abs(found.v[both] - (v + (t * normal[..., 1])[both])).max() < 2e-3


def link_in_numpy(ridges: RidgeMap, high: float, min_points: int) -> list[list[tuple[int, int]]]:
    """The rule of `linking` point by point: pixels (row, column) of each chain."""
    height, width = ridges.strength.shape
    used = np.zeros((height, width), bool)
    order = np.argsort(-np.abs(ridges.strength).ravel(), kind="stable")
    chains = []
    for seed in order[np.abs(ridges.strength).ravel()[order] > high]:
        start = divmod(int(seed), width)
        if used[start]:
            continue
        used[start] = True
        ways = []
        for way in (1, -1):
            at, trail = start, []
            tangent = way * np.array([-ridges.normal_v[at], ridges.normal_u[at]])
            while True:
                best = None
                for r in range(max(0, at[0] - 2), min(height, at[0] + 3)):
                    for c in range(max(0, at[1] - 2), min(width, at[1] + 3)):
                        if used[r, c] or ridges.strength[r, c] * ridges.strength[at] <= 0:
                            continue
                        d = np.array([ridges.u[r, c] - ridges.u[at], ridges.v[r, c] - ridges.v[at]])
                        distance = np.linalg.norm(d) + 1e-9
                        ahead = d @ tangent / distance
                        parallel = abs(
                            ridges.normal_u[r, c] * ridges.normal_u[at] + ridges.normal_v[r, c] * ridges.normal_v[at]
                        )
                        if ahead < 0.7 or parallel < 0.85:
                            continue
                        price = distance + 1.5 * np.arccos(min(parallel, 1.0)) + 1.0 - ahead
                        if best is None or price < best[0]:
                            best = (price, r, c)
                if best is None:
                    break
                used[max(0, at[0] - 1) : at[0] + 2, max(0, at[1] - 1) : at[1] + 2] = True
                onward = np.array([-ridges.normal_v[best[1:]], ridges.normal_u[best[1:]]])
                tangent = onward if onward @ tangent >= 0 else -onward
                at = best[1:]
                used[at] = True
                trail.append(at)
            ways.append(trail)
        chain = [*ways[1][::-1], start, *ways[0]]
        if len(chain) >= min_points:
            chains.append(chain)
    return chains


def test_linking(rng):
    image = paint([Band((60, 50), 30, 3.0, 40.0, bow_px=2.0), Band((60, 50), 100, 3.0, -30.0)], (100, 120), rng)
    ridges = ridge_points(image, 1.5, 1.0, "both", threads=1)
    found = link(ridges, 3.0, 5)
    expected = link_in_numpy(ridges, 3.0, 5)
    assert len(found) == len(expected) > 1
    for chain, pixels in zip(found, expected, strict=True):
        rows, columns = np.array(pixels).T
        assert np.array_equal(chain[:, 0], ridges.u[rows, columns].astype(float))
        assert np.array_equal(chain[:, 1], ridges.v[rows, columns].astype(float))
        # A chain keeps to one polarity.
        assert np.ptp(np.sign(chain[:, 2])) == 0


RESPONSE = EdgeResponse.along((0.9, 0.3), PixelBlur(0.6, 0.05))


def step(x):
    """The blurred step and its derivative by interpolation of the table."""
    grid = RESPONSE.step * (np.arange(len(RESPONSE.values)) - len(RESPONSE.values) // 2)
    return np.interp(x, grid, RESPONSE.values), np.interp(x, grid, RESPONSE.slopes)


def bands_in_numpy(x, levels, slopes, edges):
    """I(x) of `bands`."""
    s = [step(x - edge)[0] for edge in edges]
    value = levels[0] + slopes[0] * (x - edges[0]) * (1 - s[0]) + slopes[1] * (x - edges[-1]) * s[-1]
    return value + sum((levels[k + 1] - levels[k]) * s[k] for k in range(len(edges)))


def test_band_model_and_its_derivatives(rng):
    edges, ties = np.array([-3.0, 0.5, 4.0]), np.array([[1.0, 0], [0.5, 0.5], [0, 1.0]])
    parameters = np.array([120.0, 40, 60, 110, 0.8, -0.5, 0.3, -0.2])
    table = np.stack([RESPONSE.values, RESPONSE.slopes])

    def at(x, p):
        jacobian = np.zeros(8)
        return model(x, edges, ties, RESPONSE.step, table, p, jacobian), jacobian

    for x in rng.uniform(-8, 8, 60):
        value, jacobian = at(x, parameters)
        plain = bands_in_numpy(x, parameters[:4], parameters[4:6], edges + ties @ parameters[6:])
        # The kernel interpolates the table by cubics.
        assert value == pytest.approx(plain, abs=0.02)
        steps = 1e-4 * np.eye(8)
        numeric = [(at(x, parameters + h)[0] - at(x, parameters - h)[0]) / 2e-4 for h in steps]
        assert jacobian == pytest.approx(numeric, abs=0.05)


def test_normal_equations_and_their_solution(rng):
    x, counts = np.sort(rng.uniform(-8, 8, 80)), rng.integers(1, 5, 80).astype(float)
    edges, ties = np.array([-2.0, 2.0]), np.eye(2)
    parameters = np.array([100.0, 50, 90, 0.2, 0.1, 0.1, 0.0])
    grey = bands_in_numpy(x, parameters[:3], parameters[3:5], edges) + rng.normal(0, 2, 80)
    grey[7] += 80.0
    table = np.stack([RESPONSE.values, RESPONSE.slopes])
    free = np.array([1, 1, 1, 1, 0, 1, 1], bool)
    residuals, limit = np.empty(80), 9.0
    cost, normal, gradient = normal_equations(
        x, grey, counts, edges, ties, RESPONSE.step, table, parameters, limit, free, residuals
    )
    jacobian = np.zeros((80, 7))
    value = np.array(
        [model(a, edges, ties, RESPONSE.step, table, parameters, row) for a, row in zip(x, jacobian, strict=True)]
    )
    jacobian[:, ~free] = 0
    scaled = np.abs(grey - value) * np.sqrt(counts)
    weight = counts * np.minimum(1.0, limit / scaled)
    huber = np.where(scaled > limit, limit * (2 * scaled - limit), scaled**2)
    expected = jacobian.T @ (weight[:, None] * jacobian)
    expected[~free, ~free] = 1.0
    assert residuals == pytest.approx(scaled)
    assert cost == pytest.approx(huber.sum())
    assert normal == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert gradient == pytest.approx(jacobian.T @ (weight * (grey - value)), rel=1e-6, abs=1e-9)


def test_levels_start_at_the_bands_means():
    x, levels = np.array([-3.0, -2, 0, 1, 3, 4]), np.zeros(4)
    start_levels(x, np.array([10.0, 20, 1, 3, 30, 50]), np.array([-1.0, 2.0]), levels)
    assert levels[:3] == pytest.approx([15, 2, 40])


def test_band_fit_equals_scipy_s(rng):
    x = np.sort(rng.uniform(-9, 9, 300))
    grey = bands_in_numpy(x, [120.0, 40, 100], [0.5, -0.3], [-2.2, 2.6]) + rng.normal(0, 1.5, 300)
    fit = fit_bands(x, grey, [-2.0, 2.0], RESPONSE)
    assert fit is not None
    reference = least_squares(
        lambda p: bands_in_numpy(x, p[:3], p[3:5], p[5:]) - grey, [110, 50, 110, 0, 0, -2, 2], x_scale="jac"
    )
    # Of Gaussian noise hardly anything exceeds the limit of Huber's cost.
    assert fit.edges == pytest.approx(reference.x[5:], abs=2e-3)
    assert fit.levels == pytest.approx(reference.x[:3], abs=0.05)
    covariance = np.linalg.inv(reference.jac.T @ reference.jac)[5:, 5:] * 2 * reference.cost / (300 - 7)
    assert np.diag(fit.covariance) == pytest.approx(np.diag(covariance), rel=0.05)


def test_pixels_gathered_across_a_line(rng):
    image = rng.uniform(0, 100, (60, 70)).astype(np.float32)
    node, normal, reach, half_along = np.array([33.3, 28.7]), np.array([0.8, 0.6]), 5.1, 4.0
    size = int(2 * reach / 0.25) + 1
    xs, greys, counts = np.empty(size), np.empty(size), np.empty(size)
    n = gather(image, node, normal, reach, half_along, xs, greys, counts)
    v, u = np.indices(image.shape)
    du, dv = u - node[0], v - node[1]
    x = du * normal[0] + dv * normal[1]
    window = (np.abs(x) <= reach) & (np.abs(dv * normal[0] - du * normal[1]) <= half_along)
    bins = ((x[window] + reach) / 0.25).astype(int)
    held = np.bincount(bins, minlength=size)
    some = held > 0
    assert n == some.sum()
    assert np.array_equal(counts[:n], held[some])
    assert xs[:n] == pytest.approx(np.bincount(bins, x[window], size)[some] / held[some])
    assert greys[:n] == pytest.approx(np.bincount(bins, image[window], size)[some] / held[some])


@pytest.mark.parametrize("inner", [-1.0, 1.0])
def test_borders_at_nodes_are_those_of_single_fits(inner, rng):
    band = Band((60, 50), 35, 9.0, 40.0, other_side=5.0)
    image = paint([band], (100, 120), rng)
    along = np.array([np.cos(np.deg2rad(35)), np.sin(np.deg2rad(35))])
    nodes = np.array(band.through) + np.array([[-20.0], [0.0], [22.5]]) * along
    normals = np.repeat([[-along[1], along[0]]], 3, axis=0)
    table, rows = np.stack([RESPONSE.values, RESPONSE.slopes]), np.empty((3, 7))
    borders_at_nodes(image, nodes, normals, 4.5, 14.0, 8.0, inner, RESPONSE.step, table, rows)
    size = int(2 * 14.0 / 0.25) + 1
    for node, normal, row in zip(nodes, normals, rows, strict=True):
        x, grey, counts = np.empty(size), np.empty(size), np.empty(size)
        n = gather(image, node, normal, 14.0, 8.0, x, grey, counts)
        x, grey, counts = x[:n], grey[:n], counts[:n]
        if inner < 0:
            fit = fit_bands(x, grey, [-4.5, 4.5], RESPONSE, counts=counts)
            assert row[:3] == pytest.approx([*fit.edges, fit.covariance.sum()], rel=1e-6)
            assert row[[3, 5, 4]] == pytest.approx(fit.levels)
            assert row[6] == row[5]
            continue
        for k, part in enumerate((x < -inner, x > inner)):
            start = [(-4.5, 4.5)[k]]
            fit = fit_bands(x[part], grey[part], start, RESPONSE, slopes=(k == 0, k == 1), counts=counts[part])
            assert row[k] == pytest.approx(fit.edges[0])
            assert row[3 + k] == pytest.approx(fit.levels[k])
            assert row[5 + k] == pytest.approx(fit.levels[1 - k])
    # Borders are where they were painted.
    assert np.abs(rows[:, :2] - (-4.5, 4.5)).max() < 0.3


def test_row_medians(rng):
    values, kept = rng.normal(size=(40, 31)), rng.random((40, 31)) < 0.4
    values[rng.random(values.shape) < 0.1] = np.nan
    kept &= np.isfinite(values)
    kept[7] = False
    medians = row_medians(values, kept)
    assert np.isnan(medians[7])
    for row, on, median in zip(values, kept, medians, strict=True):
        if on.any():
            assert median == np.median(row[on])
    assert row_medians(values, kept[0])[3:5] == pytest.approx(np.median(values[3:5][:, kept[0]], axis=1), nan_ok=True)


def test_longest_run(rng):
    points = np.cumsum(rng.normal([1.0, 0.0], [0.1, 0.4], (60, 2)), axis=0)
    pairs = np.vstack([[[7, 7]], rng.integers(0, 60, (9, 2))])  # two samples in one place make no line
    best = (0, 0)
    for first, second in pairs:
        along, away = points[second] - points[first], points - points[first]
        on_line = np.abs(away @ [-along[1], along[0]]) <= 0.8 * np.linalg.norm(along)
        ends = np.flatnonzero(np.diff(np.r_[False, on_line & along.any(), False]))
        best = max([best, *zip(ends[::2], ends[1::2], strict=True)], key=lambda run: run[1] - run[0])
    assert 3 < best[1] - best[0] < 60
    assert _longest_run(points, pairs, 0.8) == best

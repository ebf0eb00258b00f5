"""Compiled kernels against plain numpy: conic, ring model and its derivatives, profiles, votes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.special import erfc

from metrology.linear import solve
from metrology.rivets.arc_fit import fit_candidate, fit_conic
from metrology.rivets.arcs import RidgeField, curvature_noise, trace_arcs, vote_centres
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.evidence import distinction, ring_evidence, ring_steps, settle
from metrology.rivets.ring_equations import accumulate, assemble
from metrology.rivets.ring_model import DENSE, GEOMETRY, KNOTS, LANES, RESIDUAL, SIGMA, UNKNOWNS, fill_rows

ELLIPSE = Ellipse(61.3, 57.8, 22.0, 17.0, 0.7)
ROW = DENSE + 3  # of a pixel: derivatives, residual, shares of its two knots


def test_conic_equals_least_squares_in_numpy(rng: np.random.Generator) -> None:
    points = ELLIPSE.points(80)[:55] + rng.normal(0, 0.3, (55, 2))
    found = np.zeros(5)
    assert fit_conic(points[:, 0].copy(), points[:, 1].copy(), np.ones(55, bool), found)
    middle = points.mean(axis=0)
    scale = np.sqrt(((points - middle) ** 2).sum(axis=1).mean())
    p, q = ((points - middle) / scale).T
    a, b, d, e, f = np.linalg.lstsq(np.column_stack([p * p - q * q, p * q, p, q, np.ones(55)]), -q * q, rcond=None)[0]
    matrix = np.array([[a, b / 2], [b / 2, 1 - a]])
    centre = np.linalg.solve(2 * matrix, [-d, -e])
    axes = np.sqrt(-(f + 0.5 * (d * centre[0] + e * centre[1])) / np.linalg.eigvalsh(matrix))
    assert found[:2] == pytest.approx(centre * scale + middle, abs=1e-4)
    assert sorted(found[2:4]) == pytest.approx(sorted(axes * scale), abs=1e-4)


def test_conic_refuses_a_hyperbola() -> None:
    t = np.linspace(-1, 1, 30)
    branch = np.stack([2 * np.cosh(t), np.sinh(t)], axis=1)
    points = np.concatenate([branch, -branch])
    assert not fit_conic(points[:, 0].copy(), points[:, 1].copy(), np.ones(60, bool), np.zeros(5))


def model_in_numpy(x: float, y: float, geometry: np.ndarray, scale: float, sigma: float, params: np.ndarray) -> float:
    """The ring model of `metrology.rivets.ring`, written out."""
    dx, dy = x - geometry[0], y - geometry[1]
    inverse = np.array([[geometry[2], geometry[4]], [geometry[4], geometry[3]]])
    d = np.array([dx, dy])
    f = np.sqrt(d @ inverse @ d)
    rho = (f - 1) / np.linalg.norm(inverse @ d / f)
    xs, ys = dx / scale, dy / scale
    background = params[:6] @ [1, xs, ys, xs * xs, xs * ys, ys * ys]
    step = params[6:9] @ [1, xs, ys] * 0.5 * erfc(rho / sigma / np.sqrt(2))
    position = (np.arctan2(dy, dx) + np.pi) / (2 * np.pi) * KNOTS
    knots = params[DENSE:]
    k, part = int(position), position % 1
    amplitude = knots[k] * (1 - part) + knots[(k + 1) % KNOTS] * part
    return float(background + step + amplitude * np.exp(-0.5 * (rho / sigma) ** 2))


def ring_row(u: float, v: float, params: np.ndarray, scale: float) -> np.ndarray:
    """A pixel's row as the compiled model has it; its knot by its direction from the ellipse of the test."""
    position = (np.arctan2(v - ELLIPSE.v, u - ELLIPSE.u) + np.pi) / (2 * np.pi) * KNOTS
    rows = np.zeros(ROW * LANES)
    pixels = [np.full(LANES, value) for value in (u, v, 0.0, position % 1)]
    fill_rows(*pixels, int(position), scale, params, rows)
    return rows.reshape(ROW, LANES)[:, LANES // 2]


@pytest.fixture
def unknowns(rng: np.random.Generator) -> np.ndarray:
    inverse = np.linalg.inv(ELLIPSE.shape)
    params = rng.normal(0, 10, UNKNOWNS)
    params[SIGMA] = 1.1
    params[GEOMETRY:DENSE] = ELLIPSE.u, ELLIPSE.v, inverse[0, 0], inverse[1, 1], inverse[0, 1]
    return params


def test_ring_model_is_that_in_numpy(rng: np.random.Generator, unknowns: np.ndarray) -> None:
    for u, v in ELLIPSE.points(9) + rng.normal(0, 1.2, (9, 2)):
        expected = model_in_numpy(u, v, unknowns[GEOMETRY:DENSE], 19.0, unknowns[SIGMA], unknowns)
        assert -ring_row(u, v, unknowns, 19.0)[RESIDUAL] == pytest.approx(expected, rel=1e-6, abs=1e-5)


def test_derivatives_of_the_ring_model_are_its_differences(unknowns: np.ndarray) -> None:
    """On the ellipse itself, by σ, the centre and the shape; off it they leave out how the slope |∇f| changes.

    The background's frame, which moves with the centre, is left out too: here light, head and skin are even.
    """
    unknowns[1:6] = unknowns[7:9] = 0.0
    sizes = {SIGMA: 1e-4, GEOMETRY: 1e-3, GEOMETRY + 1: 1e-3} | dict.fromkeys(range(GEOMETRY + 2, DENSE), 1e-7)
    for u, v in ELLIPSE.points(11):
        found = ring_row(u, v, unknowns, 19.0)
        for unknown, size in sizes.items():
            moved = np.zeros(UNKNOWNS)
            moved[unknown] = size
            more, less = (-ring_row(u, v, unknowns + sign * moved, 19.0)[RESIDUAL] for sign in (1, -1))
            scale = np.abs(unknowns).max() / (1.0 if unknown < GEOMETRY + 2 else ELLIPSE.radius**-2)
            assert found[unknown] == pytest.approx((more - less) / (2 * size), rel=2e-3, abs=1e-3 * scale)


def test_normal_equations_are_those_of_all_rows(rng: np.random.Generator) -> None:
    """Sums over blocks of one direction each, against the whole matrix of derivatives in numpy."""
    knots = [0, 3, KNOTS - 1]
    rows, weight = rng.normal(size=(3, ROW * LANES)), rng.uniform(0, 1, (3, LANES))
    dense, by_knot, pairs = np.zeros((RESIDUAL + 1,) * 2), np.zeros((KNOTS, RESIDUAL + 1)), np.zeros((KNOTS, 2))
    matrix, residual = [], []
    for block, knot in enumerate(knots):
        accumulate(rows[block], weight[block], knot, np.empty(LANES), dense, by_knot, pairs)
        entries = rows[block].reshape(ROW, LANES)
        full = np.zeros((LANES, UNKNOWNS))
        full[:, :DENSE] = entries[:DENSE].T
        full[:, DENSE + knot], full[:, DENSE + (knot + 1) % KNOTS] = entries[RESIDUAL + 1 :]
        matrix.append(full)
        residual.append(entries[RESIDUAL])
    jacobian, w = np.concatenate(matrix), weight.ravel()
    normal, right = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    assemble(dense, by_knot, pairs, normal, right)
    assert normal == pytest.approx(np.tril(jacobian.T @ (w[:, None] * jacobian)))
    assert right == pytest.approx(jacobian.T @ (w * np.concatenate(residual)))


def test_cholesky_solves(rng: np.random.Generator) -> None:
    half = rng.normal(size=(12, 7))
    matrix, right = half.T @ half, rng.normal(size=7)
    expected = np.linalg.solve(matrix, right)
    assert solve(1e-6 * matrix, right, 7)  # whatever its units
    assert right == pytest.approx(1e6 * expected)
    assert not solve(np.array([[1.0, 2.0], [2.0, 1.0]]), right, 2)
    assert not solve(1e-6 * np.ones((2, 2)), right, 2)


def test_steps_equal_interpolation_along_the_normals(rng: np.random.Generator) -> None:
    image = rng.normal(100, 20, (120, 130)).astype(np.float32)
    offsets, found = np.array([-3.0, 2.5]), np.zeros(2)
    ring_steps(image, ELLIPSE.parameters, offsets, found)
    t = 2 * np.pi * np.arange(64) / 64
    c, s = np.cos(ELLIPSE.angle), np.sin(ELLIPSE.angle)
    normals = np.stack([np.cos(t) / ELLIPSE.a, np.sin(t) / ELLIPSE.b], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals @ np.array([[c, s], [-s, c]])
    points = ELLIPSE.points(64)
    own = map_coordinates(image, points.T[::-1], order=1)
    for offset, step in zip(offsets, found, strict=True):
        beside = map_coordinates(image, (points + offset * normals).T[::-1], order=1)
        assert step == pytest.approx(np.median(beside - own), abs=1e-3)


def test_distinction_grows_with_the_ring_and_not_with_the_exposure(rng: np.random.Generator) -> None:
    v, u = np.mgrid[:200, :200].astype(float)
    e = Ellipse(100.0, 100.0, 20.0, 18.0, 0.3)
    ring = np.exp(-0.5 * ((e.level(u, v) - 1) * 19) ** 2)
    noise = rng.normal(0, 2, u.shape)
    values = [
        distinction((100 - a * ring + noise).astype(np.float32), e.parameters, 1.0) for a in (0.0, 3.0, 6.0, 12.0)
    ]
    assert values[0] < 3.5
    assert np.all(np.diff(values) > 0)
    assert values[3] / values[2] == pytest.approx(2, rel=0.35)
    dim = distinction((0.1 * (100 - 6 * ring + noise)).astype(np.float32), e.parameters, 1.0)
    assert dim == pytest.approx(values[2], rel=1e-3)


def test_evidence_tells_a_ring_from_an_edge_and_from_noise(rng: np.random.Generator) -> None:
    v, u = np.mgrid[:160, :160].astype(float)
    e = Ellipse(80.0, 80.0, 22.0, 20.0, 0.3)
    rho = (e.level(u, v) - 1) * 21
    noise = rng.normal(0, 2, u.shape)
    result = np.zeros((1, 2))
    scores = {}
    for name, image in (
        ("ring", 100 - 8 * np.exp(-0.5 * rho**2)),
        ("disc", 100 - 8 * (rho < 0)),
        ("noise", np.full(u.shape, 100.0)),
    ):
        ring_evidence((image + noise).astype(np.float32), e.parameters[None], np.ones(1), 24, result)
        scores[name] = result[0].copy()
    assert scores["ring"][0] > 15
    assert scores["ring"][1] > 0.9
    assert scores["noise"][0] < 8.5
    assert scores["disc"][0] < 0.6 * scores["ring"][0]


def test_arcs_of_a_circle_vote_for_its_centre_and_a_line_for_nothing(rng: np.random.Generator) -> None:
    v, u = np.mgrid[:150, :200].astype(float)
    ring = np.exp(-0.5 * ((np.hypot(u - 70.4, v - 80.6) - 18) / 1.0) ** 2)
    line = np.exp(-0.5 * ((u - 150 - 0.1 * v) / 1.0) ** 2)
    image = (100 - 20 * ring - 30 * line + rng.normal(0, 0.5, u.shape)).astype(np.float32)
    arcs = trace_arcs(RidgeField.of(image, 1.0), 1, (4.0, 6.0), 7, 0.3)
    on_ring = np.abs(np.hypot(arcs.u - 70.4, arcs.v - 80.6) - 18) < 1
    assert on_ring.sum() > 80
    assert np.abs(np.abs(arcs.curvature[on_ring]) - 1 / 18).mean() < 0.02
    shape = np.array([[[1.0, 1.0, 0.0]]])
    found = vote_centres(arcs, (150, 200), np.arange(12.0, 25.0, 0.5), np.array([12.0, 25.0]), shape, 1e9, 0.3, 10)
    assert np.hypot(found[0, 0] - 70.4, found[0, 1] - 80.6) < 3
    # Only the line's ends, where its curvature is not known well, may vote.
    beside_middle = (np.abs(found[:, 0] - 158) < 35) & (np.abs(found[:, 1] - 70) < 35)
    assert not beside_middle.any()


@pytest.mark.parametrize("radius", [4.0, 6.0, 12.0])
def test_a_circle_of_any_size_has_its_own_curvature(rng: np.random.Generator, radius: float) -> None:
    """Of the smallest the window is half a turn, through which a parabola would curve nearly twice as much."""
    v, u = np.mgrid[:400, :400].astype(float)
    ring = np.exp(-0.5 * (np.hypot(u - 200.3, v - 198.6) - radius) ** 2)
    image = (100 - 20 * ring + rng.normal(0, 0.3, u.shape)).astype(np.float32)
    arcs = trace_arcs(RidgeField.of(image, 1.0), 1, (4.0, 6.0), 7, 0.3)
    found = np.hypot(arcs.u - 200.3, arcs.v - 198.6)
    known = (np.abs(found - radius) < 1) & (arcs.curvature_sd < 1)
    assert known.sum() > 25
    assert np.median(np.abs(arcs.curvature[known])) == pytest.approx(1 / np.median(found[known]), rel=0.03)


def test_a_suspect_keeps_the_shape_that_is_known(rng: np.random.Generator) -> None:
    """Points of an ellipse that no circle looks like here: a free conic follows them, one of known shape does not."""
    points = ELLIPSE.points(90)[:70] + rng.normal(0, 0.2, (70, 2))
    d = (points - [ELLIPSE.u, ELLIPSE.v]) @ np.linalg.inv(ELLIPSE.shape)
    across = d / np.linalg.norm(d, axis=1)[:, None]
    order = np.argsort(points[:, 1], kind="stable")
    u, v, nu, nv = (np.ascontiguousarray(c) for c in np.column_stack([points, across])[order].T)
    rows = np.searchsorted(v, np.arange(122)).astype(np.int64)
    start = ELLIPSE.u + 1.0, ELLIPSE.v - 1.0, ELLIPSE.radius
    known, free = np.empty(5), np.empty(5)
    for freedom, found in ((0.15, known), (np.log(2), free)):
        fit_candidate(*start, u, v, nu, nv, rows, np.array([1.0, 1.0, 0.0]), freedom, found)
    assert free[:4] == pytest.approx(ELLIPSE.parameters[:4], abs=0.5)
    assert known[2] / known[3] < np.exp(0.15)


def test_a_tilted_circle_is_voted_for_sharply_when_its_shape_is_known(rng: np.random.Generator) -> None:
    """Normals of an ellipse do not meet in its centre; with the known shape the votes do."""
    e = Ellipse(80.0, 75.0, 24.0, 15.0, 0.5)
    v, u = np.mgrid[:150, :160].astype(float)
    image = (100 - 20 * np.exp(-0.5 * ((e.level(u, v) - 1) * 18) ** 2) + rng.normal(0, 0.5, u.shape)).astype(np.float32)
    arcs = trace_arcs(RidgeField.of(image, 1.0), 1, (4.0, 6.0), 7, 0.3)
    s = e.shape / e.radius**2
    radii, edges = np.arange(14.0, 24.0, 0.5), np.array([14.0, 24.0])
    known = vote_centres(arcs, (150, 160), radii, edges, np.array([[[s[0, 0], s[1, 1], s[0, 1]]]]), 1e9, 0.05, 20)
    blind = vote_centres(arcs, (150, 160), radii, edges, np.array([[[1.0, 1.0, 0.0]]]), 1e9, 0.05, 20)
    assert np.hypot(known[0, 0] - e.u, known[0, 1] - e.v) < 2.5
    assert len(known) < len(blind)


def test_curvature_noise_is_that_of_white_noise(rng: np.random.Generator) -> None:
    """sqrt(3 / (16 π)) / σ³ per grey level; lines and rings do not count."""
    image = rng.normal(100, 2, (400, 500)).astype(np.float32)
    image[200:203] -= 60
    field = RidgeField.of(image, 1.5)
    expected = 2 * np.sqrt(3 / (16 * np.pi)) / 1.5**3
    assert np.median(field.noise) == pytest.approx(expected, rel=0.06)
    d = field.derivatives
    assert curvature_noise(3 * d.uu, 3 * d.vv) == pytest.approx(3 * field.noise, rel=1e-4)


def test_a_suspect_beside_its_ring_settles_on_it(rng: np.random.Generator) -> None:
    v, u = np.mgrid[:120, :120].astype(float)
    ring = -8 * np.exp(-0.5 * ((ELLIPSE.level(u, v) - 1) * ELLIPSE.radius) ** 2)
    image = (100 + ring + rng.normal(0, 2, ring.shape)).astype(np.float32)
    found = np.empty(5)
    settle(
        image, np.array([ELLIPSE.u + 2.0, ELLIPSE.v - 1.0, ELLIPSE.a + 2.0, ELLIPSE.b + 1.6, ELLIPSE.angle]), 1.0, found
    )
    assert found == pytest.approx(ELLIPSE.parameters, abs=0.7)

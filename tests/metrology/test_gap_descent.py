"""The compiled descent of a gap's fit against plain numpy."""

from __future__ import annotations

import numpy as np

from metrology.arrays import Array
from metrology.seams.gap import descent, solver
from metrology.seams.gap.floor import Floor
from metrology.seams.gap.prior import WIDTH_A, WIDTH_B, Prior
from metrology.seams.gap.solver import ACROSS, State, fit_shape_from
from tests.support.gap_render import Gap, profiles


def step_in_numpy(state: State, damping: float) -> tuple[Array, Array]:
    """Borders and shape after one step: borders eliminated from each station's block, the shape's solved as a whole."""
    limit = descent.DOUBTFUL * np.median(state.costs)
    trust, free = np.minimum(1.0, limit / state.costs), 2 + state.known.free
    own = state.normals[:, :2, :2] * (1.0 + damping * np.eye(2)) + 1e-9 * np.eye(2)
    cross, inner = state.normals[:, :2, free], state.normals[:, free[:, None], free]
    prior = state.known.precision[np.ix_(free - 2, free - 2)]
    normal = (trust[:, None, None] * inner).sum(axis=0) + prior
    normal += damping * np.diag(np.diag(normal))
    right = trust @ state.gradients[:, free]
    right += (state.known.precision @ (state.known.mean - state.shared))[free - 2]
    for weight, block, to_shape, gradient in zip(trust, own, cross, state.gradients, strict=True):
        solved = np.linalg.solve(block, np.column_stack([to_shape, gradient[:2]]))
        normal -= weight * to_shape.T @ solved[:, :-1]
        right -= weight * to_shape.T @ solved[:, -1]
    moves = np.linalg.solve(normal, right)
    shared = state.shared.copy()
    shared[free - 2] += moves
    left = state.gradients[:, :2] - np.einsum("nij,j->ni", cross, moves)
    by_border = np.linalg.solve(own, left[..., None])[..., 0]
    return state.borders + by_border.clip(-descent.STRIDE_MM, descent.STRIDE_MM), shared


def test_a_step_is_that_of_plain_numpy(rng):
    some = profiles(Gap(1.5, 0.3, 0.2), 5, rng)
    known = Prior(some, Floor(False)).of_square_walls()
    state = solver._state_at(some, np.outer(some.half_widths, ACROSS) + 0.05, known.mean.copy(), known)
    state.costs[2] *= 9.0  # a station that is not to be trusted
    borders, shared = np.empty_like(state.borders), np.empty_like(state.shared)
    limit = descent.DOUBTFUL * float(np.median(state.costs))
    descent._step(
        state.normals, state.gradients, state.costs, limit, known.limits, 0.3, state.borders, state.shared, borders,
        shared,
    )  # fmt: skip
    expected_borders, expected_shared = step_in_numpy(state, 0.3)
    np.testing.assert_allclose(borders, expected_borders, rtol=1e-7)
    np.testing.assert_allclose(shared, expected_shared, rtol=1e-6, atol=1e-9)
    assert not np.array_equal(shared, state.shared)


def test_the_way_goes_downhill_to_where_no_step_gains(rng):
    gap = Gap(1.5, 0.3, 0.2)
    some = profiles(gap, 5, rng)
    known = Prior(some, Floor(False))
    start = np.outer(some.half_widths, ACROSS)
    costs = []
    for iterations in (0, 1, 3, 40):
        state = fit_shape_from(some, start, known.mean, known, iterations)
        costs.append(state.cost(state.limit))
    assert all(np.diff(costs) < 0)
    again = fit_shape_from(some, state.borders, state.shared, known, 40)
    assert costs[-1] - again.cost(again.limit) < 0.01 * costs[-1]
    assert np.abs(np.median(state.widths) - gap.width_mm) < 0.1


def test_starts_are_left_as_they_are_and_bounds_hold(rng):
    some = profiles(Gap(1.2, 0.0, -0.5), 3, rng)
    known = Prior(some, Floor(False))
    borders, shared = np.zeros((3, 2)), known.mean.copy()
    state = fit_shape_from(some, borders, shared, known, 5)
    assert not borders.any()
    np.testing.assert_array_equal(shared, known.mean)
    _, _, _, lowest, highest = known.limits
    assert ((lowest <= state.shared) & (state.shared <= highest)).all()
    # No gap is narrower than nothing.
    assert (state.borders @ ACROSS >= state.shared[WIDTH_A] + state.shared[WIDTH_B] - 1e-9).all()

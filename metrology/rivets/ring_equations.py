"""Normal equations of the ring model: sums over blocks of pixels, what is expected of the shape, solution."""

from __future__ import annotations

import math

import numpy as np

from metrology.jit import kernel
from metrology.linear import factor, substitute
from metrology.rivets.ring_model import DENSE, GEOMETRY, KNOTS, LANES, RESIDUAL, SIGMA

_EMPTY = 1e-9  # of the diagonal of an unknown that nothing depends on


@kernel
def accumulate(rows, weight, knot, weighted, dense, knots, pairs):  # type: ignore[no-untyped-def]
    """Add a block's weighted products to the sums of which the normal equations are made (see `assemble`)."""
    for j in range(RESIDUAL + 1):
        for i in range(LANES):
            weighted[i] = weight[i] * rows[j * LANES + i]
        for k in range(j + 1):
            total = 0.0
            for i in range(LANES):
                total += weighted[i] * rows[k * LANES + i]
            dense[j, k] += total
    after = (knot + 1) % KNOTS
    for i in range(LANES):
        weighted[i] = weight[i] * rows[(RESIDUAL + 1) * LANES + i]
    for k in range(RESIDUAL + 1):
        total = 0.0
        for i in range(LANES):
            total += weighted[i] * rows[k * LANES + i]
        knots[knot, k] += total
    own = 0.0
    both = 0.0
    others = 0.0
    for i in range(LANES):
        own += weighted[i] * rows[(RESIDUAL + 1) * LANES + i]
        both += weighted[i] * rows[(RESIDUAL + 2) * LANES + i]
    for i in range(LANES):
        weighted[i] = weight[i] * rows[(RESIDUAL + 2) * LANES + i]
        others += weighted[i] * rows[(RESIDUAL + 2) * LANES + i]
    for k in range(RESIDUAL + 1):
        total = 0.0
        for i in range(LANES):
            total += weighted[i] * rows[k * LANES + i]
        knots[after, k] += total
    pairs[knot, 0] += own
    pairs[knot, 1] += both
    pairs[after, 0] += others


@kernel
def assemble(dense, knots, pairs, normal, right):  # type: ignore[no-untyped-def]
    """The normal equations (lower triangle) from the sums over the pixels."""
    normal[:] = 0.0
    for j in range(DENSE):
        right[j] = dense[RESIDUAL, j]
        for k in range(j + 1):
            normal[j, k] = dense[j, k]
    for i in range(KNOTS):
        right[DENSE + i] = knots[i, RESIDUAL]
        for k in range(DENSE):
            normal[DENSE + i, k] = knots[i, k]
        normal[DENSE + i, DENSE + i] = pairs[i, 0]
        after = (i + 1) % KNOTS
        normal[DENSE + max(i, after), DENSE + min(i, after)] = pairs[i, 1]


@kernel
def add_shape_prior(shape, precision, params, normal, right):  # type: ignore[no-untyped-def]
    """Pull the axis ratio and direction towards the expected shape (entries A, B, C of its inverse matrix).

    Two conditions that the size does not enter: A/A₀ = B/B₀ and C = C₀ (A + B) / (A₀ + B₀).
    """
    first = GEOMETRY + 2
    trace = shape[0] + shape[1]
    size = (params[first] + params[first + 1]) / trace
    condition = np.zeros(3)
    for which in range(2):
        if which == 0:
            condition[0] = 1.0 / (shape[0] * size)
            condition[1] = -1.0 / (shape[1] * size)
            condition[2] = 0.0
        else:
            condition[0] = -shape[2] / trace / (0.5 * trace * size)
            condition[1] = condition[0]
            condition[2] = 1.0 / (0.5 * trace * size)
        error = 0.0
        for j in range(3):
            error -= condition[j] * params[first + j]
        for j in range(3):
            right[first + j] += precision * condition[j] * error
            for k in range(j + 1):
                normal[first + j, first + k] += precision * condition[j] * condition[k]


@kernel
def factor_scaled(normal, size, damping, work, scale):  # type: ignore[no-untyped-def]
    """The normal matrix scaled to unit diagonal, damped, and factored into `work`; False where it is singular."""
    for j in range(size):
        scale[j] = 1.0 / math.sqrt(normal[j, j] + _EMPTY)
    for j in range(size):
        for k in range(j + 1):
            work[j, k] = normal[j, k] * scale[j] * scale[k]
        work[j, j] += damping
    return factor(work, size)


@kernel
def solve_scaled(work, scale, size, x):  # type: ignore[no-untyped-def]
    """Solve in place, given what `factor_scaled` has left."""
    for j in range(size):
        x[j] *= scale[j]
    substitute(work, size, x)
    for j in range(size):
        x[j] *= scale[j]


@kernel
def add_brightness(params, step):  # type: ignore[no-untyped-def]
    """Take a step in all unknowns but the ring's place, shape and width."""
    for i in range(len(params)):
        if i < SIGMA or i >= DENSE:
            params[i] += step[i]


@kernel
def column_of_inverse(system, column):  # type: ignore[no-untyped-def]
    """A column of the normal matrix's inverse, left in the step."""
    system.step[:] = 0.0
    system.step[column] = 1.0
    solve_scaled(system.work, system.scale, len(system.step), system.step)

"""Levenberg–Marquardt for the borders of many stations and the shape that they share, compiled as a whole.

Each station's borders are eliminated from the shape's normal equations (Schur complement).
"""

from __future__ import annotations

import math

import numpy as np

from metrology.jit import kernel
from metrology.linear import copy_values, solve
from metrology.seams.blur import blurred_steps
from metrology.seams.gap.equations import normal_equations
from metrology.seams.gap.model import NODES_PER_PX
from metrology.seams.gap.prior import LENSES, SPILL, WIDTH_A, WIDTH_B

# Stations whose squared residuals exceed the usual ones so many times tell less about the shape (Cauchy).
DOUBTFUL = 3.0
# An iteration that gains less than this, in squared standard deviations, is the last.
_SETTLED = 0.002
# No border moves farther in one iteration, mm.
STRIDE_MM = 0.3
# Damping at first, after a step that gains and one that does not; where it ends, and where there is no way on.
_DAMPING, _BOLDER, _SHYER, _LEAST, _MOST = 1e-2, 0.2, 8.0, 1e-6, 1e4
# Pixel and spill reach so far along the diagonal, px; the tail of the lens's Gaussian, standard deviations.
_BLUR_REACH_PX, _LENS_TAIL = 3.6, 4.5
# Borders are held by this much, for those that no pixel shows.
_HELD = 1e-9


@kernel
def descend(pictures, across, sealed, prior, iterations, borders, shared, normals, gradients, levels, costs):  # type: ignore[no-untyped-def]
    """Let borders and shape go downhill from where they are; the normal equations are left as they are in the end.

    Parameters
    ----------
    pictures : tuple
        x, grey levels, variances, sizes, places, tilts, eyes, lamps, pixels per mm, precisions and courses of the
        levels, see `Profiles`.
    across : (k, 2) ndarray
        Unit vector across the seam in each image.
    sealed : bool
    prior : tuple
        Mean, precision, what is free, and bounds of what is shared, see `Prior`.
    """
    lowest, highest = prior[3], prior[4]
    borders_there, shared_there = borders.copy(), shared.copy()
    normals_there, gradients_there = np.empty_like(normals), np.empty_like(gradients)
    levels_there, costs_there = np.empty_like(levels), np.empty_like(costs)
    keep_apart(borders, shared)
    tables = tables_of(across, shared)
    _look(pictures, sealed, tables, borders, shared, normals, gradients, levels, costs)
    limit, damping, blur = DOUBTFUL * np.median(costs), _DAMPING, shared.copy()
    for _ in range(iterations):
        _step(normals, gradients, costs, limit, prior, damping, borders, shared, borders_there, shared_there)
        for i in range(shared.size):
            shared_there[i] = min(max(shared_there[i], lowest[i]), highest[i])
        keep_apart(borders_there, shared_there)
        if not _alike(blur, shared_there, across.shape[0]):
            tables, blur = tables_of(across, shared_there), shared_there.copy()
        _look(pictures, sealed, tables, borders_there, shared_there,
              normals_there, gradients_there, levels_there, costs_there)  # fmt: skip
        gain = _cost(costs, limit, prior, shared) - _cost(costs_there, limit, prior, shared_there)
        if not gain > 0.0:
            damping *= _SHYER
            if damping > _MOST:
                break
            continue
        copy_values(borders, borders_there)
        copy_values(shared, shared_there)
        copy_values(levels, levels_there)
        copy_values(costs, costs_there)
        copy_values(normals, normals_there)
        copy_values(gradients, gradients_there)
        limit, damping = DOUBTFUL * np.median(costs), max(_BOLDER * damping, _LEAST)
        if gain < _SETTLED:
            break


@kernel
def keep_apart(borders, shared):  # type: ignore[no-untyped-def]
    """Move borders so far apart that no gap is narrower than nothing."""
    for s in range(borders.shape[0]):
        missing = max(shared[WIDTH_A] + shared[WIDTH_B] - (borders[s, 1] - borders[s, 0]), 0.0)
        borders[s, 0] -= 0.5 * missing
        borders[s, 1] += 0.5 * missing


@kernel
def tables_of(across, shared):  # type: ignore[no-untyped-def]
    """(k, 6, nodes) blurred steps of the cameras, and how they change."""
    lenses = shared[LENSES : LENSES + across.shape[0]]
    reach = _BLUR_REACH_PX + _LENS_TAIL * lenses.max()
    return blurred_steps(across, lenses, shared[SPILL], NODES_PER_PX, reach)


@kernel
def _alike(one, other, cameras):  # type: ignore[no-untyped-def]
    """Whether blur and spill are the same."""
    same = True
    for i in range(SPILL, LENSES + cameras):
        same &= one[i] == other[i]
    return same


@kernel
def _look(pictures, sealed, tables, borders, shared, normals, gradients, levels, costs):  # type: ignore[no-untyped-def]
    """The normal equations at these borders and this shape."""
    x, grey, variance, sizes, places, tilts, eyes, lamps, px_mm, precisions, courses = pictures
    normal_equations(
        x, grey, variance, sizes, places, borders, shared, tables, sealed, tilts, eyes, lamps, px_mm, precisions,
        courses, normals, gradients, levels, costs,
    )  # fmt: skip


@kernel
def _cost(costs, limit, prior, shared):  # type: ignore[no-untyped-def]
    """What pictures and prior have against it, see `State.cost`."""
    total = 0.0
    for cost in costs:
        total += cost if cost < limit else limit * (1.0 + math.log(max(cost / max(limit, 1e-12), 1.0)))
    mean, precision = prior[0], prior[1]
    for i in range(shared.size):
        for j in range(shared.size):
            total += (shared[i] - mean[i]) * precision[i, j] * (shared[j] - mean[j])
    return total


@kernel
def _step(normals, gradients, costs, limit, prior, damping, borders, shared, borders_there, shared_there):  # type: ignore[no-untyped-def]
    """One step of the borders and of what is free of the shape; none where the equations do not tell it.

    Stations whose costs are not usual weigh less.
    """
    mean, precision, free = prior[0], prior[1], prior[2]
    stations, size = costs.size, free.size
    system, right = np.empty((size, size)), np.zeros(size)
    cross, pulled, alone = np.empty((2, size)), np.empty((2, size)), np.empty((stations, 2))
    for i in range(size):
        for j in range(shared.size):
            right[i] += precision[free[i], j] * (mean[j] - shared[j])
        for j in range(i + 1):
            system[i, j] = precision[free[i], free[j]]
    for s in range(stations):
        trust = min(1.0, limit / max(costs[s], 1e-12))
        for i in range(size):
            for j in range(i + 1):
                system[i, j] += trust * normals[s, 2 + free[i], 2 + free[j]]
    for i in range(size):
        system[i, i] *= 1.0 + damping
    for s in range(stations):
        trust = min(1.0, limit / max(costs[s], 1e-12))
        aa, ab, bb = _inverse(normals[s], damping)
        alone[s, 0] = aa * gradients[s, 0] + ab * gradients[s, 1]
        alone[s, 1] = ab * gradients[s, 0] + bb * gradients[s, 1]
        for i in range(size):
            a, b = normals[s, 0, 2 + free[i]], normals[s, 1, 2 + free[i]]
            cross[0, i], cross[1, i] = trust * a, trust * b
            pulled[0, i], pulled[1, i] = aa * a + ab * b, ab * a + bb * b
            right[i] += trust * (gradients[s, 2 + free[i]] - alone[s, 0] * a - alone[s, 1] * b)
        for i in range(size):
            for j in range(i + 1):
                system[i, j] -= cross[0, i] * pulled[0, j] + cross[1, i] * pulled[1, j]
    copy_values(shared_there, shared)
    copy_values(borders_there, borders)
    if not solve(system, right, size):
        return
    for i in range(size):
        shared_there[free[i]] += right[i]
    for s in range(stations):
        aa, ab, bb = _inverse(normals[s], damping)
        a = b = 0.0
        for i in range(size):
            a += normals[s, 0, 2 + free[i]] * right[i]
            b += normals[s, 1, 2 + free[i]] * right[i]
        borders_there[s, 0] += min(max(alone[s, 0] - aa * a - ab * b, -STRIDE_MM), STRIDE_MM)
        borders_there[s, 1] += min(max(alone[s, 1] - ab * a - bb * b, -STRIDE_MM), STRIDE_MM)


@kernel
def _inverse(normal, damping):  # type: ignore[no-untyped-def]
    """Inverse of the borders' own block."""
    a, b, d = normal[0, 0] * (1.0 + damping) + _HELD, normal[0, 1], normal[1, 1] * (1.0 + damping) + _HELD
    determinant = a * d - b * b
    return d / determinant, -b / determinant, a / determinant

"""Grey-level model of a line's cross-section: bands of constant brightness with blurred borders.

With borders e_1 < … < e_m, levels L_0 … L_m, slopes s on the outer bands and a blurred unit step S (`EdgeResponse`)

``I(x) = L_0 + s_0 (x − e_1)(1 − S_1) + Σ_k (L_k − L_{k−1}) S_k + s_1 (x − e_m) S_m``, ``S_k = S(x − e_k)``.

Borders move in groups, ``e = e⁰ + T q``, so that a chamfer of known width shifts as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrology.jit import kernel
from metrology.seams.blur import EdgeResponse

Array = NDArray[np.float64]

_ITERATIONS = 40
# Residuals beyond this many standard deviations lose weight (Huber): specks, not borders that the model misses a
# little.
_OUTLIER_SIGMAS = 5.0


@dataclass(frozen=True)
class BandFit:
    """A fitted cross-section.

    Attributes
    ----------
    edges : (m,) ndarray
        Borders, in the unit of x.
    shifts : (q,) ndarray
        The groups' displacements from where they started.
    levels : (m + 1,) ndarray
        Grey levels.
    covariance : (q, q) ndarray
        Of the shifts.
    rms : float
        Of the residuals, grey levels.
    cost : float
        Sum of the residuals' squares.
    n : int
        Pixels used.
    """

    edges: Array
    shifts: Array
    levels: Array
    covariance: Array
    rms: float
    cost: float
    n: int


def fit_bands(
    x: ArrayLike,
    grey: ArrayLike,
    edges: ArrayLike,
    response: EdgeResponse,
    ties: ArrayLike | None = None,
    slopes: tuple[bool, bool] = (True, True),
    counts: ArrayLike | None = None,
) -> BandFit | None:
    """Least squares (Levenberg–Marquardt) fit of the band model.

    Parameters
    ----------
    x, grey : (n,) array
        Positions across the line, and grey levels.
    edges : (m,) array
        Where the borders are expected, rising.
    response : EdgeResponse
    ties : (m, q) array, optional
        T; by default every border moves on its own.
    slopes : (bool, bool)
        Whether the first and the last band may slope.
    counts : (n,) array, optional
        How many pixels each entry is the mean of; 1 by default.

    Returns
    -------
    BandFit or None
        None where the samples do not determine the model.
    """
    x = np.ascontiguousarray(x, float)
    grey = np.ascontiguousarray(grey, float)
    edges = np.ascontiguousarray(edges, float)
    tie = np.eye(len(edges)) if ties is None else np.ascontiguousarray(ties, float)
    first = len(edges) + 3
    free = np.ones(first + tie.shape[1], bool)
    free[first - 2 : first] = slopes
    if len(x) < 2 * len(free):
        return None
    table = np.stack([response.values, response.slopes])
    count = np.ones(len(x)) if counts is None else np.ascontiguousarray(counts, float)
    parameters, normal, cost, good = _fit(x, grey, count, edges, tie, response.step, table, free)
    moved = edges + tie @ parameters[first:]
    if not good or not np.all(np.diff(moved) > 0):
        return None
    variance = cost / (len(x) - int(free.sum()))
    try:
        covariance = np.linalg.inv(normal)[first:, first:] * variance
    except np.linalg.LinAlgError:
        return None
    return BandFit(
        edges=moved,
        shifts=parameters[first:],
        levels=parameters[: len(edges) + 1],
        covariance=covariance,
        rms=float(np.sqrt(variance)),
        cost=float(cost),
        n=len(x),
    )


@kernel
def _fit(x, grey, count, edges, tie, grid, table, free):  # type: ignore[no-untyped-def]
    """Levenberg–Marquardt on [levels, two slopes, shifts]: first on all pixels, then with outliers losing weight."""
    size = free.size
    trial = np.zeros(size)
    _start_levels(x, grey, edges, trial)
    parameters, step = trial.copy(), np.zeros(size)
    normal, gradient = np.eye(size), np.zeros(size)
    residuals = np.empty(x.size)
    cost, limit, damping = np.inf, np.inf, 1e-3
    trusting, good = True, False
    for _iteration in range(_ITERATIONS):
        trial_cost, trial_normal, trial_gradient = _normal_equations(
            x, grey, count, edges, tie, grid, table, trial, limit, free, residuals
        )
        settled = False
        if trial_cost <= cost:
            settled = cost - trial_cost < 1e-5 * cost
            parameters, cost, normal, gradient = trial, trial_cost, trial_normal, trial_gradient
            damping = max(damping * 0.1, 1e-9)
        else:
            damping *= 10.0
            # Where no downhill step is left, this is the minimum, to rounding.
            settled = damping > 1e6
        if settled and not trusting:
            good = True
            break
        if settled:
            # Once more, by another measure of cost.
            trusting = False
            limit = _OUTLIER_SIGMAS * 1.4826 * np.median(residuals) + 1e-9
            trial, cost, damping = parameters, np.inf, 1e-3
            continue
        damped = normal.copy()
        for i in range(size):
            damped[i, i] *= 1.0 + damping
        if not _cholesky_solve(damped, gradient, step):
            break
        trial = parameters + step
    return parameters, normal, cost, good


@kernel
def _start_levels(x, grey, edges, parameters):  # type: ignore[no-untyped-def]
    """Mean grey level of each band where the borders are expected to be."""
    m = edges.size
    overall = grey.mean()
    for band in range(m + 1):
        low = -np.inf if band == 0 else edges[band - 1]
        high = np.inf if band == m else edges[band]
        total, count = 0.0, 0
        for i in range(x.size):
            if low <= x[i] < high:
                total += grey[i]
                count += 1
        parameters[band] = total / count if count > 0 else overall


@kernel
def _model(position, edges, tie, grid, table, parameters, jacobian):  # type: ignore[no-untyped-def]
    """I(x) and its derivatives by all parameters."""
    m = edges.size
    groups = tie.shape[1]
    first = m + 3
    nodes = table.shape[1]
    jacobian[:] = 0.0
    value = parameters[0]
    jacobian[0] = 1.0
    for k in range(m):
        edge = edges[k]
        for q in range(groups):
            edge += tie[k, q] * parameters[first + q]
        away = position - edge
        # The tabulated step between its nodes: cubic, by values and slopes.
        place = away / grid + nodes // 2
        if place <= 0.0:
            response, density = 0.0, 0.0
        elif place >= nodes - 1:
            response, density = 1.0, 0.0
        else:
            i = int(place)
            f = place - i
            s0, s1 = table[0, i], table[0, i + 1]
            d0, d1 = table[1, i], table[1, i + 1]
            response = s0 + f * f * (3.0 - 2.0 * f) * (s1 - s0)
            response += grid * f * (1.0 - f) * ((1.0 - f) * d0 - f * d1)
            density = d0 + f * (d1 - d0)
        jump = parameters[k + 1] - parameters[k]
        value += jump * response
        jacobian[k + 1] += response
        jacobian[k] -= response
        by_edge = -jump * density
        if k == 0:
            value += parameters[m + 1] * away * (1.0 - response)
            jacobian[m + 1] = away * (1.0 - response)
            by_edge += parameters[m + 1] * (away * density - (1.0 - response))
        if k == m - 1:
            value += parameters[m + 2] * away * response
            jacobian[m + 2] = away * response
            by_edge -= parameters[m + 2] * (response + away * density)
        for q in range(groups):
            jacobian[first + q] += tie[k, q] * by_edge
    return value


@kernel
def _normal_equations(  # type: ignore[no-untyped-def]
    x, grey, count, edges, tie, grid, table, parameters, limit, free, residuals
):
    """Huber's cost of the residuals; JᵀWJ and JᵀWr, with what is not free as in the identity."""
    size = parameters.size
    normal, gradient, jacobian = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    cost = 0.0
    for i in range(x.size):
        residual = grey[i] - _model(x[i], edges, tie, grid, table, parameters, jacobian)
        # In units of a single pixel's noise.
        scaled = abs(residual) * np.sqrt(count[i])
        residuals[i] = scaled
        weight = count[i]
        if scaled > limit:
            weight *= limit / scaled
            cost += limit * (2.0 * scaled - limit)
        else:
            cost += scaled * scaled
        for a in range(size):
            if not free[a]:
                jacobian[a] = 0.0
            weighted = weight * jacobian[a]
            gradient[a] += weighted * residual
            for b in range(a + 1):
                normal[a, b] += weighted * jacobian[b]
    for a in range(size):
        if not free[a]:
            normal[a, a] = 1.0
        for b in range(a):
            normal[b, a] = normal[a, b]
    return cost, normal, gradient


@kernel
def _cholesky_solve(matrix, right, solution):  # type: ignore[no-untyped-def]
    """Solve by Cholesky, in place; False where the matrix is not positive definite."""
    size = right.size
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 1e-12 * (1e-12 + matrix[i, i]):
                    return False
                matrix[i, i] = np.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    for i in range(size):
        total = right[i]
        for k in range(i):
            total -= matrix[i, k] * solution[k]
        solution[i] = total / matrix[i, i]
    for i in range(size - 1, -1, -1):
        total = solution[i]
        for k in range(i + 1, size):
            total -= matrix[k, i] * solution[k]
        solution[i] = total / matrix[i, i]
    return True

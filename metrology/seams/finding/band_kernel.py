"""Compiled parts of the band model (`bands`): the model, its least-squares fit, and borders at many nodes of a line."""

from __future__ import annotations

import numpy as np

from metrology.jit import kernel
from metrology.linear import solve
from metrology.robust import MAD

_ITERATIONS = 40
# Residuals beyond this many standard deviations lose weight (Huber): specks, not borders that the model misses a
# little.
_OUTLIER_SIGMAS = 5.0
# Pixels are binned across the line; fewer of them tell nothing.
_BIN_PX = 0.25
_MIN_PIXELS = 60


@kernel
def borders_at_nodes(  # type: ignore[no-untyped-def]
    image, nodes, normals, half, reach, half_along, inner, grid, table, out
):
    """Both borders of a line at each node, into the rows of `out`: see `refine`.

    Parameters
    ----------
    image : (h, w) float32
    nodes, normals : (n, 2)
        u, v, and unit vectors across the line.
    half : float
        Half the band's expected width, px.
    reach, half_along : float
        Half the window across and along the line, px.
    inner : float
        Each border is fitted by itself to what lies beyond this distance from the node; if negative, both at once.
    grid, table : float, (2, m)
        Step, values and slopes of the blurred unit step.
    out : (n, 7)
        Borders (NaN where there are none), variance of their sum, grey levels outside and inside of each border.
    """
    size = int(2 * reach / _BIN_PX) + 1
    x, grey, count = np.empty(size), np.empty(size), np.empty(size)
    # One border: its two levels, the slope of its skin and its shift are free; two borders: everything is.
    tie_one, tie_two = np.eye(1), np.eye(2)
    free_one, free_two = np.ones((2, 5), np.bool_), np.ones(7, np.bool_)
    free_one[0, 3] = free_one[1, 2] = False
    edge, edges = np.empty(1), np.empty(2)
    found = np.empty(6)
    for node in range(nodes.shape[0]):
        for k in range(7):
            out[node, k] = np.nan
        n = gather(image, nodes[node], normals[node], reach, half_along, x, grey, count)
        if n == 0:
            continue
        if inner < 0.0:
            edges[0], edges[1] = -half, half
            if borders(x[:n], grey[:n], count[:n], edges, tie_two, grid, table, free_two, found):
                out[node, 0], out[node, 1], out[node, 2] = found[0], found[1], found[2]
                out[node, 3], out[node, 4], out[node, 5], out[node, 6] = found[3], found[5], found[4], found[4]
            continue
        good, variance = True, 0.0
        for side in range(2):
            first, last = 0, n
            while side == 0 and last > 0 and x[last - 1] >= -inner:
                last -= 1
            while side == 1 and first < n and x[first] <= inner:
                first += 1
            edge[0] = half if side == 1 else -half
            part = slice(first, last)
            good = good and borders(x[part], grey[part], count[part], edge, tie_one, grid, table, free_one[side], found)
            out[node, side], out[node, 3 + side], out[node, 5 + side] = found[0], found[2 + side], found[3 - side]
            variance += found[1]
        out[node, 2] = variance
        if not good:
            out[node, :2] = np.nan


@kernel
def gather(image, node, normal, reach, half_along, x, grey, count):  # type: ignore[no-untyped-def]
    """Bin the pixels of a window by their distance across the line.

    Mean distance, mean grey level and number of pixels go into the arrays, in order, empty bins left out; returns how
    many bins there are, none if there are too few pixels.
    """
    height, width = image.shape
    x[:], grey[:], count[:] = 0.0, 0.0, 0.0
    span = reach + half_along
    total = 0
    for row in range(max(0, int(node[1] - span)), min(height, int(node[1] + span) + 2)):
        for column in range(max(0, int(node[0] - span)), min(width, int(node[0] + span) + 2)):
            du, dv = column - node[0], row - node[1]
            across = du * normal[0] + dv * normal[1]
            if abs(across) > reach or abs(dv * normal[0] - du * normal[1]) > half_along:
                continue
            k = int((across + reach) / _BIN_PX)
            x[k] += across
            grey[k] += image[row, column]
            count[k] += 1.0
            total += 1
    if total < _MIN_PIXELS:
        return 0
    n = 0
    for k in range(x.size):
        if count[k] > 0.0:
            x[n], grey[n], count[n] = x[k] / count[k], grey[k] / count[k], count[k]
            n += 1
    return n


@kernel
def borders(x, grey, count, edges, tie, grid, table, free, found):  # type: ignore[no-untyped-def]
    """Fit m borders; into `found` they, the variance of their sum, and the m + 1 levels. False where the fit fails."""
    m = edges.size
    if x.size < 2 * free.size:
        return False
    parameters, normal, cost, good = fit(x, grey, count, edges, tie, grid, table, free)
    solved = np.zeros(free.size)
    unknowns = 0
    for i in range(free.size):
        solved[i] = 1.0 if i >= m + 3 else 0.0
        unknowns += 1 if free[i] else 0
    if not good or not solve(normal, solved, free.size):
        return False
    found[m] = 0.0
    for k in range(m):
        found[k] = edges[k] + parameters[m + 3 + k]
        found[m] += cost / (x.size - unknowns) * solved[m + 3 + k]
    for k in range(m + 1):
        found[m + 1 + k] = parameters[k]
    return True


@kernel
def fit(x, grey, count, edges, tie, grid, table, free):  # type: ignore[no-untyped-def]
    """Levenberg–Marquardt on [levels, two slopes, shifts]: first on all pixels, then with outliers losing weight."""
    size = free.size
    trial = np.zeros(size)
    start_levels(x, grey, edges, trial)
    parameters = trial.copy()
    normal, gradient = np.eye(size), np.zeros(size)
    residuals = np.empty(x.size)
    cost, limit, damping = np.inf, np.inf, 1e-3
    trusting, good = True, False
    for _iteration in range(_ITERATIONS):
        trial_cost, trial_normal, trial_gradient = normal_equations(
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
            limit = _OUTLIER_SIGMAS * MAD * np.median(residuals) + 1e-9
            trial, cost, damping = parameters, np.inf, 1e-3
            continue
        damped = normal.copy()
        for i in range(size):
            damped[i, i] *= 1.0 + damping
        step = gradient.copy()
        if not solve(damped, step, size):
            break
        trial = parameters + step
    return parameters, normal, cost, good


@kernel
def start_levels(x, grey, edges, parameters):  # type: ignore[no-untyped-def]
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
def model(position, edges, tie, grid, table, parameters, jacobian):  # type: ignore[no-untyped-def]
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
def normal_equations(  # type: ignore[no-untyped-def]
    x, grey, count, edges, tie, grid, table, parameters, limit, free, residuals
):
    """Huber's cost of the residuals; JᵀWJ and JᵀWr, with what is not free as in the identity."""
    size = parameters.size
    normal, gradient, jacobian = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    cost = 0.0
    for i in range(x.size):
        residual = grey[i] - model(x[i], edges, tie, grid, table, parameters, jacobian)
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

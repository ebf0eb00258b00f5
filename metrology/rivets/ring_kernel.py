"""Compiled robust Gauss-Newton fit of the ring model (see `ring`)."""

from __future__ import annotations

import math
from collections import namedtuple

import numpy as np

from metrology.jit import kernel
from metrology.rivets.ring_equations import (
    accumulate,
    add_brightness,
    add_shape_prior,
    assemble,
    column_of_inverse,
    factor_scaled,
    solve_scaled,
)
from metrology.rivets.ring_model import (
    BACKGROUND,
    DENSE,
    GEOMETRY,
    KNOTS,
    LANES,
    RESIDUAL,
    SIGMA,
    TUKEY,
    UNKNOWNS,
    arrange_in_blocks,
    collect_pixels,
    fill_rows,
    glint_limit,
    hide_clusters,
    tukey,
)
from metrology.robust import MAD

SECTORS = 24  # in which the ring must show itself
_LEAST_ON_IMAGE = 0.5  # of the ring
_LINEAR_STEPS = 2  # iterations for the brightness alone
_SETTLED = 5  # iteration by which the ring is in place at the latest
# Least median of the amplitude over its standard deviation from the scatter of the knots, by iteration.
_STEADY = np.array([0.0, 1.0, 1.0, 1.2, 1.5, 2.0])
_CONVERGED_PX = 0.02  # the step after it is three times smaller: a tenth of the clearest ring's deviation
_IN_PLACE_PX = 0.15  # a step from which on all pixels count
_SIGMA_PRIOR_PX = 0.3  # how much rings of one image differ in σ from where the fit starts
_LONGEST_SIGMA_PX, _LONGEST_SHIFT_PX, _LONGEST_GROWTH = 0.3, 1.0, 0.12  # of a step: the last in shares of 1/r²
_FARTHEST, _FARTHEST_PX = 0.5, 2.0  # from the start: a share of the radius, and pixels
# A strong ring that is not yet in place leaves residuals of its own, these shares of its amplitude.
_MISFIT, _MISFIT_IN_PLACE = 0.15, 0.05
_GLINT_REACH_PX, _OUTLIER_REACH_PX = 3, 2
_DAMPING, _UNDAMPED = 1e-6, 1e-9  # of the scaled normal matrix
# For normal noise of variance 1 and Tukey's weights w with that limit: 1 / (Σ w r² / Σ w), and the estimate's variance
# times Σ w against plain least squares' (E ψ² / (E ψ')² · E w).
_WEIGHTED_VARIANCE = 1.180
_WEIGHTED_COVARIANCE = 0.962
_LEAST_USED = 0.35  # of the pixels that are no outliers
_LEAST_SHARE = 0.3  # of the squared amplitude that is not noise, where there is a ring at all
_SHOWN_SIGMAS = 1.6  # of a sector's amplitude: one in twenty shows by noise

# Pixels x, y, value (n,), where each has its place among the blocks, and its direction in knots; of the blocks
# (blocks, LANES) the same with shares of the next knot, weights and rows, and (blocks,) the knot.
_Band = namedtuple("_Band", "x y value slot direction px py level part weight rows knot")
# See `accumulate` and `factor_scaled`.
_System = namedtuple("_System", "weighted dense knots pairs normal step work scale")


@kernel
def fit_ring_kernel(image, ellipse, sigma, shape, shape_sd, limits, iterations, out, covariance):  # type: ignore[no-untyped-def]
    """Robust Gauss-Newton fit of the ring model.

    Parameters
    ----------
    image : (h, w) float32
        NaN pixels are left out.
    ellipse : (5,) float64
        Start: u, v, semi-axes, angle.
    sigma : float
        Start of the ring's half-width, px.
    shape : (3,) float64
        Expected A, B, C up to their size.
    shape_sd : float
        Standard deviation of the expected relative shape; 0 where nothing is known of it.
    limits : (6,) float64
        Reach of the band, px; least and largest semi-axis, px; least axis ratio; least and largest σ, px.
    iterations : int
    out : (13,) float64, output
        u, v, A, B, C, σ, mean amplitude, mean step, noise, score, coverage, step score, share on the image.
    covariance : (5, 5) float64, output

    Returns
    -------
    bool
        False where no ring could be fitted.
    """
    half, few, share, band = _band(image, ellipse, limits[0])
    n = len(band.x)
    if n < 3 * UNKNOWNS or share < _LEAST_ON_IMAGE:
        return False
    params = _start(ellipse, sigma)
    scale = math.sqrt(ellipse[2] * ellipse[3])
    system = _room()
    residual, magnitude, hidden = np.empty(n), np.empty(n), np.zeros(n, np.bool_)
    _hide_glints(band, n, np.abs(band.value - np.median(band.value)), hidden)
    noise = 0.0
    settled = _SETTLED
    for iteration in range(iterations):
        # First the brightness alone on the starting ellipse, then everything; few pixels will do to get there.
        linear = iteration < _LINEAR_STEPS
        in_place = iteration >= settled
        pixels, blocks = (n, len(band.knot)) if in_place else (half, few)
        _fill(band, blocks, pixels, scale, params, residual, magnitude)
        if iteration == 1:
            # On a slope of light the band's median tells no glint: only what departs from the light does.
            _hide_glints(band, pixels, magnitude, hidden)
        _weigh(band, pixels, residual, noise if iteration > 0 else np.inf, hidden)
        _add_up(band, blocks, system)
        if linear:
            _hold_geometry(system)
        else:
            _add_priors(system, params, sigma, shape, shape_sd, noise)
        if not factor_scaled(system.normal, UNKNOWNS, _DAMPING, system.work, system.scale):
            return False
        solve_scaled(system.work, system.scale, UNKNOWNS, system.step)
        add_brightness(params, system.step)
        if iteration <= settled:
            # Hopeless starts show early: a ring is dark all round, or bright.
            if iteration > 0 and not _steady(params, _STEADY[iteration]):
                return False
            misfit = _MISFIT_IN_PLACE if in_place else _MISFIT
            noise = MAD * np.median(magnitude[:pixels]) + misfit * np.median(np.abs(params[DENSE:])) + 1e-6
            if iteration == settled:
                hidden[:] = False
                hide_clusters(band.x, band.y, magnitude, TUKEY * noise, _OUTLIER_REACH_PX, hidden)
        if linear:
            continue
        move = _advance(params, system.step, scale, limits)
        if not _plausible(params, ellipse, limits):
            return False
        if iteration < settled and move < _IN_PLACE_PX:
            settled = iteration + 1
        if iteration > settled and move < _CONVERGED_PX:
            break
    _fill(band, len(band.knot), n, scale, params, residual, magnitude)
    _weigh(band, n, residual, noise, hidden)
    out[12] = share
    return _judge(band, system, params, residual, shape, shape_sd, out, covariance)


@kernel
def _band(image, ellipse, reach):  # type: ignore[no-untyped-def]
    """The pixels about an ellipse: how many make half of them, in how many blocks, the share on the image, and all."""
    room = int(8.0 * (max(ellipse[2], ellipse[3]) + reach + 2.0) * (reach + 2.0)) + 64
    x, y, value = np.empty(room), np.empty(room), np.empty(room)
    half, n, share = collect_pixels(image, ellipse, reach, x, y, value)
    x, y, value = x[:n], y[:n], value[:n]
    slot, knot = np.empty(n, np.int64), np.empty(n // LANES + 2 * KNOTS, np.int64)
    few, blocks, direction = arrange_in_blocks(x, y, ellipse, half, slot, knot)
    # Lanes without a pixel have no weight, and lie where the model can be had.
    px = np.full((blocks, LANES), ellipse[0] + ellipse[2])
    py = np.full((blocks, LANES), ellipse[1])
    level, part, weight = np.zeros((blocks, LANES)), np.zeros((blocks, LANES)), np.zeros((blocks, LANES))
    for i in range(n):
        block = slot[i] // LANES
        lane = slot[i] % LANES
        px[block, lane] = x[i]
        py[block, lane] = y[i]
        level[block, lane] = value[i]
        part[block, lane] = direction[i] - knot[block]
    rows = np.empty((blocks, (RESIDUAL + 3) * LANES))
    return half, few, share, _Band(x, y, value, slot, direction, px, py, level, part, weight, rows, knot[:blocks])


@kernel
def _start(ellipse, sigma):  # type: ignore[no-untyped-def]
    """(UNKNOWNS,) a dark image with nothing but the ellipse."""
    c, s = math.cos(ellipse[4]), math.sin(ellipse[4])
    ia, ib = 1.0 / ellipse[2] ** 2, 1.0 / ellipse[3] ** 2
    params = np.zeros(UNKNOWNS)
    params[SIGMA] = sigma
    params[GEOMETRY] = ellipse[0]
    params[GEOMETRY + 1] = ellipse[1]
    params[GEOMETRY + 2] = c * c * ia + s * s * ib
    params[GEOMETRY + 3] = s * s * ia + c * c * ib
    params[GEOMETRY + 4] = c * s * (ia - ib)
    return params


@kernel
def _room():  # type: ignore[no-untyped-def]
    """Room for the normal equations."""
    dense, knots = np.empty((RESIDUAL + 1, RESIDUAL + 1)), np.empty((KNOTS, RESIDUAL + 1))
    normal, work = np.zeros((UNKNOWNS, UNKNOWNS)), np.empty((UNKNOWNS, UNKNOWNS))
    return _System(
        np.empty(LANES), dense, knots, np.empty((KNOTS, 2)), normal, np.zeros(UNKNOWNS), work, np.empty(UNKNOWNS)
    )


@kernel
def _hide_glints(band, pixels, magnitude, hidden):  # type: ignore[no-untyped-def]
    limit = glint_limit(band.direction[:pixels], magnitude[:pixels])
    hide_clusters(band.x[:pixels], band.y[:pixels], magnitude[:pixels], limit, _GLINT_REACH_PX, hidden[:pixels])


@kernel
def _fill(band, blocks, pixels, scale, params, residual, magnitude):  # type: ignore[no-untyped-def]
    """Rows of the first blocks, and residuals of the first pixels."""
    for b in range(blocks):
        fill_rows(band.px[b], band.py[b], band.level[b], band.part[b], band.knot[b], scale, params, band.rows[b])
    for i in range(pixels):
        residual[i] = band.rows[band.slot[i] // LANES, RESIDUAL * LANES + band.slot[i] % LANES]
        magnitude[i] = abs(residual[i])


@kernel
def _weigh(band, pixels, residual, noise, hidden):  # type: ignore[no-untyped-def]
    """Weights of the first pixels; an infinite noise weighs all alike."""
    for i in range(pixels):
        w = 0.0 if hidden[i] else 1.0 if noise == np.inf else tukey(residual[i], noise)
        band.weight[band.slot[i] // LANES, band.slot[i] % LANES] = w


@kernel
def _add_up(band, blocks, system):  # type: ignore[no-untyped-def]
    """Normal equations of the first blocks."""
    system.dense[:] = 0.0
    system.knots[:] = 0.0
    system.pairs[:] = 0.0
    for b in range(blocks):
        accumulate(
            band.rows[b], band.weight[b], band.knot[b], system.weighted, system.dense, system.knots, system.pairs
        )
    assemble(system.dense, system.knots, system.pairs, system.normal, system.step)


@kernel
def _hold_geometry(system):  # type: ignore[no-untyped-def]
    """Leave σ and the ellipse as they are."""
    for j in range(SIGMA, DENSE):
        system.step[j] = 0.0
        for k in range(UNKNOWNS):
            system.normal[max(j, k), min(j, k)] = 1.0 if j == k else 0.0


@kernel
def _add_priors(system, params, sigma, shape, shape_sd, noise):  # type: ignore[no-untyped-def]
    """The width of a weak ring is poorly known: it stays near that of others, and the shape near the expected one."""
    precision = (noise / _SIGMA_PRIOR_PX) ** 2
    system.normal[SIGMA, SIGMA] += precision
    system.step[SIGMA] += precision * (sigma - params[SIGMA])
    if shape_sd > 0.0:
        add_shape_prior(shape, (noise / shape_sd) ** 2, params, system.normal, system.step)


@kernel
def _steady(params, least):  # type: ignore[no-untyped-def]
    """Whether the amplitude's median over the directions exceeds its standard deviation so many times."""
    middle = np.median(params[DENSE:])
    scatter = MAD * np.median(np.abs(params[DENSE:] - middle)) / math.sqrt(KNOTS)
    return abs(middle) >= least * scatter


@kernel
def _advance(params, step, scale, limits):  # type: ignore[no-untyped-def]
    """Take a step of limited length in σ and the ellipse; returns how far the ellipse moves, px."""
    change = min(max(step[SIGMA], -_LONGEST_SIGMA_PX), _LONGEST_SIGMA_PX)
    params[SIGMA] = min(max(params[SIGMA] + change, limits[4]), limits[5])
    size = 0.5 * (params[GEOMETRY + 2] + params[GEOMETRY + 3])
    move = 0.0
    for j in range(5):
        limit = _LONGEST_SHIFT_PX if j < 2 else _LONGEST_GROWTH * size
        d = min(max(step[GEOMETRY + j], -limit), limit)
        params[GEOMETRY + j] += d
        move = max(move, abs(d) if j < 2 else 0.5 * abs(d) / size * scale)
    return move


@kernel
def _plausible(params, ellipse, limits):  # type: ignore[no-untyped-def]
    """Whether the ellipse is one, within its limits, and near where the fit started."""
    least, largest, flattest = limits[1], limits[2], limits[3]
    a, b, c = params[GEOMETRY + 2], params[GEOMETRY + 3], params[GEOMETRY + 4]
    gap = math.sqrt(0.25 * (a - b) ** 2 + c * c)
    low = 0.5 * (a + b) - gap
    high = 0.5 * (a + b) + gap
    if low <= 0.0 or low < high * flattest**2 or low * largest**2 < 1.0 or high * least**2 > 1.0:
        return False
    away = abs(params[GEOMETRY] - ellipse[0]) + abs(params[GEOMETRY + 1] - ellipse[1])
    return away <= _FARTHEST * math.sqrt(ellipse[2] * ellipse[3]) + _FARTHEST_PX


@kernel
def _judge(band, system, params, residual, shape, shape_sd, out, covariance):  # type: ignore[no-untyped-def]
    """What the ring is worth: `out` but for its last entry, and the covariance; False where too little counts."""
    scores, norms, gradients = np.zeros(SECTORS), np.zeros(SECTORS), np.zeros((SECTORS, 5))
    total, used = _by_sector(band, params, residual, scores, norms, gradients)
    norm = norms.sum()
    if used < _LEAST_USED * len(residual) or norm <= 0.0:
        return False
    _add_up(band, len(band.knot), system)
    variance = total / max(used - UNKNOWNS, 1.0) * _WEIGHTED_VARIANCE
    inflation, together = _dependence(gradients, system.normal, variance)
    variance *= inflation
    noise = math.sqrt(variance)
    if shape_sd > 0.0:
        add_shape_prior(shape, variance / shape_sd**2, params, system.normal, system.step)
    if not factor_scaled(system.normal, UNKNOWNS, _UNDAMPED, system.work, system.scale):
        return False
    scale = variance * _WEIGHTED_COVARIANCE * together / _true_share(system, params, variance)
    for j in range(5):
        out[j] = params[GEOMETRY + j]
        column_of_inverse(system, GEOMETRY + j)
        for i in range(5):
            covariance[j, i] = system.step[GEOMETRY + i] * scale
    column_of_inverse(system, BACKGROUND)
    step_sd = math.sqrt(system.step[BACKGROUND]) * noise
    mean = scores.sum() / norm
    out[5] = params[SIGMA]
    out[6] = mean
    out[7] = params[BACKGROUND]
    out[8] = noise / math.sqrt(inflation)
    out[9] = abs(mean) * math.sqrt(norm) / noise
    out[10] = _shown(scores, norms, mean, noise)
    out[11] = abs(params[BACKGROUND]) / (step_sd + 1e-12)
    return True


@kernel
def _by_sector(band, params, residual, scores, norms, gradients):  # type: ignore[no-untyped-def]
    """Sums over the pixels of each sector: ring times image, ring squared, derivatives by the ellipse times residual.

    Returns the weighted sum of the squared residuals and that of the weights.
    """
    total = 0.0
    used = 0.0
    for i in range(len(residual)):
        block = band.slot[i] // LANES
        lane = band.slot[i] % LANES
        w = band.weight[block, lane]
        k = band.knot[block]
        own = band.rows[block, (RESIDUAL + 1) * LANES + lane]
        others = band.rows[block, (RESIDUAL + 2) * LANES + lane]
        ring = own + others
        shown = params[DENSE + k] * own + params[DENSE + (k + 1) % KNOTS] * others
        sector = min(int(band.direction[i] / KNOTS * SECTORS), SECTORS - 1)
        scores[sector] += w * (residual[i] + shown) * ring
        norms[sector] += w * ring * ring
        total += w * residual[i] ** 2
        used += w
        for j in range(5):
            gradients[sector, j] += w * residual[i] * band.rows[block, (GEOMETRY + j) * LANES + lane]
    return total, used


@kernel
def _dependence(gradients, normal, variance):  # type: ignore[no-untyped-def]
    """By how much residuals that are not independent, as brushed metal leaves, raise a sector's variance and the sum's.

    The scatter of the sectors' sums against what independent noise gives; and, as a streak is longer than a sector, by
    how much neighbours' sums go together.
    """
    ratio = 0.0
    products = 0.0
    for j in range(5):
        expected = normal[GEOMETRY + j, GEOMETRY + j] * variance + 1e-30
        ratio += (gradients[:, j] ** 2).sum() / expected
        for sector in range(SECTORS):
            products += gradients[sector, j] * gradients[sector - 1, j] / expected
    # The fit has taken five degrees of freedom from the sectors' sums, and from neighbours' products as much as makes
    # all products with one sector's sum nothing.
    inflation = max(1.0, ratio / 5.0 * SECTORS / (SECTORS - 5.0))
    together = max(1.0, 1.0 + 2.0 * products / (ratio + 1e-30) + 10.0 / (SECTORS - 5.0))
    return inflation, together


@kernel
def _true_share(system, params, variance):  # type: ignore[no-untyped-def]
    """Share of the squared amplitude that is not noise.

    Noise makes the squared amplitude, and with it the information on the ring's place, look larger than it is.
    """
    squares = 0.0
    excess = 0.0
    for k in range(DENSE, UNKNOWNS):
        column_of_inverse(system, k)
        squares += params[k] ** 2
        excess += system.step[k] * variance
    return max(1.0 - excess / (squares + 1e-30), _LEAST_SHARE)


@kernel
def _shown(scores, norms, mean, noise):  # type: ignore[no-untyped-def]
    """Share of the sectors in which the ring shows with its sign."""
    sign = 1.0 if mean > 0.0 else -1.0
    hits = 0
    for k in range(SECTORS):
        if norms[k] > 0.0 and sign * scores[k] / math.sqrt(norms[k]) > _SHOWN_SIGMAS * noise:
            hits += 1
    return hits / SECTORS

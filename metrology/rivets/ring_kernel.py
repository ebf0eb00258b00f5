"""Compiled robust Gauss-Newton fit of the ring model (see `ring`)."""

from __future__ import annotations

import math

import numpy as np

from metrology.jit import kernel

BACKGROUND = 6  # 1, x, y, x², xy, y²
STEP = 3  # 1, x, y inside
SIGMA = BACKGROUND + STEP  # index of the ring's half-width
GEOMETRY = SIGMA + 1  # u, v and the three entries of the inverse shape matrix
DENSE = GEOMETRY + 5  # unknowns that every pixel depends on
KNOTS = 16  # of the amplitude over the angle; a pixel depends on two
UNKNOWNS = DENSE + KNOTS
SECTORS = 24  # in which the ring must show itself
_LINEAR_STEPS = 2  # iterations for the brightness alone
_SETTLED = 5  # iteration by which the ring is in place
# Least median of the amplitude over its standard deviation from the scatter of the knots, by iteration.
_STEADY = np.array([0.0, 1.0, 1.0, 1.2, 1.5, 2.0])
_CONVERGED_PX = 0.01
_ENOUGH_PIXELS = 450  # to get near the solution
_SIGMA_PRIOR_PX = 0.3  # how much rings of one image differ in σ from where the fit starts
TUKEY = 5.0  # residuals beyond this many sigmas count nothing
# For normal noise of variance 1 and Tukey's weights w with that limit: 1 / (Σ w r² / Σ w), and the estimate's variance
# times Σ w against plain least squares' (E ψ² / (E ψ')² · E w).
_WEIGHTED_VARIANCE = 1.180
_WEIGHTED_COVARIANCE = 0.962


@kernel
def _collect(image, e, reach, x, y, value):  # type: ignore[no-untyped-def]
    """Pixels within `reach` of the ellipse, in an order of which every beginning is spread evenly.

    One colour of a chessboard first, of each colour one row in two. Returns how many are enough to begin with, how many
    there are in all, and the share of the ellipse on the image.
    """
    height, width = image.shape
    size = max(e[2], e[3]) + reach + 1.0
    u0 = max(0, int(e[0] - size))
    u1 = min(width, int(e[0] + size) + 2)
    v0 = max(0, int(e[1] - size))
    v1 = min(height, int(e[1] + size) + 2)
    c = math.cos(e[4])
    s = math.sin(e[4])
    n = 0
    enough = 0
    for turn in range(4):
        colour = turn // 2
        for v in range(v0 + (v0 + turn) % 2, v1, 2):
            for u in range(u0 + (u0 + v + colour) % 2, u1, 2):
                p = (c * (u - e[0]) + s * (v - e[1])) / e[2]
                q = (c * (v - e[1]) - s * (u - e[0])) / e[3]
                f = math.sqrt(p * p + q * q)
                slope = math.sqrt((p / e[2]) ** 2 + (q / e[3]) ** 2) / max(f, 1e-9)
                if abs(f - 1.0) < reach * slope and not np.isnan(image[v, u]) and n < len(x):
                    x[n] = u
                    y[n] = v
                    value[n] = image[v, u]
                    n += 1
        if enough == 0 and (n >= _ENOUGH_PIXELS or turn == 1):
            enough = n
    seen = 0
    for k in range(72):
        t = k * (2.0 * math.pi / 72.0)
        u = e[0] + c * e[2] * math.cos(t) - s * e[3] * math.sin(t)
        v = e[1] + s * e[2] * math.cos(t) + c * e[3] * math.sin(t)
        if 0.0 <= u <= width - 1 and 0.0 <= v <= height - 1:
            seen += 1
    return enough, n, seen / 72.0


@kernel
def _factor(matrix, size):  # type: ignore[no-untyped-def]
    """Cholesky factor of the leading block, in place in the lower triangle; False where it is not positive definite."""
    for j in range(size):
        for k in range(j + 1):
            total = matrix[j, k]
            for m in range(k):
                total -= matrix[j, m] * matrix[k, m]
            if j == k:
                if total <= 1e-12:
                    return False
                matrix[j, j] = math.sqrt(total)
            else:
                matrix[j, k] = total / matrix[k, k]
    return True


@kernel
def _substitute(matrix, size, x):  # type: ignore[no-untyped-def]
    """Solve L Lᵀ x = b in place, given the factor."""
    for j in range(size):
        for k in range(j):
            x[j] -= matrix[j, k] * x[k]
        x[j] /= matrix[j, j]
    for j in range(size - 1, -1, -1):
        for k in range(j + 1, size):
            x[j] -= matrix[k, j] * x[k]
        x[j] /= matrix[j, j]


@kernel
def _scaled(normal, size, damping, work, scale):  # type: ignore[no-untyped-def]
    """The normal matrix scaled to unit diagonal, damped, and factored into `work`; False where it is singular."""
    for j in range(size):
        scale[j] = 1.0 / math.sqrt(normal[j, j] + 1e-9)
    for j in range(size):
        for k in range(j + 1):
            work[j, k] = normal[j, k] * scale[j] * scale[k]
        work[j, j] += damping
    return _factor(work, size)


@kernel
def _row(x, y, knot, part, geometry, scale, sigma, params, row):  # type: ignore[no-untyped-def]
    """Model value at a pixel; its derivatives by the dense unknowns in `row`.

    The amplitude comes from `knot` and, by the share `part`, from the one after it. Also returns the ring's profile and
    the amplitude.
    """
    dx = x - geometry[0]
    dy = y - geometry[1]
    A = geometry[2]
    B = geometry[3]
    C = geometry[4]
    f = math.sqrt(A * dx * dx + B * dy * dy + 2.0 * C * dx * dy) + 1e-12
    gx = (A * dx + C * dy) / f
    gy = (B * dy + C * dx) / f
    slope = math.sqrt(gx * gx + gy * gy) + 1e-12
    z = (f - 1.0) / slope / sigma
    ring = math.exp(-0.5 * z * z)
    # Φ(−z) from the same exponential (Abramowitz and Stegun 7.1.26, error below 1e-7).
    t = 1.0 / (1.0 + 0.23164191 * abs(z))
    tail = (
        0.5 * ring * t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    )
    inside = tail if z > 0.0 else 1.0 - tail
    xs = dx / scale
    ys = dy / scale
    row[0] = 1.0
    row[1] = xs
    row[2] = ys
    row[3] = xs * xs
    row[4] = xs * ys
    row[5] = ys * ys
    row[6] = inside
    row[7] = inside * xs
    row[8] = inside * ys
    model = 0.0
    for j in range(BACKGROUND + STEP):
        model += params[j] * row[j]
    amplitude = params[DENSE + knot] * (1.0 - part) + params[DENSE + (knot + 1) % KNOTS] * part
    step = params[6] + params[7] * xs + params[8] * ys
    model += amplitude * ring
    by_rho = -ring * (amplitude * z + step * 0.3989422804014327) / sigma
    by_f = by_rho / slope
    row[SIGMA] = -by_rho * z
    row[GEOMETRY] = -by_f * gx
    row[GEOMETRY + 1] = -by_f * gy
    row[GEOMETRY + 2] = by_f * dx * dx / (2.0 * f)
    row[GEOMETRY + 3] = by_f * dy * dy / (2.0 * f)
    row[GEOMETRY + 4] = by_f * dx * dy / f
    return model, ring, amplitude


@kernel
def _tukey(residual, noise):  # type: ignore[no-untyped-def]
    t = residual / (TUKEY * noise)
    return (1.0 - t * t) ** 2 if abs(t) < 1.0 else 0.0


@kernel
def _hide_clusters(x, y, magnitude, limit, reach, hidden):  # type: ignore[no-untyped-def]
    """Hide pixels with three or more beyond `limit` within `reach`: a glint's skirt does not stand out itself."""
    n = len(x)
    low_x = x.min()
    low_y = y.min()
    width = int(x.max() - low_x) + 1
    height = int(y.max() - low_y) + 1
    count = np.zeros((height, width), np.int32)
    for i in range(n):
        if magnitude[i] > limit:
            px = int(x[i] - low_x)
            py = int(y[i] - low_y)
            for v in range(max(py - reach, 0), min(py + reach + 1, height)):
                for u in range(max(px - reach, 0), min(px + reach + 1, width)):
                    count[v, u] += 1
    for i in range(n):
        hidden[i] = count[int(y[i] - low_y), int(x[i] - low_x)] >= 3


@kernel
def _glint_limit(knot, magnitude):  # type: ignore[no-untyped-def]
    """Departure from the band's median beyond which a pixel is a glint.

    Twice what the median direction reaches: a ring departs all round, a glint in a few directions.
    """
    largest = np.zeros(KNOTS)
    for i in range(len(knot)):
        largest[knot[i]] = max(largest[knot[i]], magnitude[i])
    return 2.0 * np.median(largest)


@kernel
def _accumulate(weight, residual, row, ring, knot, part, normal, right):  # type: ignore[no-untyped-def]
    """Add one pixel to the normal equations (lower triangle)."""
    for j in range(DENSE):
        wj = row[j] * weight
        right[j] += wj * residual
        for k in range(j + 1):
            normal[j, k] += wj * row[k]
    first = DENSE + knot
    second = DENSE + (knot + 1) % KNOTS
    a = ring * (1.0 - part)
    b = ring * part
    wa = weight * a
    wb = weight * b
    right[first] += wa * residual
    right[second] += wb * residual
    for k in range(DENSE):
        normal[first, k] += wa * row[k]
        normal[second, k] += wb * row[k]
    normal[first, first] += wa * a
    normal[second, second] += wb * b
    normal[max(first, second), min(first, second)] += wa * b


@kernel
def _add_prior(geometry, shape, precision, normal, right):  # type: ignore[no-untyped-def]
    """Pull the axis ratio and direction towards the expected shape (entries A, B, C of its inverse matrix).

    Two conditions that the size does not enter: A/A₀ = B/B₀ and C = C₀ (A + B) / (A₀ + B₀).
    """
    trace = shape[0] + shape[1]
    size = (geometry[2] + geometry[3]) / trace
    condition = np.zeros(3)
    for which in range(2):
        if which == 0:
            condition[0] = 1.0 / (shape[0] * size)
            condition[1] = -1.0 / (shape[1] * size)
            condition[2] = 0.0
        else:
            condition[0] = -2.0 * shape[2] / trace / (0.5 * trace * size)
            condition[1] = condition[0]
            condition[2] = 2.0 / (0.5 * trace * size)
            condition[0] *= 0.5
            condition[1] *= 0.5
            condition[2] *= 0.5
        error = 0.0
        for j in range(3):
            error -= condition[j] * geometry[2 + j]
        for j in range(3):
            right[GEOMETRY + 2 + j] += precision * condition[j] * error
            for k in range(j + 1):
                normal[GEOMETRY + 2 + j, GEOMETRY + 2 + k] += precision * condition[j] * condition[k]


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
    reach, least, largest, flattest, sigma_low, sigma_high = limits
    room = int(8.0 * (max(ellipse[2], ellipse[3]) + reach + 2.0) * (reach + 2.0)) + 64
    x = np.empty(room)
    y = np.empty(room)
    value = np.empty(room)
    few, n, share = _collect(image, ellipse, reach, x, y, value)
    if few < 3 * UNKNOWNS or share < 0.5:
        return False
    x = x[:n]
    y = y[:n]
    value = value[:n]
    c = math.cos(ellipse[4])
    s = math.sin(ellipse[4])
    ia = 1.0 / ellipse[2] ** 2
    ib = 1.0 / ellipse[3] ** 2
    geometry = np.empty(5)
    geometry[0] = ellipse[0]
    geometry[1] = ellipse[1]
    geometry[2] = c * c * ia + s * s * ib
    geometry[3] = s * s * ia + c * c * ib
    geometry[4] = c * s * (ia - ib)
    scale = math.sqrt(ellipse[2] * ellipse[3])
    params = np.zeros(UNKNOWNS)
    residual = np.empty(n)
    magnitude = np.empty(n)
    hidden = np.zeros(n, np.bool_)
    row = np.empty(DENSE)
    step = np.zeros(UNKNOWNS)
    diagonal = np.empty(UNKNOWNS)
    work = np.empty((UNKNOWNS, UNKNOWNS))
    normal = np.zeros((UNKNOWNS, UNKNOWNS))
    start_sigma = sigma
    # Which knots a pixel depends on, by its direction from the starting centre.
    knot = np.empty(n, np.int64)
    part = np.empty(n)
    for i in range(n):
        position = (math.atan2(y[i] - ellipse[1], x[i] - ellipse[0]) + math.pi) / (2.0 * math.pi) * KNOTS
        knot[i] = min(int(position), KNOTS - 1)
        part[i] = position - knot[i]
    middle = np.median(value)
    for i in range(n):
        magnitude[i] = abs(value[i] - middle)
    _hide_clusters(x, y, magnitude, _glint_limit(knot, magnitude), 3, hidden)
    noise = 0.0
    for iteration in range(iterations):
        # First the brightness alone on the starting ellipse, then everything; few pixels will do to get there.
        linear = iteration < _LINEAR_STEPS
        pixels = few if iteration < _SETTLED else n
        normal[:] = 0.0
        step[:] = 0.0
        for i in range(pixels):
            model, ring, amplitude = _row(x[i], y[i], knot[i], part[i], geometry, scale, sigma, params, row)
            residual[i] = value[i] - model
            magnitude[i] = abs(residual[i])
            weight = 1.0 if iteration == 0 else _tukey(residual[i], noise)
            if weight > 0.0 and not hidden[i]:
                _accumulate(weight, residual[i], row, ring, knot[i], part[i], normal, step)
        if linear:
            for j in range(SIGMA, DENSE):
                step[j] = 0.0
                for k in range(UNKNOWNS):
                    normal[max(j, k), min(j, k)] = 1.0 if j == k else 0.0
        else:
            # The width of a weak ring is poorly known: it stays near that of others.
            precision = (noise / _SIGMA_PRIOR_PX) ** 2
            normal[SIGMA, SIGMA] += precision
            step[SIGMA] += precision * (start_sigma - sigma)
            if shape_sd > 0.0:
                _add_prior(geometry, shape, (noise / shape_sd) ** 2, normal, step)
        if not _scaled(normal, UNKNOWNS, 1e-6, work, diagonal):
            return False
        for j in range(UNKNOWNS):
            step[j] *= diagonal[j]
        _substitute(work, UNKNOWNS, step)
        for j in range(UNKNOWNS):
            step[j] *= diagonal[j]
        for j in range(SIGMA):
            params[j] += step[j]
        for j in range(DENSE, UNKNOWNS):
            params[j] += step[j]
        strength = np.median(np.abs(params[DENSE:]))
        if iteration <= _SETTLED:
            # Hopeless starts show early: a ring is dark all round, or bright.
            middle = np.median(params[DENSE:])
            scatter = 1.4826 * np.median(np.abs(params[DENSE:] - middle)) / math.sqrt(KNOTS)
            if iteration > 0 and abs(middle) < _STEADY[iteration] * scatter:
                return False
            # A strong ring that is not yet in place leaves residuals of its own: they must not count as outliers.
            floor = 0.15 if iteration < _SETTLED else 0.05
            noise = 1.4826 * np.median(magnitude[:pixels]) + floor * strength + 1e-6
            if iteration == _SETTLED:
                _hide_clusters(x, y, magnitude, TUKEY * noise, 2, hidden)
        if linear:
            continue
        sigma = min(max(sigma + min(max(step[SIGMA], -0.3), 0.3), sigma_low), sigma_high)
        size = 0.5 * (geometry[2] + geometry[3])
        move = 0.0
        for j in range(5):
            limit = 1.0 if j < 2 else 0.12 * size
            d = min(max(step[GEOMETRY + j], -limit), limit)
            geometry[j] += d
            move = max(move, abs(d) if j < 2 else 0.5 * abs(d) / size * scale)
        half = math.sqrt(0.25 * (geometry[2] - geometry[3]) ** 2 + geometry[4] ** 2)
        low = 0.5 * (geometry[2] + geometry[3]) - half
        high = 0.5 * (geometry[2] + geometry[3]) + half
        if low <= 0.0 or low < high * flattest**2 or low * largest**2 < 1.0 or high * least**2 > 1.0:
            return False
        if abs(geometry[0] - ellipse[0]) + abs(geometry[1] - ellipse[1]) > 0.5 * scale + 2.0:
            return False
        if iteration > _SETTLED and move < _CONVERGED_PX:
            break
    scores = np.zeros(SECTORS)
    norms = np.zeros(SECTORS)
    gradients = np.zeros((SECTORS, 5))
    total = 0.0
    used = 0.0
    normal[:] = 0.0
    step[:] = 0.0
    for i in range(n):
        model, ring, amplitude = _row(x[i], y[i], knot[i], part[i], geometry, scale, sigma, params, row)
        residual[i] = value[i] - model
        weight = _tukey(residual[i], noise)
        if hidden[i] or weight == 0.0:
            continue
        sector = min(int((knot[i] + part[i]) / KNOTS * SECTORS), SECTORS - 1)
        scores[sector] += weight * (residual[i] + amplitude * ring) * ring
        norms[sector] += weight * ring * ring
        total += weight * residual[i] ** 2
        used += weight
        for j in range(5):
            gradients[sector, j] += weight * residual[i] * row[GEOMETRY + j]
        _accumulate(weight, residual[i], row, ring, knot[i], part[i], normal, step)
    norm = norms.sum()
    if used < 0.35 * n or norm <= 0.0:
        return False
    variance = total / max(used - UNKNOWNS, 1.0) * _WEIGHTED_VARIANCE
    # Brushed metal leaves residuals that are not independent: compare the scatter of the sectors' sums with what
    # independent noise gives.
    ratio = 0.0
    for j in range(5):
        ratio += (gradients[:, j] ** 2).sum() / (normal[GEOMETRY + j, GEOMETRY + j] * variance + 1e-30)
    # The fit has taken five degrees of freedom from the sectors' sums.
    inflation = max(1.0, ratio / 5.0 * SECTORS / (SECTORS - 5.0))
    variance *= inflation
    noise = math.sqrt(variance)
    if shape_sd > 0.0:
        _add_prior(geometry, shape, variance / shape_sd**2, normal, step)
    if not _scaled(normal, UNKNOWNS, 1e-9, work, diagonal):
        return False
    step_sd = 0.0
    for j in range(6):
        # Columns of the inverse: the geometry's, then the brightness step's.
        column = GEOMETRY + j if j < 5 else BACKGROUND
        step[:] = 0.0
        step[column] = diagonal[column]
        _substitute(work, UNKNOWNS, step)
        if j < 5:
            for k in range(5):
                value_jk = step[GEOMETRY + k] * diagonal[GEOMETRY + k]
                covariance[j, k] = value_jk * variance * _WEIGHTED_COVARIANCE
        else:
            step_sd = math.sqrt(step[column] * diagonal[column]) * noise
    mean = scores.sum() / norm
    sign = 1.0 if mean > 0.0 else -1.0
    hits = 0
    for k in range(SECTORS):
        if norms[k] > 0.0 and sign * scores[k] / math.sqrt(norms[k]) > 1.6 * noise:
            hits += 1
    for j in range(5):
        out[j] = geometry[j]
    out[5] = sigma
    out[6] = mean
    out[7] = params[BACKGROUND]
    out[8] = noise / math.sqrt(inflation)
    out[9] = abs(mean) * math.sqrt(norm) / noise
    out[10] = hits / SECTORS
    out[11] = abs(params[BACKGROUND]) / (step_sd + 1e-12)
    out[12] = share
    return True

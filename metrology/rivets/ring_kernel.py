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
LANES = 64  # pixels of one direction that are worked on together: loops of this fixed length become vector instructions
RESIDUAL = DENSE  # a pixel's row: derivatives by the dense unknowns, residual, shares of the ring of its two knots
ROW = DENSE + 3
SECTORS = 24  # in which the ring must show itself
_LINEAR_STEPS = 2  # iterations for the brightness alone
_SETTLED = 5  # iteration by which the ring is in place at the latest
# Least median of the amplitude over its standard deviation from the scatter of the knots, by iteration.
_STEADY = np.array([0.0, 1.0, 1.0, 1.2, 1.5, 2.0])
_CONVERGED_PX = 0.02  # the step after it is three times smaller: a tenth of the clearest ring's deviation
_IN_PLACE_PX = 0.15  # a step from which on all pixels count
_SIGMA_PRIOR_PX = 0.3  # how much rings of one image differ in σ from where the fit starts
TUKEY = 5.0  # residuals beyond this many sigmas count nothing
# For normal noise of variance 1 and Tukey's weights w with that limit: 1 / (Σ w r² / Σ w), and the estimate's variance
# times Σ w against plain least squares' (E ψ² / (E ψ')² · E w).
_WEIGHTED_VARIANCE = 1.180
_WEIGHTED_COVARIANCE = 0.962
_LEAST_SHARE = 0.3  # of the squared amplitude that is not noise, where there is a ring at all


@kernel
def _collect(image, e, reach, x, y, value):  # type: ignore[no-untyped-def]
    """Pixels within `reach` of the ellipse, in an order of which every beginning is spread evenly.

    One colour of a chessboard first. Returns how many that are, how many there are in all, and the share of the ellipse
    on the image.
    """
    height, width = image.shape
    size = max(e[2], e[3]) + reach + 1.0
    u0 = max(0, int(e[0] - size))
    u1 = min(width, int(e[0] + size) + 2)
    v0 = max(0, int(e[1] - size))
    v1 = min(height, int(e[1] + size) + 2)
    c = math.cos(e[4])
    s = math.sin(e[4])
    far = (1.0 + reach / min(e[2], e[3])) ** 2
    n = 0
    half = 0
    for colour in range(2):
        for v in range(v0, v1):
            for u in range(u0 + (u0 + v + colour) % 2, u1, 2):
                p = (c * (u - e[0]) + s * (v - e[1])) / e[2]
                q = (c * (v - e[1]) - s * (u - e[0])) / e[3]
                square = p * p + q * q
                if square > far or n == len(x):
                    continue
                f = math.sqrt(square)
                slope = math.sqrt((p / e[2]) ** 2 + (q / e[3]) ** 2) / max(f, 1e-9)
                if abs(f - 1.0) < reach * slope and not np.isnan(image[v, u]):
                    x[n] = u
                    y[n] = v
                    value[n] = image[v, u]
                    n += 1
        if colour == 0:
            half = n
    seen = 0
    for k in range(72):
        t = k * (2.0 * math.pi / 72.0)
        u = e[0] + c * e[2] * math.cos(t) - s * e[3] * math.sin(t)
        v = e[1] + s * e[2] * math.cos(t) + c * e[3] * math.sin(t)
        if 0.0 <= u <= width - 1 and 0.0 <= v <= height - 1:
            seen += 1
    return half, n, seen / 72.0


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
def _decay(t):  # type: ignore[no-untyped-def]
    """exp(−t) for t ≥ 0 to 1e-9, as a series for t/256 and eight squarings: the library's cannot be vectorised."""
    s = min(t, 60.0) * (1.0 / 256.0)
    e = 1.0 - s * (1.0 - s * (0.5 - s * (1.0 / 6.0 - s * (1.0 / 24.0 - s * (1.0 / 120.0)))))
    for _ in range(8):
        e *= e
    return e


@kernel
def _rows(x, y, value, part, knot, geometry, scale, sigma, params, rows):  # type: ignore[no-untyped-def]
    """The rows of a block's pixels, one unknown after the other: entry j of pixel i is rows[j * LANES + i].

    Their amplitude comes from `knot` and, by their shares `part`, from the one after it.
    """
    u0, v0, A, B, C = geometry[0], geometry[1], geometry[2], geometry[3], geometry[4]
    q0, q1, q2, q3, q4, q5 = params[0], params[1], params[2], params[3], params[4], params[5]
    s0, s1, s2 = params[6], params[7], params[8]
    here = params[DENSE + knot]
    after = params[DENSE + (knot + 1) % KNOTS]
    for i in range(LANES):
        dx = x[i] - u0
        dy = y[i] - v0
        f = math.sqrt(A * dx * dx + B * dy * dy + 2.0 * C * dx * dy) + 1e-12
        gx = (A * dx + C * dy) / f
        gy = (B * dy + C * dx) / f
        slope = math.sqrt(gx * gx + gy * gy) + 1e-12
        z = (f - 1.0) / (slope * sigma)
        ring = _decay(0.5 * z * z)
        # Φ(−z) from the same exponential (Abramowitz and Stegun 7.1.26, error below 1e-7).
        t = 1.0 / (1.0 + 0.23164191 * abs(z))
        tail = (
            0.5
            * ring
            * t
            * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
        )
        inside = tail if z > 0.0 else 1.0 - tail
        xs = dx / scale
        ys = dy / scale
        share = part[i]
        amplitude = here * (1.0 - share) + after * share
        step = s0 + s1 * xs + s2 * ys
        model = q0 + q1 * xs + q2 * ys + q3 * xs * xs + q4 * xs * ys + q5 * ys * ys + step * inside + amplitude * ring
        by_rho = -ring * (amplitude * z + step * 0.3989422804014327) / sigma
        by_f = by_rho / slope
        rows[i] = 1.0
        rows[LANES + i] = xs
        rows[2 * LANES + i] = ys
        rows[3 * LANES + i] = xs * xs
        rows[4 * LANES + i] = xs * ys
        rows[5 * LANES + i] = ys * ys
        rows[6 * LANES + i] = inside
        rows[7 * LANES + i] = inside * xs
        rows[8 * LANES + i] = inside * ys
        rows[SIGMA * LANES + i] = -by_rho * z
        rows[GEOMETRY * LANES + i] = -by_f * gx
        rows[(GEOMETRY + 1) * LANES + i] = -by_f * gy
        rows[(GEOMETRY + 2) * LANES + i] = by_f * dx * dx / (2.0 * f)
        rows[(GEOMETRY + 3) * LANES + i] = by_f * dy * dy / (2.0 * f)
        rows[(GEOMETRY + 4) * LANES + i] = by_f * dx * dy / f
        rows[RESIDUAL * LANES + i] = value[i] - model
        rows[(RESIDUAL + 1) * LANES + i] = ring * (1.0 - share)
        rows[(RESIDUAL + 2) * LANES + i] = ring * share


@kernel
def _tukey(residual, noise):  # type: ignore[no-untyped-def]
    t = residual / (TUKEY * noise)
    return (1.0 - t * t) ** 2 if abs(t) < 1.0 else 0.0


@kernel
def _hide_clusters(x, y, magnitude, limit, reach, hidden):  # type: ignore[no-untyped-def]
    """Hide pixels, too, with three or more beyond `limit` within `reach`: a glint's skirt does not stand out itself."""
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
        if count[int(y[i] - low_y), int(x[i] - low_x)] >= 3:
            hidden[i] = True


@kernel
def _glint_limit(direction, magnitude):  # type: ignore[no-untyped-def]
    """Departure, from the band's median or from the model, beyond which a pixel is a glint.

    Twice what the median direction reaches: a ring departs all round, a glint in a few directions.
    """
    largest = np.zeros(KNOTS)
    for i in range(len(direction)):
        k = min(int(direction[i]), KNOTS - 1)
        largest[k] = max(largest[k], magnitude[i])
    return 2.0 * np.median(largest)


@kernel
def _arrange(x, y, ellipse, half, slot, knot):  # type: ignore[no-untyped-def]
    """Places for pixels in blocks of one direction each: of the first `half` pixels, then of the others.

    `slot` gets a pixel's place, `knot` the knot of each block; returns the number of blocks of the first ones, and of
    all. A pixel's place between its knot and the next is left in the fraction of `direction`.
    """
    n = len(x)
    direction = np.empty(n)
    for i in range(n):
        direction[i] = (math.atan2(y[i] - ellipse[1], x[i] - ellipse[0]) + math.pi) / (2.0 * math.pi) * KNOTS
    blocks = 0
    few = 0
    for turn in range(2):
        first = 0 if turn == 0 else half
        end = half if turn == 0 else n
        fill = np.full(KNOTS, LANES, np.int64)
        block = np.empty(KNOTS, np.int64)
        for i in range(first, end):
            k = min(int(direction[i]), KNOTS - 1)
            if fill[k] == LANES:
                fill[k] = 0
                block[k] = blocks
                knot[blocks] = k
                blocks += 1
            slot[i] = block[k] * LANES + fill[k]
            fill[k] += 1
        if turn == 0:
            few = blocks
    return few, blocks, direction


@kernel
def _accumulate(rows, weight, knot, weighted, dense, knots, pairs):  # type: ignore[no-untyped-def]
    """Add a block's weighted products to the sums of which the normal equations are made (see `_assemble`)."""
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
def _assemble(dense, knots, pairs, normal, right):  # type: ignore[no-untyped-def]
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
    half, n, share = _collect(image, ellipse, reach, x, y, value)
    if n < 3 * UNKNOWNS or share < 0.5:
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
    step = np.zeros(UNKNOWNS)
    diagonal = np.empty(UNKNOWNS)
    work = np.empty((UNKNOWNS, UNKNOWNS))
    normal = np.zeros((UNKNOWNS, UNKNOWNS))
    start_sigma = sigma
    slot = np.empty(n, np.int64)
    most = n // LANES + 2 * KNOTS
    knot = np.empty(most, np.int64)
    few, blocks, direction = _arrange(x, y, ellipse, half, slot, knot)
    px = np.full((blocks, LANES), ellipse[0] + ellipse[2])
    py = np.full((blocks, LANES), ellipse[1])
    level = np.zeros((blocks, LANES))
    part = np.zeros((blocks, LANES))
    weight = np.zeros((blocks, LANES))
    for i in range(n):
        block = slot[i] // LANES
        lane = slot[i] % LANES
        px[block, lane] = x[i]
        py[block, lane] = y[i]
        level[block, lane] = value[i]
        part[block, lane] = direction[i] - knot[block]
    rows = np.empty((blocks, ROW * LANES))
    weighted = np.empty(LANES)
    dense = np.empty((RESIDUAL + 1, RESIDUAL + 1))
    knots = np.empty((KNOTS, RESIDUAL + 1))
    pairs = np.empty((KNOTS, 2))
    middle = np.median(value)
    for i in range(n):
        magnitude[i] = abs(value[i] - middle)
    _hide_clusters(x, y, magnitude, _glint_limit(direction, magnitude), 3, hidden)
    noise = 0.0
    settled = _SETTLED
    for iteration in range(iterations):
        # First the brightness alone on the starting ellipse, then everything; few pixels will do to get there.
        linear = iteration < _LINEAR_STEPS
        pixels = half if iteration < settled else n
        for block in range(few if iteration < settled else blocks):
            _rows(
                px[block],
                py[block],
                level[block],
                part[block],
                knot[block],
                geometry,
                scale,
                sigma,
                params,
                rows[block],
            )
        for i in range(pixels):
            residual[i] = rows[slot[i] // LANES, RESIDUAL * LANES + slot[i] % LANES]
            magnitude[i] = abs(residual[i])
        if iteration == 1:
            # On a slope of light the band's median tells no glint: only what departs from the light does.
            limit = _glint_limit(direction[:half], magnitude[:half])
            _hide_clusters(x[:half], y[:half], magnitude[:half], limit, 3, hidden[:half])
        for i in range(pixels):
            block = slot[i] // LANES
            lane = slot[i] % LANES
            weight[block, lane] = 0.0 if hidden[i] else 1.0 if iteration == 0 else _tukey(residual[i], noise)
        dense[:] = 0.0
        knots[:] = 0.0
        pairs[:] = 0.0
        for block in range(few if iteration < settled else blocks):
            _accumulate(rows[block], weight[block], knot[block], weighted, dense, knots, pairs)
        _assemble(dense, knots, pairs, normal, step)
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
        if iteration <= settled:
            # Hopeless starts show early: a ring is dark all round, or bright.
            middle = np.median(params[DENSE:])
            scatter = 1.4826 * np.median(np.abs(params[DENSE:] - middle)) / math.sqrt(KNOTS)
            if iteration > 0 and abs(middle) < _STEADY[iteration] * scatter:
                return False
            # A strong ring that is not yet in place leaves residuals of its own: they must not count as outliers.
            floor = 0.15 if iteration < settled else 0.05
            noise = 1.4826 * np.median(magnitude[:pixels]) + floor * strength + 1e-6
            if iteration == settled:
                hidden[:] = False
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
        gap = math.sqrt(0.25 * (geometry[2] - geometry[3]) ** 2 + geometry[4] ** 2)
        low = 0.5 * (geometry[2] + geometry[3]) - gap
        high = 0.5 * (geometry[2] + geometry[3]) + gap
        if low <= 0.0 or low < high * flattest**2 or low * largest**2 < 1.0 or high * least**2 > 1.0:
            return False
        if abs(geometry[0] - ellipse[0]) + abs(geometry[1] - ellipse[1]) > 0.5 * scale + 2.0:
            return False
        if iteration < settled and move < _IN_PLACE_PX:
            settled = iteration + 1
        if iteration > settled and move < _CONVERGED_PX:
            break
    scores = np.zeros(SECTORS)
    norms = np.zeros(SECTORS)
    gradients = np.zeros((SECTORS, 5))
    total = 0.0
    used = 0.0
    for block in range(blocks):
        _rows(px[block], py[block], level[block], part[block], knot[block], geometry, scale, sigma, params, rows[block])
    dense[:] = 0.0
    knots[:] = 0.0
    pairs[:] = 0.0
    for i in range(n):
        block = slot[i] // LANES
        lane = slot[i] % LANES
        residual[i] = rows[block, RESIDUAL * LANES + lane]
        w = 0.0 if hidden[i] else _tukey(residual[i], noise)
        weight[block, lane] = w
        k = knot[block]
        own = rows[block, (RESIDUAL + 1) * LANES + lane]
        others = rows[block, (RESIDUAL + 2) * LANES + lane]
        ring = own + others
        shown = params[DENSE + k] * own + params[DENSE + (k + 1) % KNOTS] * others
        sector = min(int(direction[i] / KNOTS * SECTORS), SECTORS - 1)
        scores[sector] += w * (residual[i] + shown) * ring
        norms[sector] += w * ring * ring
        total += w * residual[i] ** 2
        used += w
        for j in range(5):
            gradients[sector, j] += w * residual[i] * rows[block, (GEOMETRY + j) * LANES + lane]
    for block in range(blocks):
        _accumulate(rows[block], weight[block], knot[block], weighted, dense, knots, pairs)
    _assemble(dense, knots, pairs, normal, step)
    norm = norms.sum()
    if used < 0.35 * n or norm <= 0.0:
        return False
    variance = total / max(used - UNKNOWNS, 1.0) * _WEIGHTED_VARIANCE
    # Brushed metal leaves residuals that are not independent: compare the scatter of the sectors' sums with what
    # independent noise gives.
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
    # A streak is longer than a sector: neighbours' sums go together.
    together = max(1.0, 1.0 + 2.0 * products / (ratio + 1e-30) + 10.0 / (SECTORS - 5.0))
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
    # Noise makes the squared amplitude, and with it the information on the ring's place, look larger than it is.
    squares = 0.0
    excess = 0.0
    for k in range(KNOTS):
        step[:] = 0.0
        step[DENSE + k] = diagonal[DENSE + k]
        _substitute(work, UNKNOWNS, step)
        squares += params[DENSE + k] ** 2
        excess += step[DENSE + k] * diagonal[DENSE + k] * variance
    covariance[:] *= together / max(1.0 - excess / (squares + 1e-30), _LEAST_SHARE)
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

"""The ring model on the pixels of a band, and which of them count (see `ring`, where the model stands)."""

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
TUKEY = 5.0  # residuals beyond this many sigmas count nothing
_ROUND = 72  # places on the ellipse at which it is asked how much of it lies on the image
_CLUSTER = 3  # pixels within reach of one another that make a glint
_GLINT = 2.0  # times what the median direction reaches
_BELL = 1.0 / math.sqrt(2.0 * math.pi)


@kernel
def collect_pixels(image, e, reach, x, y, value):  # type: ignore[no-untyped-def]
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
    for k in range(_ROUND):
        t = k * (2.0 * math.pi / _ROUND)
        u = e[0] + c * e[2] * math.cos(t) - s * e[3] * math.sin(t)
        v = e[1] + s * e[2] * math.cos(t) + c * e[3] * math.sin(t)
        if 0.0 <= u <= width - 1 and 0.0 <= v <= height - 1:
            seen += 1
    return half, n, seen / _ROUND


@kernel
def arrange_in_blocks(x, y, ellipse, half, slot, knot):  # type: ignore[no-untyped-def]
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
def _decay(t):  # type: ignore[no-untyped-def]
    """exp(−t) for t ≥ 0 to 1e-9, as a series for t/256 and eight squarings: the library's cannot be vectorised."""
    s = min(t, 60.0) * (1.0 / 256.0)
    e = 1.0 - s * (1.0 - s * (0.5 - s * (1.0 / 6.0 - s * (1.0 / 24.0 - s * (1.0 / 120.0)))))
    for _ in range(8):
        e *= e
    return e


@kernel
def fill_rows(x, y, value, part, knot, scale, params, rows):  # type: ignore[no-untyped-def]
    """The rows of a block's pixels, one unknown after the other: entry j of pixel i is rows[j * LANES + i].

    Their amplitude comes from `knot` and, by their shares `part`, from the one after it.
    """
    sigma = params[SIGMA]
    u0, v0 = params[GEOMETRY], params[GEOMETRY + 1]
    A, B, C = params[GEOMETRY + 2], params[GEOMETRY + 3], params[GEOMETRY + 4]
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
        by_rho = -ring * (amplitude * z + step * _BELL) / sigma
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
def tukey(residual, noise):  # type: ignore[no-untyped-def]
    """Tukey's weight of a residual."""
    t = residual / (TUKEY * noise)
    return (1.0 - t * t) ** 2 if abs(t) < 1.0 else 0.0


@kernel
def hide_clusters(x, y, magnitude, limit, reach, hidden):  # type: ignore[no-untyped-def]
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
        if count[int(y[i] - low_y), int(x[i] - low_x)] >= _CLUSTER:
            hidden[i] = True


@kernel
def glint_limit(direction, magnitude):  # type: ignore[no-untyped-def]
    """Departure, from the band's median or from the model, beyond which a pixel is a glint.

    Twice what the median direction reaches: a ring departs all round, a glint in a few directions.
    """
    largest = np.zeros(KNOTS)
    for i in range(len(direction)):
        k = min(int(direction[i]), KNOTS - 1)
        largest[k] = max(largest[k], magnitude[i])
    return _GLINT * np.median(largest)

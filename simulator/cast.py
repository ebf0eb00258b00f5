"""Where a ray meets the panel, and whether a point of it sees the projector: exact intersection with each piece.

In the x-y plane a ray runs along a straight line; the borders it crosses cut that line into intervals, in each of
which the surface is smooth. An interval entered below its surface is a wall; one left below it holds the hit, found by
bracketed root finding to far below a nanometre.
"""

from __future__ import annotations

import math

from simulator.compiled import kernel
from simulator.relief import (
    BACKGROUND,
    BEAD,
    CABLE,
    COURSE,
    F_ABOVE,
    F_BACKGROUND,
    F_BELOW,
    F_X_MAX,
    F_X_MIN,
    F_Y_MAX,
    F_Y_MIN,
    HEAD,
    HEX_COS,
    HEX_SIN,
    HEXAGON,
    PLATE,
    R_CONE,
    R_HEAD_GX,
    R_HEAD_GY,
    R_HEAD_X,
    R_HEAD_Y,
    R_IS_HOLE,
    R_OUTER,
    R_RADIUS,
    R_RECESS,
    R_RING_GX,
    R_RING_GY,
    R_RING_X,
    R_RING_Y,
    R_SIZE,
    R_SLOT_COS,
    R_SLOT_CROSS,
    R_SLOT_LENGTH,
    R_SLOT_SIN,
    R_SLOT_WIDTH,
    S_CHAMFER,
    S_EX,
    S_EY,
    TORQ_SET,
    WIDTH,
    Floats,
    Relief,
    along,
    beside_border,
    cell_of,
    coat_at,
    lateral,
    piece_at,
    piece_height,
    plate_height,
    sides_of,
    skin_height,
    table,
)  # fmt: skip

# Rows of a thread's working memory: where along the ray a border is crossed, and the border's normal in the x-y plane.
MAX_BORDERS = 256
# The secant method's error is far below its last step: from here on below 1e-10 mm.
_TOLERANCE = 1e-6
_WALL_TOLERANCE = 1e-9  # mm: less than that below a piece is rounding, not a wall


@kernel
def _meet_skin(relief: Relief, o: Floats, d: Floats, guess: float) -> tuple[float, float]:
    """About where o + λ d meets the undisturbed skin, to a micrometre, and how fast it nears it there (mm per λ)."""
    a = guess
    fa = o[2] + a * d[2] - skin_height(relief.frame, o[0] + a * d[0], o[1] + a * d[1])
    b, rate = a - fa / d[2], d[2]
    for _ in range(50):
        fb = o[2] + b * d[2] - skin_height(relief.frame, o[0] + b * d[0], o[1] + b * d[1])
        if fb == fa:
            break
        step = abs(b - a)
        rate = (fb - fa) / (b - a)
        a, b, fa = b, b - fb / rate, fb
        if step < 1e-1:
            break
    return b, rate


@kernel
def _coated(relief: Relief, x: float, y: float, sides: int) -> float:
    """Height of a plate with what is painted on it."""
    return plate_height(relief, x, y, sides, -1) + coat_at(relief, x, y)


@kernel
def _meet_plate(relief: Relief, o: Floats, d: Floats, sides: int, start: float, rate: float) -> float:
    """Where it meets a plate with its step, exactly, from the skin nearby (secant method)."""
    a = start
    fa = o[2] + a * d[2] - _coated(relief, o[0] + a * d[0], o[1] + a * d[1], sides)
    b = a - fa / rate
    for _ in range(50):
        fb = o[2] + b * d[2] - _coated(relief, o[0] + b * d[0], o[1] + b * d[1], sides)
        if abs(fb) < 1e-12 or fb == fa:
            break
        c = b - fb * (b - a) / (fb - fa)
        if abs(c - b) < _TOLERANCE:
            return c
        a, b, fa = b, c, fb
    return b


@kernel
def _add(borders: Floats, n: int, low: float, high: float, at: float, nx: float, ny: float) -> int:
    """Keep a crossing if it lies within the ray's part; returns how many there are."""
    if at > low and at < high and n < MAX_BORDERS - 2:
        borders[n, 0], borders[n, 1], borders[n, 2] = at, nx, ny
        return n + 1
    return n


@kernel
def _add_circle(borders, n, low, high, o, d, cx, cy, gx, gy, radius):  # type: ignore[no-untyped-def]
    """Crossings with |p − c|² + (g·(p − c))² = radius²."""
    px, py = o[0] - cx, o[1] - cy
    pg, dg = gx * px + gy * py, gx * d[0] + gy * d[1]
    a = d[0] * d[0] + d[1] * d[1] + dg * dg
    b = px * d[0] + py * d[1] + pg * dg
    c = px * px + py * py + pg * pg - radius * radius
    root = b * b - a * c
    if root <= 0.0 or a <= 0.0:
        return n
    root = math.sqrt(root)
    for at in ((-b - root) / a, (-b + root) / a):
        x, y = px + at * d[0], py + at * d[1]
        g = gx * x + gy * y
        n = _add(borders, n, low, high, at, x + gx * g, y + gy * g)
    return n


@kernel
def _add_line(borders, n, low, high, o, d, x, y, nx, ny):  # type: ignore[no-untyped-def]
    """Crossing with the straight line through (x, y) with normal (nx, ny)."""
    rate = nx * d[0] + ny * d[1]
    if rate == 0.0:
        return n
    return _add(borders, n, low, high, (nx * (x - o[0]) + ny * (y - o[1])) / rate, nx, ny)


@kernel
def _add_hexagon(borders, n, low, high, o, d, rivet):  # type: ignore[no-untyped-def]
    """Crossings with the six sides of a hexagonal recess."""
    c, s, half = rivet[R_SLOT_COS], rivet[R_SLOT_SIN], 0.5 * rivet[R_SLOT_LENGTH]
    for k in range(3):
        across, along_it = (1.0, 0.0) if k == 0 else (HEX_COS, HEX_SIN if k == 1 else -HEX_SIN)
        nx, ny = across * c - along_it * s, across * s + along_it * c
        for sign in (-1.0, 1.0):
            x, y = rivet[R_HEAD_X] + sign * half * nx, rivet[R_HEAD_Y] + sign * half * ny
            n = _add_line(borders, n, low, high, o, d, x, y, nx, ny)
    return n


@kernel
def _add_rivet(borders, n, low, high, o, d, relief, r):  # type: ignore[no-untyped-def]
    rivet = relief.rivets[r]
    n = _add_circle(borders, n, low, high, o, d, rivet[R_RING_X], rivet[R_RING_Y], rivet[R_RING_GX],
                    rivet[R_RING_GY], rivet[R_OUTER])  # fmt: skip
    if rivet[R_IS_HOLE] > 0.0:
        if rivet[R_CONE] > 0.0:
            n = _add_circle(borders, n, low, high, o, d, rivet[R_RING_X], rivet[R_RING_Y], rivet[R_RING_GX],
                            rivet[R_RING_GY], rivet[R_RADIUS])  # fmt: skip
        return n
    n = _add_circle(borders, n, low, high, o, d, rivet[R_HEAD_X], rivet[R_HEAD_Y], rivet[R_HEAD_GX],
                    rivet[R_HEAD_GY], rivet[R_RADIUS])  # fmt: skip
    for k in range(R_SIZE, relief.rivets.shape[1]):
        angle = relief.rivets[r, k]
        if not math.isnan(angle):
            n = _add_line(borders, n, low, high, o, d, rivet[R_RING_X], rivet[R_RING_Y],
                          -math.sin(angle), math.cos(angle))  # fmt: skip
    if rivet[R_SLOT_WIDTH] > 0.0:
        c, s = rivet[R_SLOT_COS], rivet[R_SLOT_SIN]
        if rivet[R_RECESS] == HEXAGON:
            return _add_hexagon(borders, n, low, high, o, d, rivet)
        if rivet[R_RECESS] == TORQ_SET:
            n = _add_line(borders, n, low, high, o, d, rivet[R_HEAD_X], rivet[R_HEAD_Y], c, s)
            n = _add_line(borders, n, low, high, o, d, rivet[R_HEAD_X], rivet[R_HEAD_Y], -s, c)
        wide = rivet[R_SLOT_WIDTH] if rivet[R_RECESS] == TORQ_SET else 0.5 * rivet[R_SLOT_WIDTH]
        for half in (0.5 * rivet[R_SLOT_LENGTH], wide):
            for sign in (-1.0, 1.0):
                x, y = rivet[R_HEAD_X] + sign * half * c, rivet[R_HEAD_Y] + sign * half * s
                if rivet[R_SLOT_CROSS] > 0.0 or half == 0.5 * rivet[R_SLOT_LENGTH]:
                    n = _add_line(borders, n, low, high, o, d, x, y, c, s)
                x, y = rivet[R_HEAD_X] - sign * half * s, rivet[R_HEAD_Y] + sign * half * c
                if rivet[R_SLOT_CROSS] > 0.0 or half == wide:
                    n = _add_line(borders, n, low, high, o, d, x, y, -s, c)
    return n


@kernel
def _across(relief, s, o, d, at):  # type: ignore[no-untyped-def]
    """Distance of the ray's point at `at` from a seam's centre line, and the seam's half width there."""
    t, xi = lateral(relief, s, o[0] + at * d[0], o[1] + at * d[1])
    return t, 0.5 * table(relief, s, WIDTH, xi)[0]


@kernel
def _add_seam(borders, n, low, high, o, d, relief, s):  # type: ignore[no-untyped-def]
    """Crossings with a seam's edges, the outer ends of its chamfers and its centre (where crossing seams end)."""
    chamfer = relief.seams[s, S_CHAMFER]
    t_low, half_low = _across(relief, s, o, d, low)
    t_high, half_high = _across(relief, s, o, d, high)
    for k in range(5):
        if k >= 3 and chamfer <= 0.0:
            break
        # The line's distance from the centre: `share` half widths and `extra`.
        share = float(k - 1) if k < 3 else 2.0 * (k - 3) - 1.0
        extra = share * chamfer if k >= 3 else 0.0
        a, fa = low, t_low - share * half_low - extra
        b, fb = high, t_high - share * half_high - extra
        if fa * fb > 0.0 or fa == fb:
            continue
        # The course is nearly straight over the ray's short part: regula falsi converges at once.
        at = b - fb * (b - a) / (fb - fa)
        for _ in range(20):
            t, half = _across(relief, s, o, d, at)
            f = t - share * half - extra
            if abs(f) < 1e-12:
                break
            if fa * f <= 0.0:
                b, fb = at, f
            else:
                a, fa = at, f
            at = b - fb * (b - a) / (fb - fa)
        slope = table(relief, s, COURSE, along(relief, s, o[0] + at * d[0], o[1] + at * d[1]))[1]
        ex, ey = relief.seams[s, S_EX], relief.seams[s, S_EY]
        n = _add(borders, n, low, high, at, -ey - slope * ex, ex - slope * ey)
    return n


@kernel
def _borders(relief, o, d, low, high, row, column, beside, borders):  # type: ignore[no-untyped-def]
    """All borders crossed between `low` and `high`, in order, with both ends; returns how many."""
    n = 1
    if row >= 0:
        for k in range(relief.cells.shape[2] - 1):
            r = relief.cells[row, column, k]
            if r < 0:
                break
            n = _add_rivet(borders, n, low, high, o, d, relief, r)
    if beside or (row >= 0 and relief.cells[row, column, -1] > 0):
        for s in range(relief.seams.shape[0]):
            n = _add_seam(borders, n, low, high, o, d, relief, s)
    if beside:
        frame = relief.frame
        n = _add_line(borders, n, low, high, o, d, frame[F_X_MIN], 0.0, 1.0, 0.0)
        n = _add_line(borders, n, low, high, o, d, frame[F_X_MAX], 0.0, 1.0, 0.0)
        n = _add_line(borders, n, low, high, o, d, 0.0, frame[F_Y_MIN], 0.0, 1.0)
        n = _add_line(borders, n, low, high, o, d, 0.0, frame[F_Y_MAX], 0.0, 1.0)
    borders[0, 0] = low
    for i in range(2, n):
        at, nx, ny = borders[i, 0], borders[i, 1], borders[i, 2]
        j = i - 1
        while j > 0 and borders[j, 0] > at:
            for k in range(3):
                borders[j + 1, k] = borders[j, k]
            j -= 1
        borders[j + 1, 0], borders[j + 1, 1], borders[j + 1, 2] = at, nx, ny
    borders[n, 0] = high
    return n + 1


@kernel
def _excess(relief, kind, index, sides, o, d, at):  # type: ignore[no-untyped-def]
    """Height of the ray's point at `at` above a piece."""
    return o[2] + at * d[2] - piece_height(relief, kind, index, sides, o[0] + at * d[0], o[1] + at * d[1])


@kernel
def _root(relief, kind, index, sides, o, d, a, b, fa, fb):  # type: ignore[no-untyped-def]
    """Where the ray passes through a piece between a (above) and b (below): Illinois regula falsi."""
    c = b
    side = 0
    for _ in range(100):
        c = b - fb * (b - a) / (fb - fa)
        fc = _excess(relief, kind, index, sides, o, d, c)
        if abs(fc) < 1e-10:
            break
        if fc > 0.0:
            a, fa = c, fc
            if side == 1:
                fb *= 0.5
            side = 1
        else:
            b, fb = c, fc
            if side == -1:
                fa *= 0.5
            side = -1
    return c


@kernel
def cast(relief, o, d, guess, borders):  # type: ignore[no-untyped-def]
    """First meeting of the ray o + λ d (d[2] < 0, from above) with the panel or the background; `guess` is about where.

    Returns
    -------
    λ, kind, index, sides, wall_x, wall_y
        Kind is the piece behind a wall where the wall normal is not zero.
    """
    skin, rate = _meet_skin(relief, o, d, guess)
    x, y = o[0] + skin * d[0], o[1] + skin * d[1]
    row, column = cell_of(relief, x, y)
    beside = beside_border(relief, x, y)
    if row < 0 and not beside:
        sides = sides_of(relief, x, y)
        return _meet_plate(relief, o, d, sides, skin, rate), PLATE, 0, sides, 0.0, 0.0
    # The reach is generous, so the skin's slope at one place will do.
    low = skin + 1.1 * relief.frame[F_ABOVE] / rate
    high = (relief.frame[F_BACKGROUND] - o[2]) / d[2] if beside else skin - 1.1 * relief.frame[F_BELOW] / rate
    n = _borders(relief, o, d, low, high + 1e-6, row, column, beside, borders)
    kind, index, sides = PLATE, 0, 0
    for i in range(n - 1):
        a, b = borders[i, 0], borders[i + 1, 0]
        if b - a < 1e-12:
            continue
        middle = 0.5 * (a + b)
        kind, index, sides = piece_at(relief, row, column, o[0] + middle * d[0], o[1] + middle * d[1])
        fa = _excess(relief, kind, index, sides, o, d, a)
        if fa <= 0.0:
            if fa > -_WALL_TOLERANCE or i == 0:
                return a, kind, index, sides, 0.0, 0.0
            wall_x, wall_y = borders[i, 1], borders[i, 2]
            norm = math.sqrt(wall_x * wall_x + wall_y * wall_y)
            if wall_x * d[0] + wall_y * d[1] > 0.0:
                norm = -norm
            return a, kind, index, sides, wall_x / norm, wall_y / norm
        fb = _excess(relief, kind, index, sides, o, d, b)
        if fb <= 0.0:
            return _root(relief, kind, index, sides, o, d, a, b, fa, fb), kind, index, sides, 0.0, 0.0
    return high, kind, index, sides, 0.0, 0.0


@kernel
def lit(relief, p, light, borders):  # type: ignore[no-untyped-def]
    """Whether the point p (just off the surface) sees the point `light` past everything that stands above."""
    row, column = cell_of(relief, p[0], p[1])
    beside = beside_border(relief, p[0], p[1])
    if row < 0 and not beside:
        return True
    d = borders[MAX_BORDERS - 1]
    for k in range(3):
        d[k] = light[k] - p[k]
    norm = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    for k in range(3):
        d[k] /= norm
    if d[2] <= 0.0:
        return False
    skin, rate = _meet_skin(relief, p, d, 0.0)
    high = skin + 1.1 * relief.frame[F_ABOVE] / rate
    if high <= 0.0:
        return True
    n = _borders(relief, p, d, 0.0, high, row, column, beside, borders)
    for i in range(n - 1):
        a, b = borders[i, 0], borders[i + 1, 0]
        if b - a < 1e-12:
            continue
        middle = 0.5 * (a + b)
        kind, index, sides = piece_at(relief, row, column, p[0] + middle * d[0], p[1] + middle * d[1])
        if kind == BACKGROUND:
            continue
        # The ray starts on the surface and ends above everything.
        first = 1 if i == 0 else 0
        last = 2 if i == n - 2 else 3
        if kind not in (HEAD, CABLE, BEAD) and n == 2:
            return True
        for k in range(first, last):
            if _excess(relief, kind, index, sides, p, d, a + 0.5 * k * (b - a)) < -1e-7:
                return False
    return True

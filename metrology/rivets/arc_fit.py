"""From a voted centre to an ellipse: the ridge points that lie on one, and how much of it they cover."""

from __future__ import annotations

import math

import numpy as np

from metrology.jit import kernel
from metrology.linear import copy_values, solve


@kernel
def fit_conic(x, y, use, ellipse):  # type: ignore[no-untyped-def]
    """Least-squares conic through points with A + C = 1, which no rotation or shift changes.

    Minimises Σ (A x² + B x y + C y² + D x + E y + F)² on centred and scaled points.

    Parameters
    ----------
    x, y : (n,) float64
    use : (n,) bool
        Which points count.
    ellipse : (5,) float64, output
        u, v, semi-axis, semi-axis, angle (radians) of the first axis, the longer one.

    Returns
    -------
    bool
        Whether the conic is an ellipse.
    """
    count = 0
    mx = 0.0
    my = 0.0
    for i in range(len(x)):
        if use[i]:
            mx += x[i]
            my += y[i]
            count += 1
    if count < 6:
        return False
    mx /= count
    my /= count
    spread = 0.0
    for i in range(len(x)):
        if use[i]:
            spread += (x[i] - mx) ** 2 + (y[i] - my) ** 2
    scale = np.sqrt(spread / count) + 1e-12
    normal = np.zeros((5, 5))
    right = np.zeros(5)
    row = np.empty(5)
    for i in range(len(x)):
        if use[i]:
            p = (x[i] - mx) / scale
            q = (y[i] - my) / scale
            row[0] = p * p - q * q
            row[1] = p * q
            row[2] = p
            row[3] = q
            row[4] = 1.0
            for j in range(5):
                right[j] -= row[j] * q * q
                for k in range(5):
                    normal[j, k] += row[j] * row[k]
    for j in range(5):
        normal[j, j] += 1e-9 * count
    if not solve(normal, right, 5):
        return False
    ca, cb, cc, cd, ce, cf = right[0], right[1], 1.0 - right[0], right[2], right[3], right[4]
    discriminant = 4.0 * ca * cc - cb * cb
    if discriminant <= 1e-6:
        return False
    p0 = (cb * ce - 2.0 * cc * cd) / discriminant
    q0 = (cb * cd - 2.0 * ca * ce) / discriminant
    level = cf + 0.5 * (cd * p0 + ce * q0)
    half = np.sqrt(0.25 * (ca - cc) ** 2 + 0.25 * cb * cb)
    small = 0.5 - half
    large = 0.5 + half
    if small <= 1e-9 or level >= 0.0:
        return False
    ellipse[0] = p0 * scale + mx
    ellipse[1] = q0 * scale + my
    ellipse[2] = np.sqrt(-level / small) * scale
    ellipse[3] = np.sqrt(-level / large) * scale
    if abs(cb) < 1e-12:
        ellipse[4] = 0.0 if ca <= cc else 0.5 * np.pi
    else:
        ellipse[4] = np.arctan2(2.0 * (small - ca), cb)
    return True


@kernel
def _circle(x, y, use):  # type: ignore[no-untyped-def]
    """Algebraic circle (Kåsa) through points: u, v, radius; radius 0 where there is none."""
    n = 0
    mx = 0.0
    my = 0.0
    for i in range(len(x)):
        if use[i]:
            mx += x[i]
            my += y[i]
            n += 1
    if n < 5:
        return 0.0, 0.0, 0.0
    mx /= n
    my /= n
    xx = 0.0
    xy = 0.0
    yy = 0.0
    xz = 0.0
    yz = 0.0
    zz = 0.0
    for i in range(len(x)):
        if use[i]:
            p = x[i] - mx
            q = y[i] - my
            z = p * p + q * q
            xx += p * p
            xy += p * q
            yy += q * q
            xz += p * z
            yz += q * z
            zz += z
    det = xx * yy - xy * xy
    if det < 1e-9 * (xx + yy) ** 2:
        return 0.0, 0.0, 0.0
    a = 0.5 * (xz * yy - yz * xy) / det
    b = 0.5 * (yz * xx - xz * xy) / det
    return a + mx, b + my, math.sqrt(a * a + b * b + zz / n)


@kernel
def _image_of_circle(cu, cv, l11, l21, l22, a, b, radius, ellipse):  # type: ignore[no-untyped-def]
    """Image of the circle (a, b, radius) in the frame of the expected shape, of which l is the Cholesky factor."""
    uu = l11 * l11
    uv = l11 * l21
    vv = l21 * l21 + l22 * l22
    half = math.sqrt(0.25 * (uu - vv) ** 2 + uv**2)
    large = 0.5 * (uu + vv) + half
    ellipse[0] = cu + l11 * a
    ellipse[1] = cv + l21 * a + l22 * b
    ellipse[2] = radius * math.sqrt(large)
    ellipse[3] = radius / math.sqrt(large)
    ellipse[4] = 0.5 * math.atan2(2.0 * uv, uu - vv)


@kernel
def _elongation(ellipse):  # type: ignore[no-untyped-def]
    """See `shapes.log_shape`."""
    e = math.log(ellipse[2] / ellipse[3])
    return e * math.cos(2.0 * ellipse[4]), e * math.sin(2.0 * ellipse[4])


@kernel
def _points_near(cu, cv, radius, u, v, nu, nv, rows, factor):  # type: ignore[no-untyped-def]
    """Ridge points whose distance and normal suit a ring about (cu, cv), one a row.

    Columns: x, y and the distance from the centre in the frame where the expected shape is a circle (`factor`: its
    Cholesky factor l11, l21, l22), then u, v and the normal in the picture.
    """
    l11, l21, l22 = factor
    reach = 1.5 * radius * math.sqrt(max(l11 * l11, l21 * l21 + l22 * l22)) + 3.0
    lo = rows[min(max(int(cv - reach), 0), len(rows) - 1)]
    hi = rows[min(max(int(cv + reach) + 1, 0), len(rows) - 1)]
    points = np.empty((7, hi - lo))
    n = 0
    for i in range(lo, hi):
        du = u[i] - cu
        dv = v[i] - cv
        if abs(du) > reach:
            continue
        p = du / l11
        q = (dv - l21 * p) / l22
        d = math.sqrt(p * p + q * q)
        if d < 0.65 * radius or d > 1.45 * radius:
            continue
        # Normals turn with the transpose of the map.
        gu = l11 * nu[i] + l21 * nv[i]
        gv = l22 * nv[i]
        g = math.sqrt(gu * gu + gv * gv)
        if abs(p * gu + q * gv) < 0.82 * d * g:
            continue
        points[0, n] = p
        points[1, n] = q
        points[2, n] = d
        points[3, n] = u[i]
        points[4, n] = v[i]
        points[5, n] = nu[i]
        points[6, n] = nv[i]
        n += 1
    return points[:, :n]


@kernel
def _shared_radius(distance, radius):  # type: ignore[no-untyped-def]
    """The distance from the centre that most points share, each weighted by the part of its circle that it covers."""
    bins = int(0.8 * radius / 0.75) + 3
    histogram = np.zeros(bins)
    for i in range(len(distance)):
        histogram[int((distance[i] - 0.65 * radius) / 0.75) + 1] += 1.0 / distance[i]
    best = -1.0
    mode = radius
    for k in range(1, bins - 1):
        total = histogram[k] + 0.7 * (histogram[k - 1] + histogram[k + 1])
        if total > best:
            best = total
            mode = 0.65 * radius + 0.75 * (k - 0.5)
    return mode


@kernel
def _circle_by_steps(x, y, radius, mode, use):  # type: ignore[no-untyped-def]
    """Circle through the points that lie near it, with shrinking tolerance: centre and radius."""
    tolerance = max(1.8, 0.14 * mode)
    a = 0.0
    b = 0.0
    for _ in range(3):
        for i in range(len(x)):
            use[i] = abs(math.sqrt((x[i] - a) ** 2 + (y[i] - b) ** 2) - mode) < tolerance
        p, q, d = _circle(x, y, use)
        if d <= 0.0 or d > 1.6 * radius or d < 0.6 * radius or abs(p - a) + abs(q - b) > radius:
            break
        a = p
        b = q
        mode = d
        tolerance = max(1.4, 0.75 * tolerance)
    return a, b, mode


@kernel
def _points_on(ellipse, limit, u, v, nu, nv, use):  # type: ignore[no-untyped-def]
    """Mark the points within `limit` pixels of an ellipse whose normals agree with it.

    Returns the share of the ellipse's sectors that have one, and the points' mean distance.
    """
    c = math.cos(ellipse[4])
    s = math.sin(ellipse[4])
    sectors = max(12, int(2.0 * math.pi * math.sqrt(ellipse[2] * ellipse[3]) / 1.7))
    seen = np.zeros(sectors, np.bool_)
    count = 0
    distance = 0.0
    for i in range(len(u)):
        p = (c * (u[i] - ellipse[0]) + s * (v[i] - ellipse[1])) / ellipse[2]
        q = (c * (v[i] - ellipse[1]) - s * (u[i] - ellipse[0])) / ellipse[3]
        f = math.sqrt(p * p + q * q) + 1e-9
        gp = p / ellipse[2] / f
        gq = q / ellipse[3] / f
        g = math.sqrt(gp * gp + gq * gq)
        d = abs(f - 1.0) / g
        aligned = abs((gp * c - gq * s) * nu[i] + (gp * s + gq * c) * nv[i]) / g
        use[i] = d < limit and aligned > 0.87
        if use[i]:
            count += 1
            distance += d
            sector = int((math.atan2(q, p) + math.pi) / (2.0 * math.pi) * sectors)
            seen[min(sector, sectors - 1)] = True
    return seen.sum() / sectors, distance / max(count, 1)


@kernel
def fit_candidate(cu, cv, radius, u, v, nu, nv, rows, shape, freedom, ellipse):  # type: ignore[no-untyped-def]
    """Ellipse through the ridge points round a candidate.

    First the radius that most points share, then a circle in the frame where the expected shape is a circle (three
    unknowns, safe on short arcs), then a general conic with shrinking tolerance where enough of it is covered. A conic
    that is no longer the expected shape has taken in a glint or a scratch: there it stays a circle.

    Parameters
    ----------
    cu, cv, radius : float
        Candidate, px.
    u, v, nu, nv : (n,) float64
        Ridge points sorted by v, and their normals.
    rows : (h + 1,) int64
        rows[y]: the first point with v ≥ y.
    shape : (3,) float64
        Entries uu, vv, uv of the expected shape matrix of determinant 1.
    freedom : float
        By how much a conic's elongation may depart from the expected one, see `shapes.log_shape`; 0: no conic.
    ellipse : (5,) float64, output

    Returns
    -------
    coverage : float
        Share of the ellipse with a ridge point; 0 where there is no ellipse.
    agreement : float
        1 − mean distance of the points in pixels.
    """
    l11 = math.sqrt(shape[0])
    l21 = shape[2] / l11
    l22 = math.sqrt(max(shape[1] - l21 * l21, 1e-9))
    points = _points_near(cu, cv, radius, u, v, nu, nv, rows, (l11, l21, l22))
    if points.shape[1] < 6:
        return 0.0, 0.0
    x, y, pu, pv, mu, mv = points[0], points[1], points[3], points[4], points[5], points[6]
    use = np.empty(len(x), np.bool_)
    a, b, mode = _circle_by_steps(x, y, radius, _shared_radius(points[2], radius), use)
    _image_of_circle(cu, cv, l11, l21, l22, a, b, mode, ellipse)
    expected_x, expected_y = _elongation(ellipse)
    large = ellipse[2] / ellipse[3]
    trial = np.empty(5)
    coverage = 0.0
    distance = 0.0
    for step in range(5):
        limit = max(0.75, 1.6 - 0.3 * step)
        if step == 0:
            limit = max(limit, 0.1 * mode)
        coverage, distance = _points_on(ellipse, limit, pu, pv, mu, mv, use)
        if step == 4 or coverage < 0.5:
            break
        copy_values(trial, ellipse)
        if freedom > 0.0 and fit_conic(pu, pv, use, trial):
            ex, ey = _elongation(trial)
            as_large = trial[3] >= 0.45 * radius and trial[2] <= 1.7 * radius * math.sqrt(large)
            if as_large and math.hypot(ex - expected_x, ey - expected_y) < freedom:
                copy_values(ellipse, trial)
                continue
        a, b, mode = _circle(x, y, use)
        if mode < 0.6 * radius or mode > 1.6 * radius:
            break
        _image_of_circle(cu, cv, l11, l21, l22, a, b, mode, ellipse)
    return coverage, 1.0 - distance


@kernel
def fit_candidates(  # type: ignore[no-untyped-def]
    candidates, u, v, nu, nv, rows, shapes, freedom, ellipses, coverage, agreement
):
    """`fit_candidate` for each row (u, v, radius) of `candidates`, with its own expected shape."""
    for i in range(len(candidates)):
        coverage[i], agreement[i] = fit_candidate(
            candidates[i, 0], candidates[i, 1], candidates[i, 2], u, v, nu, nv, rows, shapes[i], freedom, ellipses[i]
        )


@kernel
def strike_repeats(ellipses, alive):  # type: ignore[no-untyped-def]
    """Clear `alive` of the ellipses (u, v, semi-axes, …) that nearly repeat one before them."""
    for k in range(len(ellipses)):
        if not alive[k]:
            continue
        radius = math.sqrt(ellipses[k, 2] * ellipses[k, 3])
        near = 0.1 * ellipses[k, 3] + 1.0
        for i in range(k + 1, len(ellipses)):
            if alive[i] and math.hypot(ellipses[i, 0] - ellipses[k, 0], ellipses[i, 1] - ellipses[k, 1]) < near:
                other = math.sqrt(ellipses[i, 2] * ellipses[i, 3])
                alive[i] = abs(other - radius) >= 0.04 * radius + 1.0

"""Compiled fit of a head's rim in both cameras' images (see `rim`, where the model stands)."""

from __future__ import annotations

import math

import numpy as np

from metrology.jit import kernel
from metrology.linear import solve
from metrology.robust import MAD

# Unknowns: shift of the centre and of the radius, gap, edge break (mm), brightness of the gap's floor and of what no
# light reaches (shares of the skin's), half-width of the blur (mm). Head and skin have each direction's own brightness.
SHIFT, RADIUS, GAP, BREAK, FLOOR, BLACK, BLUR = 0, 2, 3, 4, 5, 6, 7
UNKNOWNS = 8
STEPS = 5  # in brightness, from head to skin
_ALL = UNKNOWNS + 2
_SLANTED = math.sqrt(0.5)  # an edge is broken at 45°
_WALL = 0.7  # of the skin's brightness that a wall has which faces the light as squarely
_TUKEY = 5.0
_CONVERGED_MM = 2e-4
_LONGEST_STEP = 0.1  # mm, or share of the skin's brightness


@kernel
def rim_steps(height, towards_camera, towards_light, gap, edge, floor, black, at, by_gap, by_edge, level):  # type: ignore[no-untyped-def]
    """Where the brightness steps along the rim's normal, and the levels between.

    Parameters
    ----------
    height : float
        Of the head over the skin, mm.
    towards_camera, towards_light : float
        Slopes of the directions to camera and projector along the normal: lateral over vertical.
    gap, edge, floor, black : float
        See `UNKNOWNS`.
    at, by_gap, by_edge : (STEPS,) float64, output
        Distances from the head's edge, mm, in the head's plane as the camera sees it; their derivatives.
    level : (STEPS + 1,) float64, output
        Shares of the skin's brightness; the first and the last, head and skin, stay as they are.
    """
    seen = height * towards_camera
    by_gap[:] = 0.0
    by_edge[:] = 0.0
    level[1] = _SLANTED * (1.0 + towards_light)
    if height > 0.0:
        # Edge break, side wall, shadow on the skin, the gap's floor; the far side hides what lies behind it.
        wall = max(seen, 0.0)
        shade = max(0.0, seen + max(0.0, -height * towards_light))
        at[0], at[1], at[2], at[3], at[4] = -edge, 0.0, wall, shade, max(shade, gap + seen)
        by_edge[0] = -1.0
        by_gap[4] = 1.0 if gap + seen > shade else 0.0
        level[2] = black + _WALL * max(towards_light, 0.0)
        level[3] = black
        level[4] = floor
    else:
        # Edge break, the gap's floor, the skin's shadow in it or on the head, the skin's wall.
        end = gap + seen
        shade = min(end, gap + min(0.0, height * towards_light))
        rim = min(0.0, shade)
        at[0], at[1], at[2], at[3], at[4] = min(-edge, rim), rim, shade, max(shade, min(gap, end)), end
        by_gap[2:] = 1.0
        by_gap[1] = 1.0 if shade < 0.0 else 0.0
        if -edge < rim:
            by_edge[0] = -1.0
        else:
            by_gap[0] = by_gap[1]
        level[2] = floor
        level[3] = black
        level[4] = black + _WALL * max(-towards_light, 0.0)


@kernel
def _model(distance, at, by_gap, by_edge, level, blur, inside, outside, cosine, sine, black_levels, row):  # type: ignore[no-untyped-def]
    """Model at a distance from the head's edge and its derivatives by all unknowns, then by inside and outside."""
    row[:] = 0.0
    value = inside
    row[UNKNOWNS] = 1.0
    for j in range(STEPS):
        z = (distance - at[j]) / blur
        bell = math.exp(-0.5 * z * z)
        # Φ(−|z|) from the same exponential (Abramowitz and Stegun 7.1.26).
        t = 1.0 / (1.0 + 0.23164191 * abs(z))
        tail = (
            0.5
            * bell
            * t
            * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
        )
        passed = 1.0 - tail if z > 0.0 else tail
        before = inside if j == 0 else level[j]
        after = outside if j == STEPS - 1 else level[j + 1]
        value += (after - before) * passed
        by_place = -(after - before) * bell * 0.3989422804014327 / blur
        row[SHIFT] += by_place * cosine
        row[SHIFT + 1] += by_place * sine
        row[RADIUS] += by_place
        row[GAP] += by_place * by_gap[j]
        row[BREAK] += by_place * by_edge[j]
        row[BLUR] += by_place * z
        # The level before the step ends here, the one after it begins; that of the edge break is no unknown.
        if j == 0:
            row[UNKNOWNS] -= passed
        elif j > 1:
            row[BLACK if black_levels[j] else FLOOR] -= passed
        if j == STEPS - 1:
            row[UNKNOWNS + 1] += passed
        elif j > 0:
            row[BLACK if black_levels[j + 1] else FLOOR] += passed
    return value


@kernel
def _gather(  # type: ignore[no-untyped-def]
    profile, first, spacing, blur, at, by_gap, by_edge, level, ends, normal, black_levels, noise, system, right, size
):
    """Normal equations of one profile; the residuals' sizes go to `size`, zero where there is no sample."""
    row = np.empty(_ALL)
    system[:] = 0.0
    right[:] = 0.0
    for m in range(len(profile)):
        size[m] = 0.0
        if np.isnan(profile[m]):
            continue
        value = _model(
            first + m * spacing, at, by_gap, by_edge, level, blur, ends[0], ends[1], normal[0], normal[1],
            black_levels, row,
        )  # fmt: skip
        residual = profile[m] - value
        size[m] = abs(residual)
        weight = 1.0
        if noise > 0.0:
            t = residual / (_TUKEY * noise)
            weight = (1.0 - t * t) ** 2 if abs(t) < 1.0 else 0.0
        for i in range(_ALL):
            right[i] += weight * row[i] * residual
            for j in range(i + 1):
                system[i, j] += weight * row[i] * row[j]


@kernel
def _eliminate(system, right, ends, matrix, step):  # type: ignore[no-untyped-def]
    """Solve for a direction's own brightness, and add what is left of its equations to those of all."""
    h, s = UNKNOWNS, UNKNOWNS + 1
    a, b, d = system[h, h] + 1e-9, system[s, h], system[s, s] + 1e-9
    det = a * d - b * b
    if det < 1e-6:
        return
    ends[0] += (d * right[h] - b * right[s]) / det
    ends[1] += (a * right[s] - b * right[h]) / det
    for i in range(UNKNOWNS):
        p = (d * system[h, i] - b * system[s, i]) / det
        q = (a * system[s, i] - b * system[h, i]) / det
        step[i] += right[i] - p * right[h] - q * right[s]
        for j in range(i + 1):
            matrix[i, j] += system[i, j] - p * system[h, j] - q * system[s, j]


@kernel
def _advance(unknowns, step):  # type: ignore[no-untyped-def]
    """Take a step of limited length, lengths staying positive; returns how far the centre moves."""
    move = 0.0
    for i in range(UNKNOWNS):
        change = min(max(step[i], -_LONGEST_STEP), _LONGEST_STEP)
        if i in (GAP, BREAK, BLUR) and unknowns[i] + change < 0.0:
            change = -0.5 * unknowns[i]
        unknowns[i] += change
        if i < RADIUS:
            move = max(move, abs(change))
    return move


@kernel
def fit_rim_kernel(profiles, ends, first, spacing, directions, height, slopes, light, start, spread, iterations, out):  # type: ignore[no-untyped-def]
    """Robust Gauss-Newton fit of the rim model to profiles across it.

    Parameters
    ----------
    profiles : (cameras, k, m) float64
        Image along k normals of the circle, shares of the skin's brightness; NaN where there is none.
    ends : (cameras, k, 2) float64
        Brightness of head and skin to start from, by direction; overwritten by what is found.
    first, spacing : float
        Distance of the first sample from the circle, and between samples, mm.
    directions : (k, 2) float64
        Unit normals of the circle.
    height : float
    slopes : (cameras, 2) float64
        Lateral over vertical part of the direction to each camera.
    light : (2,) float64
        The same to the projector.
    start, spread : (UNKNOWNS,) float64
        What to start from and is expected, and by how much the truth may differ.
    iterations : int
    out : (UNKNOWNS + 1,) float64, output
        The unknowns, then the standard deviation of the residuals.

    Returns
    -------
    bool
        Whether the fit converged.
    """
    cameras, count, samples = profiles.shape
    at, by_gap, by_edge, level = np.empty(STEPS), np.empty(STEPS), np.empty(STEPS), np.zeros(STEPS + 1)
    system, right = np.empty((_ALL, _ALL)), np.empty(_ALL)
    size = np.zeros((cameras * count, samples))
    black_levels = np.zeros(STEPS + 1, np.bool_)
    black_levels[2 if height > 0.0 else 3] = True
    black_levels[3 if height > 0.0 else 4] = True
    unknowns = start.copy()
    noise = 0.0
    move = 1.0
    for _ in range(iterations):
        matrix = np.zeros((UNKNOWNS, UNKNOWNS))
        step = np.zeros(UNKNOWNS)
        for c in range(cameras):
            for k in range(count):
                normal = directions[k]
                rim_steps(
                    height, slopes[c, 0] * normal[0] + slopes[c, 1] * normal[1],
                    light[0] * normal[0] + light[1] * normal[1], unknowns[GAP], unknowns[BREAK], unknowns[FLOOR],
                    unknowns[BLACK], at, by_gap, by_edge, level,
                )  # fmt: skip
                edge = unknowns[RADIUS] + unknowns[SHIFT] * normal[0] + unknowns[SHIFT + 1] * normal[1]
                _gather(
                    profiles[c, k], first - edge, spacing, unknowns[BLUR], at, by_gap, by_edge, level, ends[c, k],
                    normal, black_levels, noise, system, right, size[c * count + k],
                )  # fmt: skip
                _eliminate(system, right, ends[c, k], matrix, step)
        noise = MAD * np.median(size) + 1e-4
        for i in range(UNKNOWNS):
            # Neighbouring samples share pixels, and grain is broad: a sample is worth a quarter of an independent one.
            prior = 4.0 * (noise / spread[i]) ** 2
            matrix[i, i] += prior
            step[i] += prior * (start[i] - unknowns[i])
        if not solve(matrix, step, UNKNOWNS):
            return False
        move = _advance(unknowns, step)
        if move < _CONVERGED_MM:
            break
    for i in range(UNKNOWNS):
        out[i] = unknowns[i]
    out[UNKNOWNS] = noise
    return move < 20.0 * _CONVERGED_MM

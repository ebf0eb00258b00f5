"""Normal equations of a gap's pictures: what each station's pixels tell of its borders and of the shared shape.

A picture is a sum of blurred steps from one visible region's brightness to the next one's. So it changes with a
parameter as far as the steps' places do (known from the outline alone) times each step's slope: one look at the pixels
gives all derivatives. Only where a parameter lets a region appear is the picture itself taken twice.
"""

from __future__ import annotations

import math

import numpy as np

from metrology.jit import kernel
from metrology.seams.gap.model import (
    CHAMFER_WIDTH_A,
    COLUMNS,
    LEAN,
    LEVELS,
    OUTLINE,
    PIECES,
    SKIN_A,
    SKIN_B,
    SKY,
    SLOPE_A,
    SLOPE_B,
    VERTICES,
    A,
    B,
    basis_at,
    cut,
    project,
    steps_at,
    visible,
)

# Change by which outlines' derivatives are taken: mm or tangent.
_DIFFERENCE = 1e-4
# What `steps_at` gives.
_STEP, _SLOPE, _BY_SPILL, _BY_LENS = range(4)
# Sums over pixels go on to the next multiple of what the processor adds at once; weights are 0 there.
_AT_ONCE = 16
# Columns of the Jacobian: the outline's parameters, the lean's change, spill and the camera's own lens.
_LEAN_CHANGE, _SPILL, _LENS, _SHAPE = range(OUTLINE, OUTLINE + 4)


@kernel
def normal_equations(  # type: ignore[no-untyped-def]
    samples, greys, variances, sizes, places, borders, shared, tables, sealed, tilts, eyes, lamps, px_mm, precisions,
    courses, normals, gradients, levels, costs,
):  # fmt: skip
    """Least squares of many stations with each one's own levels eliminated.

    Of each station's parameters θ (its two borders; then, where there is room, what is shared: both chamfers, depth,
    lean, the chamfers' slope, the lean's change along the seam, spill, each camera's lens, and each camera's usual
    levels) JᵀWJ goes into `normals`, JᵀWr into `gradients`. A station's levels keep to the usual ones, plus their
    `courses`, with the `precisions`.
    """
    stations, cameras, most = samples.shape
    with_shape = normals.shape[1] > 2
    columns, changes = (_SHAPE, OUTLINE) if with_shape else (2, 2)
    outline, rows = np.empty(OUTLINE), np.arange(columns)
    # The outline as it is comes last, after those with one parameter changed.
    pieces, counts = np.empty((OUTLINE + 1, PIECES, COLUMNS)), np.zeros(OUTLINE + 1, np.int64)
    x, h = np.empty((OUTLINE + 1, VERTICES)), np.empty((OUTLINE + 1, VERTICES))
    room = (most + _AT_ONCE - 1) // _AT_ONCE * _AT_ONCE
    basis, weighted = np.zeros((LEVELS, room)), np.empty((LEVELS, room))
    jacobian, pulls = np.zeros((columns, room)), np.empty((columns, room))
    weight, residual, inverse = np.empty(room), np.zeros((1, room)), np.empty((LEVELS, LEVELS))
    view = _view(4 if with_shape else 2, room)
    for s in range(stations):
        normals[s], gradients[s], costs[s] = 0.0, 0.0, 0.0
        outline[A], outline[B] = borders[s, 0], borders[s, 1]
        for p in range(CHAMFER_WIDTH_A, OUTLINE):
            outline[p] = shared[p - CHAMFER_WIDTH_A]
        outline[LEAN] += places[s] * shared[OUTLINE - 2]
        counts[OUTLINE] = cut(outline, sealed, tilts[s], lamps[s], x[OUTLINE], h[OUTLINE], pieces[OUTLINE])
        for p in range(changes):
            kept = outline[p]
            outline[p] = kept + _DIFFERENCE
            counts[p] = cut(outline, sealed, tilts[s], lamps[s], x[p], h[p], pieces[p])
            outline[p] = kept
        for c in range(cameras):
            n = sizes[s, c]
            if n == 0:
                continue
            first = OUTLINE + cameras + c * LEVELS
            usual = shared[first : first + LEVELS] + courses[s, c]
            level = levels[s, c]
            looks = (samples[s, c], n, eyes[s, c], px_mm[s, c], tables[c])
            found = _look(looks, x[OUTLINE], h[OUTLINE], pieces[OUTLINE], counts[OUTLINE], view, basis)
            wide = (n + _AT_ONCE - 1) // _AT_ONCE * _AT_ONCE
            for k in range(wide):
                weight[k], residual[0, k] = (1.0 / variances[s, c, k], greys[s, c, k]) if k < n else (0.0, 0.0)
            _fit_levels(basis, wide, residual, weight, usual, precisions, weighted, inverse, level)
            for i in range(LEVELS):
                costs[s] += precisions[i] * (level[i] - usual[i]) ** 2
                for k in range(wide):
                    residual[0, k] -= level[i] * basis[i, k]
            for k in range(wide):
                costs[s] += residual[0, k] ** 2 * weight[k]
            _differentiate(looks, x, h, pieces, counts, changes, found, view, basis, level, jacobian)
            if with_shape:
                for k in range(n):
                    jacobian[_LEAN_CHANGE, k] = places[s] * jacobian[LEAN, k]
                rows[_LENS] = _LENS + c
            normal, gradient = normals[s], gradients[s]
            explained = _add_view(basis, jacobian, residual, weight, wide, pulls, inverse, rows, normal, gradient)
            if with_shape:
                at = 2 + first
                _add_usual_levels(precisions, level, usual, inverse, explained, rows, at, normal, gradient)


@kernel
def _view(kinds, room):  # type: ignore[no-untyped-def]
    """Room for what a camera sees: twice, as the outline is and changed, where intervals end and what is seen there;
    then spans, steps and skins' borders of the one, and spare ones with a spare basis."""
    ends, shown = np.empty((2, PIECES + 1)), np.empty((2, PIECES + 1), np.int64)
    blurred, spare = np.empty((kinds, PIECES, room)), np.empty((1, PIECES, room))
    spans = np.empty((2, PIECES, 2), np.int64)
    return ends, shown, np.empty((2, 2)), spans, blurred, spare, np.empty((LEVELS, room))


@kernel
def _see(looks, x, h, pieces, count, borders, ends, shown):  # type: ignore[no-untyped-def]
    """Where the camera sees the skins' borders and the intervals' ends; returns the intervals' number."""
    eye = looks[2]
    borders[0], borders[1] = project(x[1], h[1], eye[0], eye[1]), project(x[6], h[6], eye[0], eye[1])
    return visible(pieces, count, eye, 0.5 * (x[1] + x[6]), ends, shown)


@kernel
def _look(looks, x, h, pieces, count, view, basis):  # type: ignore[no-untyped-def]
    """The outline's basis; returns the number of visible intervals."""
    samples, n, _, px_mm, table = looks
    ends, shown, borders, spans, blurred, _, _ = view
    found = _see(looks, x, h, pieces, count, borders[0], ends[0], shown[0])
    steps_at(samples, n, ends[0], found - 1, px_mm, table, spans[0], blurred)
    basis_at(samples, n, pieces, shown[0], found, borders[0], spans[0], blurred[_STEP], basis)
    return found


@kernel
def _differentiate(looks, x, h, pieces, counts, changes, found, view, basis, level, jacobian):  # type: ignore[no-untyped-def]
    """Change of the picture with the outline's parameters and, where all of these change, with the blur."""
    samples, n, _, px_mm, table = looks
    ends, shown, borders, spans, blurred, spare, other = view
    base = pieces[OUTLINE]
    jacobian[:, :n] = 0.0
    alike = np.zeros(changes, np.bool_)
    moves = np.zeros((changes, PIECES))
    for p in range(changes):
        seen = _see(looks, x[p], h[p], pieces[p], counts[p], borders[1], ends[1], shown[1])
        alike[p] = seen == found and counts[p] == counts[OUTLINE]
        for i in range(min(seen, found)):
            k = shown[0, i]
            alike[p] &= shown[1, i] == k and pieces[p, k, 4] == base[k, 4]
            moves[p, i] = (ends[1, i] - ends[0, i]) / _DIFFERENCE
        if not alike[p]:
            steps_at(samples, n, ends[1], seen - 1, px_mm, table, spans[1], spare)
            basis_at(samples, n, pieces[p], shown[1], seen, borders[1], spans[1], spare[_STEP], other)
            for i in range(LEVELS):
                for k in range(n):
                    jacobian[p, k] += level[i] * (other[i, k] - basis[i, k]) / _DIFFERENCE
            continue
        _add_skins_and_sky(n, borders, pieces[p], base, shown[0], found, spans[0], blurred[_STEP], basis, level,
                           jacobian[p])  # fmt: skip
    jump = np.empty(n)
    for i in range(found - 1):
        begin, end = spans[0, i, 0], spans[0, i, 1]
        _fill_jump(samples, begin, end, base[shown[0, i]], base[shown[0, i + 1]], borders[0], level, jump)
        if changes == OUTLINE:
            for k in range(begin, end):
                jacobian[_SPILL, k] += blurred[_BY_SPILL, i, k] * jump[k]
                jacobian[_LENS, k] += blurred[_BY_LENS, i, k] * jump[k]
        for k in range(begin, end):
            jump[k] *= blurred[_SLOPE, i, k] * px_mm
        for p in range(changes):
            if alike[p]:
                for k in range(begin, end):
                    jacobian[p, k] -= moves[p, i] * jump[k]


@kernel
def _fill_jump(samples, begin, end, before, after, borders, level, jump):  # type: ignore[no-untyped-def]
    """How much brighter one interval is than that before it, at the positions where both mix."""
    gone, come = int(before[4]), int(after[4])
    even = level[come] - level[gone] + level[SKY] * (after[5] - before[5])
    slope = 0.0
    for region, sign in ((gone, -1.0), (come, 1.0)):
        if region == SKIN_A:
            even -= sign * level[SLOPE_A] * borders[0]
            slope += sign * level[SLOPE_A]
        elif region == SKIN_B:
            even -= sign * level[SLOPE_B] * borders[1]
            slope += sign * level[SLOPE_B]
    for k in range(begin, end):
        jump[k] = even + slope * samples[k]


@kernel
def _add_skins_and_sky(n, borders, changed, base, shown, found, spans, steps, basis, level, column):  # type: ignore[no-untyped-def]
    """Change of the picture as the skins' slopes begin elsewhere, and as the floor sees more of the sky or less."""
    at_a = (borders[0, 0] - borders[1, 0]) / _DIFFERENCE * level[SLOPE_A]
    at_b = (borders[0, 1] - borders[1, 1]) / _DIFFERENCE * level[SLOPE_B]
    for k in range(n):
        column[k] += at_a * basis[SKIN_A, k] + at_b * basis[SKIN_B, k]
    before = 0.0
    for i in range(found):
        sky = (changed[shown[i], 5] - base[shown[i], 5]) / _DIFFERENCE * level[SKY]
        more, before = sky - before, sky
        if more != 0.0:
            begin, end = (spans[i - 1, 0], spans[i - 1, 1]) if i else (0, 0)
            for k in range(begin, end):
                column[k] += more * steps[i - 1, k]
            for k in range(end, n):
                column[k] += more


@kernel
def _dot(a, i, b, j, n):  # type: ignore[no-untyped-def]
    """Sum of the first n products of two rows."""
    total = 0.0
    for k in range(n):
        total += a[i, k] * b[j, k]
    return total


@kernel
def _fit_levels(basis, n, grey, weight, usual, precision, weighted, inverse, level):  # type: ignore[no-untyped-def]
    """A station's levels by least squares; the inverse of the normal matrix, ΦᵀWΦ + P, stays in `inverse`."""
    normal, right = np.empty((LEVELS, LEVELS)), np.empty(LEVELS)
    for i in range(LEVELS):
        for k in range(n):
            weighted[i, k] = basis[i, k] * weight[k]
        right[i] = precision[i] * usual[i] + _dot(weighted, i, grey, 0, n)
        for j in range(i + 1):
            normal[i, j] = _dot(weighted, i, basis, j, n)
        normal[i, i] += precision[i]
    _invert(normal, inverse)
    level[:] = 0.0
    for i in range(LEVELS):
        for j in range(LEVELS):
            level[j] += inverse[i, j] * right[i]


@kernel
def _invert(matrix, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric matrix by its Cholesky factor, which takes the place of its lower half."""
    turned = np.zeros((LEVELS, LEVELS))  # the factor's inverse
    inverse[:] = 0.0
    for i in range(LEVELS):
        for j in range(i):
            matrix[i, j] = (matrix[i, j] - _dot(matrix, i, matrix, j, j)) * turned[j, j]
        turned[i, i] = 1.0 / math.sqrt(max(matrix[i, i] - _dot(matrix, i, matrix, i, i), 1e-300))
        for j in range(i):
            for k in range(j + 1):
                turned[i, k] -= matrix[i, j] * turned[j, k] * turned[i, i]
        for j in range(i + 1):
            for k in range(i + 1):
                inverse[j, k] += turned[i, j] * turned[i, k]


@kernel
def _add_view(basis, jacobian, residual, weight, n, pulls, inverse, rows, normal, gradient):  # type: ignore[no-untyped-def]
    """JᵀWJ less what the levels explain, and JᵀWr, of one station in one camera; column p belongs in rows[p].

    At the levels' optimum their own gradient vanishes. Returns JᵀWΦ (ΦᵀWΦ + P)⁻¹, with the basis Φ.
    """
    columns = rows.size
    cross, explained = np.empty((columns, LEVELS)), np.zeros((columns, LEVELS))
    for p in range(columns):
        for k in range(n):
            pulls[p, k] = jacobian[p, k] * weight[k]
        gradient[rows[p]] += _dot(pulls, p, residual, 0, n)
        for i in range(LEVELS):
            cross[p, i] = _dot(pulls, p, basis, i, n)
        for i in range(LEVELS):
            for j in range(LEVELS):
                explained[p, j] += cross[p, i] * inverse[i, j]
        for q in range(p + 1):
            own = _dot(pulls, p, jacobian, q, n) - _dot(explained, p, cross, q, LEVELS)
            normal[rows[p], rows[q]] += own
            if q < p:
                normal[rows[q], rows[p]] += own
    return explained


@kernel
def _add_usual_levels(  # type: ignore[no-untyped-def]
    precision, level, usual, inverse, explained, rows, first, normal, gradient
):
    """How the usual levels m enter through the prior P of a station's own: P − P (ΦᵀWΦ + P)⁻¹ P, and P (l − m)."""
    for i in range(LEVELS):
        gradient[first + i] += precision[i] * (level[i] - usual[i])
        for p in range(rows.size):
            normal[rows[p], first + i] += explained[p, i] * precision[i]
            normal[first + i, rows[p]] += explained[p, i] * precision[i]
        normal[first + i, first + i] += precision[i]
        for j in range(LEVELS):
            normal[first + j, first + i] -= precision[j] * inverse[j, i] * precision[i]

"""What a camera sees of a gap: skin, chamfers, walls and floor, lit or in shadow, hiding each other, and blurred.

The section of a gap is a polyline: skin A to C, chamfer to D, wall, floor, wall, G, chamfer, skin B (paper, Fig. 8).
Coordinates are x across from A to B and h above the reference curve, the mean of both skin lines. A ray from an eye
(a camera or the projector) through a point meets the reference curve at ``ξ = x + (x − x_eye) h / (h_eye − h)``.
Walking along the polyline from the eye's side, a piece is seen (or lit) where ξ goes beyond all that went before.

The brightness of a region (a chamfer, what is lit of the walls or of the floor, what lies in shadow) is uniform, that
of each skin linear; a floor, lit or not, darkens towards its walls as they hide the sky from it. So the image is linear
in the regions' levels: level k times a basis function, the region's visible intervals folded with the point spread
(`blur`).
"""

from __future__ import annotations

import math

import numpy as np

from metrology.jit import kernel

# Regions with a level of their own, the columns of the basis; each skin has a slope besides, and the floor what the sky
# gives it in the gap's middle.
(
    SKIN_A, SLOPE_A, CHAMFER_A, LIT_WALL, DARK_WALL, LIT_FLOOR, DARK_FLOOR, CHAMFER_B, SKIN_B, SLOPE_B, SKY, LEVELS,
) = range(12)  # fmt: skip
# Parameters of one station's outline: x of both borders C, the chamfers' widths, the floor's depth (mm), the walls'
# lean and the chamfers' slope (tangents).
A, B, CHAMFER_WIDTH_A, CHAMFER_WIDTH_B, DEPTH, LEAN, CHAMFER_SLOPE, OUTLINE = range(8)
# Tables of the blurred step: as it is, and with a little more lens and a little more spill.
NOMINAL, MORE_LENS, MORE_SPILL, TABLES = range(4)

_VERTICES = 8
# Of the polyline's pieces, this one.
_FLOOR = 3
# A floor's lit and its dark part are cut into so many pieces if its edges see less sky than its middle by this share.
_FLOOR_PARTS = 8
_EVEN = 0.02
# Most pieces of a polyline, and columns of each: x0, h0, x1, h1, region, change of the sky.
_PIECES, _COLUMNS = 32, 6
# The skins' pieces reach beyond every sample, mm.
_FAR_MM = 50.0
# Change by which the image's derivatives are taken: mm, tangent, px of lens or share of spill.
DIFFERENCE = 1e-4
# Nodes of the tables per pixel.
NODES_PER_PX = 24


@kernel
def _project(x, h, eye_x, eye_h):  # type: ignore[no-untyped-def]
    """ξ of a point."""
    return x + (x - eye_x) * h / (eye_h - h)


@kernel
def _outline(outline, sealed, tilt, x, h):  # type: ignore[no-untyped-def]
    """Vertices from A to B. Skin A lies ``tilt = (h, dh/dx)`` above the reference curve, skin B as far below it."""
    a, b, wide_a, wide_b, depth, lean, slope = outline
    x[0], h[0] = a - _FAR_MM, tilt[0] + tilt[1] * a
    x[1], h[1] = a, h[0]
    x[2], h[2] = a + wide_a + lean * slope * wide_a, h[1] - slope * wide_a
    x[6], h[6] = b, -tilt[0] - tilt[1] * b
    x[5], h[5] = b - wide_b + lean * slope * wide_b, h[6] - slope * wide_b
    x[7], h[7] = b + _FAR_MM, h[6]
    # Sealant joins both edges, or lies as deep below each; an open gap's floor is level.
    h[3] = h[2] - depth if sealed else min(-depth, h[2])
    h[4] = h[5] - depth if sealed else min(-depth, h[5])
    x[3], x[4] = x[2] + lean * (h[2] - h[3]), x[5] + lean * (h[5] - h[4])


@kernel
def _pieces(outline, sealed, tilt, lamp, x, h, pieces):  # type: ignore[no-untyped-def]
    """The polyline cut at the shadows' borders, from A to B: rows of `_COLUMNS`. Returns their number."""
    _outline(outline, sealed, tilt, x, h)
    regions = (SKIN_A, CHAMFER_A, LIT_WALL, LIT_FLOOR, LIT_WALL, CHAMFER_B, SKIN_B)
    # A step throws its shadow past the gap onto the lower skin.
    shaded = (DARK_FLOOR, DARK_FLOOR, DARK_WALL, DARK_FLOOR, DARK_WALL, DARK_FLOOR, DARK_FLOOR)
    from_b = lamp[0] > 0.5 * (x[1] + x[6])
    sign = -1.0 if from_b else 1.0
    extreme = -np.inf
    count = 0
    for k in range(_VERTICES - 1):
        i = _VERTICES - 2 - k if from_b else k
        near, far = (i + 1, i) if from_b else (i, i + 1)
        start = sign * _project(x[near], h[near], lamp[0], lamp[1])
        end = sign * _project(x[far], h[far], lamp[0], lamp[1])
        share = 1.0
        if end > extreme and end > start:
            share = min(max((extreme - start) / (end - start), 0.0), 1.0)
            extreme = end
        middle_x = x[near] + share * (x[far] - x[near])
        middle_h = h[near] + share * (h[far] - h[near])
        sky = 0.0
        if i == _FLOOR and not sealed:
            middle = _sky(x, h, 0.5 * (x[3] + x[4]))
            sky = middle if _sky(x, h, x[3]) < (1.0 - _EVEN) * middle else 0.0
        if share > 0.0:
            count = _add(pieces, count, x[near], h[near], middle_x, middle_h, shaded[i], from_b, sky, x, h)
        if share < 1.0:
            count = _add(pieces, count, middle_x, middle_h, x[far], h[far], regions[i], from_b, sky, x, h)
    if from_b:
        for i in range(count // 2):
            for column in range(_COLUMNS):
                swap = pieces[i, column]
                pieces[i, column] = pieces[count - 1 - i, column]
                pieces[count - 1 - i, column] = swap
    return count


@kernel
def _sky(x, h, at):  # type: ignore[no-untyped-def]
    """Share of the sky that a place on the floor sees: view factor of a long slot's opening, chamfers and all."""
    seen = 0.0
    for sign, first, second in ((-1.0, 1, 2), (1.0, 6, 5)):
        least = 1.0
        for vertex in (first, second):
            aside, rise = sign * (x[vertex] - at), h[vertex] - h[3]
            if rise > 0.0:
                least = min(least, max(aside, 0.0) / math.hypot(aside, rise))
        seen += 0.5 * least
    return seen


@kernel
def _add(pieces, count, x0, h0, x1, h1, region, backwards, sky, x, h):  # type: ignore[no-untyped-def]
    """Add a piece, an uneven floor (whose middle sees `sky`, else 0) in parts. Returns the pieces' number."""
    parts = _FLOOR_PARTS if sky > 0.0 else 1
    step_x, step_h = (x1 - x0) / parts, (h1 - h0) / parts
    for part in range(parts):
        row = pieces[count + part]
        row[0], row[1] = x0 + part * step_x, h0 + part * step_h
        row[2], row[3] = row[0] + step_x, row[1] + step_h
        if backwards:
            row[0], row[1], row[2], row[3] = row[2], row[3], row[0], row[1]
        row[4] = region
        row[5] = _sky(x, h, x0 + (part + 0.5) * step_x) / sky - 1.0 if sky > 0.0 else 0.0
    return count + parts


@kernel
def _visible(pieces, count, eye, middle, ends, shown):  # type: ignore[no-untyped-def]
    """Visible intervals in rising ξ: `ends` holds where each ends, `shown` which piece it is. Returns their number."""
    from_b = eye[0] > middle
    sign = -1.0 if from_b else 1.0
    extreme = -np.inf
    found = 0
    for k in range(count):
        i = count - 1 - k if from_b else k
        x, h = (pieces[i, 0], pieces[i, 1]) if from_b else (pieces[i, 2], pieces[i, 3])
        end = sign * _project(x, h, eye[0], eye[1])
        if end > extreme:
            ends[found], shown[found] = sign * end, i
            extreme = end
            found += 1
    if from_b:
        # Each interval so far is given by its lower end, in falling order.
        for i in range(found // 2):
            j = found - 1 - i
            ends[i], ends[j] = ends[j], ends[i]
            shown[i], shown[j] = shown[j], shown[i]
        for i in range(found - 1):
            ends[i] = ends[i + 1]
    return found


@kernel
def _step(table, px):  # type: ignore[no-untyped-def]
    """The blurred step, px beyond it, from its table of values and slopes."""
    values, slopes = table
    place = px * NODES_PER_PX + values.size // 2
    if place <= 0.0:
        return 0.0
    if place >= values.size - 1:
        return 1.0
    i = int(place)
    t, rise = place - i, values[i + 1] - values[i]
    # Cubic with the nodes' slopes (Hermite).
    bend, twist = slopes[i] / NODES_PER_PX - rise, slopes[i + 1] / NODES_PER_PX - rise
    return values[i] + t * (rise + (1.0 - t) * ((1.0 - t) * bend - t * twist))


@kernel
def _basis(samples, n, outline, sealed, tilt, eye, lamp, px_mm, table, work, basis):  # type: ignore[no-untyped-def]
    """Basis functions at n positions on the reference curve."""
    x, h, pieces, ends, shown = work
    count = _pieces(outline, sealed, tilt, lamp, x, h, pieces)
    found = _visible(pieces, count, eye, 0.5 * (outline[A] + outline[B]), ends, shown)
    a, b = _project(x[1], h[1], eye[0], eye[1]), _project(x[6], h[6], eye[0], eye[1])
    for s in range(n):
        for level in range(LEVELS):
            basis[s, level] = 0.0
        # From A to B: what has not ended before this sample.
        begun = 1.0
        for i in range(found):
            ended = _step(table, (samples[s] - ends[i]) * px_mm) if i < found - 1 else 0.0
            piece = pieces[shown[i]]
            basis[s, int(piece[4])] += begun - ended
            basis[s, SKY] += (begun - ended) * piece[5]
            begun = ended
        basis[s, SLOPE_A] = (samples[s] - a) * basis[s, SKIN_A]
        basis[s, SLOPE_B] = (samples[s] - b) * basis[s, SKIN_B]


@kernel
def _picture(samples, n, outline, sealed, tilt, eye, lamp, px_mm, table, work, level, picture):  # type: ignore[no-untyped-def]
    """The basis functions times their levels, which needs no basis."""
    x, h, pieces, ends, shown = work
    count = _pieces(outline, sealed, tilt, lamp, x, h, pieces)
    found = _visible(pieces, count, eye, 0.5 * (outline[A] + outline[B]), ends, shown)
    a, b = _project(x[1], h[1], eye[0], eye[1]), _project(x[6], h[6], eye[0], eye[1])
    for s in range(n):
        picture[s], begun = 0.0, 1.0
        for i in range(found):
            ended = _step(table, (samples[s] - ends[i]) * px_mm) if i < found - 1 else 0.0
            if begun != ended:
                piece = pieces[shown[i]]
                region = int(piece[4])
                brightness = level[region] + level[SKY] * piece[5]
                if region == SKIN_A:
                    brightness += level[SLOPE_A] * (samples[s] - a)
                elif region == SKIN_B:
                    brightness += level[SLOPE_B] * (samples[s] - b)
                picture[s] += (begun - ended) * brightness
                begun = ended


@kernel
def workspace():  # type: ignore[no-untyped-def]
    """What `_basis` and `_picture` write on."""
    pieces = np.empty((_PIECES, _COLUMNS))
    return np.empty(_VERTICES), np.empty(_VERTICES), pieces, np.empty(_PIECES + 1), np.empty(_PIECES + 1, np.int64)


@kernel
def normal_equations(  # type: ignore[no-untyped-def]
    samples, greys, variances, sizes, places, borders, shared, tables, sealed, tilts, eyes, lamps, px_mm, precisions,
    courses, with_shape, normals, gradients, levels, costs,
):  # fmt: skip
    """Least squares of many stations with each one's own levels eliminated.

    Of each station's parameters θ (its two borders; then, `with_shape`, what is shared: both chamfers, depth, lean, the
    chamfers' slope, the lean's change along the seam, spill, each camera's lens, and each camera's usual levels) JᵀWJ
    goes into `normals`, JᵀWr into `gradients`. A station's levels keep to the usual ones, plus their `courses`,
    with the `precisions`.
    """
    stations, cameras, most = samples.shape
    work = workspace()
    basis, changed = np.empty((most, LEVELS)), np.empty(most)
    columns = 10 if with_shape else 2
    jacobian, residual, picture = np.empty((most, columns)), np.empty(most), np.empty(most)
    inner, factor = np.empty((LEVELS, LEVELS)), np.empty((LEVELS, LEVELS))
    outline, rows = np.empty(OUTLINE), np.arange(columns)
    for s in range(stations):
        normals[s], gradients[s], costs[s] = 0.0, 0.0, 0.0
        outline[A], outline[B] = borders[s, 0], borders[s, 1]
        outline[CHAMFER_WIDTH_A:] = shared[:5]
        outline[LEAN] += places[s] * shared[5]
        for c in range(cameras):
            n = sizes[s, c]
            if n == 0:
                continue
            first = 7 + cameras + c * LEVELS
            usual = shared[first : first + LEVELS] + courses[s, c]
            level, variance = levels[s, c], variances[s, c]
            view = (sealed, tilts[s], eyes[s, c], lamps[s], px_mm[s, c])
            _basis(samples[s, c], n, outline, *view, tables[c, NOMINAL], work, basis)
            _fit_levels(basis, n, greys[s, c], variance, usual, precisions, inner, factor, level)
            for i in range(LEVELS):
                costs[s] += precisions[i] * (level[i] - usual[i]) ** 2
            for k in range(n):
                picture[k] = 0.0
                for i in range(LEVELS):
                    picture[k] += level[i] * basis[k, i]
                residual[k] = greys[s, c, k] - picture[k]
                costs[s] += residual[k] ** 2 / variance[k]
            for p in range(min(columns, OUTLINE)):
                kept = outline[p]
                outline[p] = kept + DIFFERENCE
                _picture(samples[s, c], n, outline, *view, tables[c, NOMINAL], work, level, changed)
                outline[p] = kept
                for k in range(n):
                    jacobian[k, p] = (changed[k] - picture[k]) / DIFFERENCE
            if with_shape:
                jacobian[:n, 7] = places[s] * jacobian[:n, LEAN]
                for p, table in ((8, MORE_SPILL), (9, MORE_LENS)):
                    _picture(samples[s, c], n, outline, *view, tables[c, table], work, level, changed)
                    for k in range(n):
                        jacobian[k, p] = (changed[k] - picture[k]) / DIFFERENCE
                rows[9] = 9 + c
            explained = _add_view(basis, jacobian, residual, variance, n, factor, rows, normals[s], gradients[s])
            if with_shape:
                at = 2 + first
                _add_usual_levels(precisions, level, usual, factor, explained, rows, at, normals[s], gradients[s])


@kernel
def _fit_levels(basis, n, grey, variance, usual, precision, inner, factor, level):  # type: ignore[no-untyped-def]
    """A station's levels by least squares; the Cholesky factor of the normal matrix stays in `factor`."""
    for i in range(LEVELS):
        level[i] = precision[i] * usual[i]
        for j in range(LEVELS):
            inner[i, j] = precision[i] if i == j else 0.0
    for k in range(n):
        weight = 1.0 / variance[k]
        for i in range(LEVELS):
            if basis[k, i] != 0.0:
                level[i] += weight * basis[k, i] * grey[k]
                for j in range(i + 1):
                    inner[i, j] += weight * basis[k, i] * basis[k, j]
    for i in range(LEVELS):
        for j in range(i + 1):
            total = inner[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            factor[i, j] = math.sqrt(max(total, 1e-300)) if i == j else total / factor[j, j]
    _solve(factor, level)


@kernel
def _add_view(basis, jacobian, residual, variance, n, factor, rows, normal, gradient):  # type: ignore[no-untyped-def]
    """JᵀWJ less what the levels explain, and JᵀWr, of one station in one camera; column p belongs in rows[p].

    At the levels' optimum their own gradient vanishes. Returns JᵀWΦ (ΦᵀWΦ + P)⁻¹, with the basis Φ.
    """
    columns = rows.size
    cross, explained = np.zeros((columns, LEVELS)), np.empty((columns, LEVELS))
    for k in range(n):
        weight = 1.0 / variance[k]
        for p in range(columns):
            weighted = weight * jacobian[k, p]
            gradient[rows[p]] += weighted * residual[k]
            for q in range(columns):
                normal[rows[p], rows[q]] += weighted * jacobian[k, q]
            for i in range(LEVELS):
                cross[p, i] += weighted * basis[k, i]
    for p in range(columns):
        explained[p] = cross[p]
        _solve(factor, explained[p])
        for q in range(columns):
            total = 0.0
            for i in range(LEVELS):
                total += explained[p, i] * cross[q, i]
            normal[rows[p], rows[q]] -= total
    return explained


@kernel
def _add_usual_levels(  # type: ignore[no-untyped-def]
    precision, level, usual, factor, explained, rows, first, normal, gradient
):
    """How the usual levels m enter through the prior P of a station's own: P − P (ΦᵀWΦ + P)⁻¹ P, and P (l − m)."""
    column = np.empty(LEVELS)
    for i in range(LEVELS):
        gradient[first + i] += precision[i] * (level[i] - usual[i])
        for p in range(rows.size):
            normal[rows[p], first + i] += explained[p, i] * precision[i]
            normal[first + i, rows[p]] += explained[p, i] * precision[i]
        column[:] = 0.0
        column[i] = precision[i]
        _solve(factor, column)
        normal[first + i, first + i] += precision[i]
        for j in range(LEVELS):
            normal[first + j, first + i] -= precision[j] * column[j]


@kernel
def _solve(factor, right):  # type: ignore[no-untyped-def]
    """Solve with a Cholesky factor, in place."""
    size = right.size
    for i in range(size):
        for k in range(i):
            right[i] -= factor[i, k] * right[k]
        right[i] /= factor[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= factor[k, i] * right[k]
        right[i] /= factor[i, i]

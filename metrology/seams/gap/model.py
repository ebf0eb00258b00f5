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

VERTICES = 8
# Of the polyline's pieces, this one.
_FLOOR = 3
# A floor's lit and its dark part are cut into so many pieces if its edges see less sky than its middle by this share.
_FLOOR_PARTS = 8
_EVEN = 0.02
# Most pieces of a polyline, and columns of each: x0, h0, x1, h1, region, change of the sky.
PIECES, COLUMNS = 32, 6
# The skins' pieces reach beyond every sample, mm.
_FAR_MM = 50.0
# Nodes of the blurred step's table per pixel.
NODES_PER_PX = 24


@kernel
def project(x, h, eye_x, eye_h):  # type: ignore[no-untyped-def]
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
def cut(outline, sealed, tilt, lamp, x, h, pieces):  # type: ignore[no-untyped-def]
    """The polyline cut at the shadows' borders, from A to B: rows of `COLUMNS`. Returns their number."""
    _outline(outline, sealed, tilt, x, h)
    regions = (SKIN_A, CHAMFER_A, LIT_WALL, LIT_FLOOR, LIT_WALL, CHAMFER_B, SKIN_B)
    # A step throws its shadow past the gap onto the lower skin.
    shaded = (DARK_FLOOR, DARK_FLOOR, DARK_WALL, DARK_FLOOR, DARK_WALL, DARK_FLOOR, DARK_FLOOR)
    from_b = lamp[0] > 0.5 * (x[1] + x[6])
    sign = -1.0 if from_b else 1.0
    extreme = -np.inf
    count = 0
    for k in range(VERTICES - 1):
        i = VERTICES - 2 - k if from_b else k
        near, far = (i + 1, i) if from_b else (i, i + 1)
        start = sign * project(x[near], h[near], lamp[0], lamp[1])
        end = sign * project(x[far], h[far], lamp[0], lamp[1])
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
            for column in range(COLUMNS):
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
                least = min(least, max(aside, 0.0) / math.sqrt(aside * aside + rise * rise))
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
def visible(pieces, count, eye, middle, ends, shown):  # type: ignore[no-untyped-def]
    """Visible intervals in rising ξ: `ends` holds where each ends, `shown` which piece it is. Returns their number."""
    from_b = eye[0] > middle
    sign = -1.0 if from_b else 1.0
    extreme = -np.inf
    found = 0
    for k in range(count):
        i = count - 1 - k if from_b else k
        x, h = (pieces[i, 0], pieces[i, 1]) if from_b else (pieces[i, 2], pieces[i, 3])
        end = sign * project(x, h, eye[0], eye[1])
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
def steps_at(samples, n, ends, edges, px_mm, table, spans, blurred):  # type: ignore[no-untyped-def]
    """The blurred step that begins at each of the `edges` first `ends`, at n rising positions.

    Row [kind, i] of `blurred` gets the step, its slope per px, and its change with the spill and with the lens, as many
    of these as it has room for, at the positions spans[i, 0] to spans[i, 1]: before them nothing of the step has come,
    beyond them all of it has.
    """
    last, rate = table.shape[1] - 1, px_mm * NODES_PER_PX
    begin = end = 0
    for i in range(edges):
        offset = last // 2 - ends[i] * rate
        while begin < n and samples[begin] * rate + offset <= 0.0:
            begin += 1
        end = max(begin, end)
        while end < n and samples[end] * rate + offset < last:
            end += 1
        spans[i, 0], spans[i, 1] = begin, end
        for s in range(begin, end):
            place = samples[s] * rate + offset
            k = min(int(place), last - 1)
            t = place - k
            blurred[0, i, s] = _between(table, 0, k, t)
            if blurred.shape[0] > 1:
                rise = table[0, k + 1] - table[0, k]
                bend, twist = table[1, k] / NODES_PER_PX - rise, table[1, k + 1] / NODES_PER_PX - rise
                more = (1.0 - t) * (1.0 - 3.0 * t) * bend - t * (2.0 - 3.0 * t) * twist
                blurred[1, i, s] = NODES_PER_PX * (rise + more)
            for kind in range(2, blurred.shape[0]):
                blurred[kind, i, s] = _between(table, 2 * kind - 2, k, t)


@kernel
def _between(table, row, k, t):  # type: ignore[no-untyped-def]
    """A table's row between nodes k and k + 1: cubic with the nodes' slopes, which are its next row (Hermite)."""
    value, rise = table[row, k], table[row, k + 1] - table[row, k]
    bend, twist = table[row + 1, k] / NODES_PER_PX - rise, table[row + 1, k + 1] / NODES_PER_PX - rise
    return value + t * (rise + (1.0 - t) * ((1.0 - t) * bend - t * twist))


@kernel
def basis_at(samples, n, pieces, shown, found, borders, spans, steps, basis):  # type: ignore[no-untyped-def]
    """Basis functions, (LEVELS, n), at n positions on the reference curve, from the steps between visible intervals.

    `borders` are ξ of C on both skins, from where the skins' slopes count.
    """
    first = pieces[shown[0]]
    for s in range(n):
        for level in range(LEVELS):
            basis[level, s] = 0.0
        basis[int(first[4]), s], basis[SKY, s] = 1.0, first[5]
    for i in range(found - 1):
        before, after = pieces[shown[i]], pieces[shown[i + 1]]
        gone, come, sky = int(before[4]), int(after[4]), after[5] - before[5]
        for s in range(spans[i, 0], spans[i, 1]):
            basis[gone, s] -= steps[i, s]
            basis[come, s] += steps[i, s]
            basis[SKY, s] += sky * steps[i, s]
        for s in range(spans[i, 1], n):
            basis[gone, s] -= 1.0
            basis[come, s] += 1.0
            basis[SKY, s] += sky
    for s in range(n):
        basis[SLOPE_A, s] = (samples[s] - borders[0]) * basis[SKIN_A, s]
        basis[SLOPE_B, s] = (samples[s] - borders[1]) * basis[SKIN_B, s]

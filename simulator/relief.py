"""The panel as the ray caster sees it: a height field of smooth pieces with vertical walls between them.

Panel frame, millimetres: x and y across the skin, z its outward normal at the origin. Every piece (a plate of skin, a
rivet head, the floor of a gap …) is a smooth z(x, y); which piece lies at a place is decided in the x-y plane alone.
A ray that crosses a border between two pieces below the upper one has therefore met a wall.

Kernels only: `simulator.pack` fills the arrays from the panel's dataclasses.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.compiled import kernel
from simulator.overlay import coat_height, dent_drop

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# What a piece is.
PLATE, FLOOR, HEAD, RING, FILLED_RING, SLOT, BACKGROUND, HOLE, CABLE, CONE, BEAD = range(11)

# Entries of Relief.frame: curvatures (1/mm, + convex), cos and sin of the direction of the first, waviness amplitude
# (mm), its wave numbers (rad/mm) and phase; the panel's limits and the height of the background behind it; the corner
# of the first cell; the most that anything stands above the skin and lies below it.
(
    F_K1, F_K2, F_COS, F_SIN, F_WAVE, F_WAVE_X, F_WAVE_Y, F_PHASE,
    F_X_MIN, F_X_MAX, F_Y_MIN, F_Y_MAX, F_BACKGROUND, F_ORIGIN_X, F_ORIGIN_Y, F_ABOVE, F_BELOW, F_SIZE,
) = range(18)  # fmt: skip

# Columns of Relief.rivets; from R_SIZE on start and end (rad) of the ring's open arcs, NaN where unused. A countersunk
# hole's R_RADIUS is its bore's, R_CONE the depth of its cone per mm across; R_RECESS is the shape of a head's recess.
(
    R_HEAD_X, R_HEAD_Y, R_HEAD_Z, R_HEAD_GX, R_HEAD_GY, R_RADIUS, R_DOME,
    R_RING_X, R_RING_Y, R_RING_GX, R_RING_GY, R_OUTER, R_RING_DEPTH,
    R_SLOT_COS, R_SLOT_SIN, R_SLOT_LENGTH, R_SLOT_WIDTH, R_SLOT_DEPTH, R_SLOT_CROSS, R_IS_HOLE,
    R_HEAD_REFLECTANCE, R_RING_REFLECTANCE, R_CONE, R_RECESS, R_SIZE,
) = range(25)  # fmt: skip

WINGS, TORQ_SET, HEXAGON = range(3)
HEX_COS, HEX_SIN = 0.5, math.sqrt(0.75)

# Columns of Relief.seams. S_CABLE: 1 for a cable, 2 for a bead of sealant; S_ROUND: broken edges are rounded. S_BOUNDS:
# twice another seam's index (−1: none) and the side (0 or 1) of it on which this seam exists. From S_SIZE on the tables
# of COURSE, WIDTH and STEP: of each k pieces the k breaks and the 4 k coefficients.
(
    S_X, S_Y, S_EX, S_EY, S_CHAMFER, S_SLOPE, S_DEPTH, S_FILLED, S_CABLE,
    S_FLOOR_REFLECTANCE, S_EDGE_REFLECTANCE, S_LAP, S_ROUND, S_BOUNDS,
) = range(14)  # fmt: skip
S_SIZE = S_BOUNDS + 4
COURSE, WIDTH, STEP = range(3)


class Relief(NamedTuple):
    """A panel packed into few arrays (a kernel's call copies the description of each)."""

    frame: Floats
    """(F_SIZE,) float64."""
    rivets: Floats
    """(n, R_SIZE + 2 arcs) float64."""
    seams: Floats
    """(m, S_SIZE + 15 pieces) float64."""
    cells: NDArray[np.int32]
    """(rows, columns, k) int32: for each cell of 1 mm the indices of the rivets near it, −1 where none; last, whether a
    seam is near (0 or 1)."""
    dents: Floats
    """(d, D_SIZE) float64: dents and scratches (`simulator.overlay`); they belong to the plates."""
    coat: NDArray[np.float32]
    """(rows, columns) float32: thickness of what is painted or stuck on the plates, mm; (0, 0) where nothing is."""


@kernel
def skin_height(frame: Floats, x: float, y: float) -> float:
    """Height of the undisturbed skin: a torus with the two radii (sphere, cylinder and plane are its special cases).

    The profile along b is a circular arc of curvature k2, f(b) = −k2 b² / (1 + √(1 − k2² b²)); across it, along a, an
    arc about the torus's axis, whose radius is 1/k1 + f(b). Written so that a curvature of zero is exact.
    """
    a = frame[F_COS] * x + frame[F_SIN] * y
    b = -frame[F_SIN] * x + frame[F_COS] * y
    k1, k2 = frame[F_K1], frame[F_K2]
    f = -k2 * b * b / (1.0 + math.sqrt(max(1.0 - k2 * k2 * b * b, 0.0)))
    k = k1 / (1.0 + k1 * f)
    z = f - k * a * a / (1.0 + math.sqrt(max(1.0 - k * k * a * a, 0.0)))
    if frame[F_WAVE] != 0.0:
        z += frame[F_WAVE] * math.sin(frame[F_WAVE_X] * x + frame[F_WAVE_Y] * y + frame[F_PHASE])
    return z


@kernel
def table(relief: Relief, seam: int, which: int, xi: float) -> tuple[float, float]:
    """Value and slope of a seam's piecewise cubic (COURSE, WIDTH or STEP) at the distance xi along its chord."""
    seams = relief.seams
    pieces = (seams.shape[1] - S_SIZE) // 15
    breaks = S_SIZE + 5 * pieces * which
    i = 0
    while i < pieces - 1 and xi >= seams[seam, breaks + i + 1]:
        i += 1
    u, c = xi - seams[seam, breaks + i], breaks + pieces + 4 * i
    c0, c1, c2, c3 = seams[seam, c], seams[seam, c + 1], seams[seam, c + 2], seams[seam, c + 3]
    return ((c0 * u + c1) * u + c2) * u + c3, (3.0 * c0 * u + 2.0 * c1) * u + c2


@kernel
def lateral(relief: Relief, seam: int, x: float, y: float) -> tuple[float, float]:
    """Signed distance from a seam's centre line (+ to the left of its course) and distance along its chord, mm."""
    ex, ey = relief.seams[seam, S_EX], relief.seams[seam, S_EY]
    dx, dy = x - relief.seams[seam, S_X], y - relief.seams[seam, S_Y]
    xi, eta = dx * ex + dy * ey, -dx * ey + dy * ex
    centre, slope = table(relief, seam, COURSE, xi)
    if slope == 0.0:
        return eta - centre, xi
    return (eta - centre) / math.sqrt(1.0 + slope * slope), xi


@kernel
def along(relief: Relief, seam: int, x: float, y: float) -> float:
    """Distance along a seam's chord, mm."""
    dx, dy = x - relief.seams[seam, S_X], y - relief.seams[seam, S_Y]
    return dx * relief.seams[seam, S_EX] + dy * relief.seams[seam, S_EY]


@kernel
def sides_of(relief: Relief, x: float, y: float) -> int:
    """Bit s is set where (x, y) lies to the left of seam s."""
    sides = 0
    for s in range(relief.seams.shape[0]):
        if lateral(relief, s, x, y)[0] > 0.0:
            sides |= 1 << s
    return sides


@kernel
def exists(relief: Relief, seam: int, sides: int) -> bool:
    """Whether a seam exists in the region that `sides` names: one that ends at another does so on one side only."""
    for k in range(2):
        other = int(relief.seams[seam, S_BOUNDS + 2 * k])
        if other >= 0 and ((sides >> other) & 1) != int(relief.seams[seam, S_BOUNDS + 2 * k + 1]):
            return False
    return True


@kernel
def plate_height(relief: Relief, x: float, y: float, sides: int, without: int) -> float:
    """Height of a plate of skin, its edges not broken; the seam `without` (−1: none) adds no step."""
    z = skin_height(relief.frame, x, y)
    for s in range(relief.seams.shape[0]):
        if s != without and relief.seams[s, S_CABLE] == 0.0 and exists(relief, s, sides):
            half = 0.5 * table(relief, s, STEP, along(relief, s, x, y))[0]
            z += half if (sides >> s) & 1 else -half
    for k in range(relief.dents.shape[0]):
        z -= dent_drop(relief.dents, k, x, y)
    return z


@kernel
def coat_at(relief: Relief, x: float, y: float) -> float:
    """Thickness of what is painted or stuck on the plates at (x, y), mm."""
    return coat_height(relief.coat, relief.frame[F_X_MIN], relief.frame[F_Y_MIN], x, y)


@kernel
def broken(relief: Relief, seam: int, t: float, xi: float) -> bool:
    """Whether a seam's edge is broken on the side of t: a lap's is on its higher side only."""
    if relief.seams[seam, S_LAP] == 0.0:
        return True
    return (t > 0.0) == (table(relief, seam, STEP, xi)[0] > 0.0)


@kernel
def chamfer_cut(relief: Relief, x: float, y: float, sides: int) -> float:
    """How far the chamfers of the seams lie below the plate, mm."""
    cut = 0.0
    for s in range(relief.seams.shape[0]):
        chamfer = relief.seams[s, S_CHAMFER]
        if chamfer > 0.0 and exists(relief, s, sides):
            t, xi = lateral(relief, s, x, y)
            rest = 0.5 * table(relief, s, WIDTH, xi)[0] + chamfer - abs(t)
            if rest > 0.0 and broken(relief, s, t, xi):
                rest = min(rest, chamfer)
                if relief.seams[s, S_ROUND] > 0.0:
                    cut = max(cut, chamfer - math.sqrt(max(chamfer * chamfer - rest * rest, 0.0)))
                else:
                    cut = max(cut, rest * relief.seams[s, S_SLOPE])
    return cut


@kernel
def circle(rivet: Floats, head: bool, x: float, y: float) -> float:
    """Square of the distance from the axis of a head (or of its ring), measured in its own inclined plane, mm²."""
    if head:
        dx, dy = x - rivet[R_HEAD_X], y - rivet[R_HEAD_Y]
        rise = rivet[R_HEAD_GX] * dx + rivet[R_HEAD_GY] * dy
    else:
        dx, dy = x - rivet[R_RING_X], y - rivet[R_RING_Y]
        rise = rivet[R_RING_GX] * dx + rivet[R_RING_GY] * dy
    return dx * dx + dy * dy + rise * rise


@kernel
def _in_slot(rivet: Floats, x: float, y: float) -> bool:
    if rivet[R_SLOT_WIDTH] <= 0.0:
        return False
    dx, dy = x - rivet[R_HEAD_X], y - rivet[R_HEAD_Y]
    a = rivet[R_SLOT_COS] * dx + rivet[R_SLOT_SIN] * dy
    b = -rivet[R_SLOT_SIN] * dx + rivet[R_SLOT_COS] * dy
    length, width = 0.5 * rivet[R_SLOT_LENGTH], 0.5 * rivet[R_SLOT_WIDTH]
    if rivet[R_RECESS] == TORQ_SET:
        width *= 2.0
        if (0.0 <= a < length and 0.0 <= b < width) or (-length < a <= 0.0 and -width < b <= 0.0):
            return True
        return (-width < a <= 0.0 and 0.0 <= b < length) or (0.0 <= a < width and -length < b <= 0.0)
    a, b = abs(a), abs(b)
    if rivet[R_RECESS] == HEXAGON:
        return a < length and HEX_COS * a + HEX_SIN * b < length
    if a < length and b < width:
        return True
    return rivet[R_SLOT_CROSS] > 0.0 and b < length and a < width


@kernel
def _in_open_arc(relief: Relief, r: int, x: float, y: float) -> bool:
    angle = math.atan2(y - relief.rivets[r, R_RING_Y], x - relief.rivets[r, R_RING_X])
    for k in range(R_SIZE, relief.rivets.shape[1], 2):
        start, end = relief.rivets[r, k], relief.rivets[r, k + 1]
        if math.isnan(start):
            break
        if (angle - start) % (2.0 * math.pi) < end - start:
            return True
    return False


@kernel
def piece_at(relief: Relief, row: int, column: int, x: float, y: float) -> tuple[int, int, int]:
    """Which piece lies at (x, y): its kind, the rivet or seam it belongs to, and the sides of all seams.

    `row`, `column` are the cell whose rivets come into question (row −1: none do).
    """
    frame = relief.frame
    if x < frame[F_X_MIN] or x > frame[F_X_MAX] or y < frame[F_Y_MIN] or y > frame[F_Y_MAX]:
        return BACKGROUND, 0, 0
    sides, grooves, bead = 0, 0, -1
    for s in range(relief.seams.shape[0]):
        t, xi = lateral(relief, s, x, y)
        if t > 0.0:
            sides |= 1 << s
        if abs(t) < 0.5 * table(relief, s, WIDTH, xi)[0]:
            grooves |= 1 << s
            if relief.seams[s, S_CABLE] == 2.0:
                bead = s
    if bead >= 0:
        return BEAD, bead, sides
    if row >= 0:
        for k in range(relief.cells.shape[2] - 1):
            r = relief.cells[row, column, k]
            if r < 0:
                break
            rivet = relief.rivets[r]
            outer = circle(rivet, False, x, y) < rivet[R_OUTER] ** 2
            if rivet[R_IS_HOLE] > 0.0:
                if outer:
                    bore = rivet[R_CONE] == 0.0 or circle(rivet, False, x, y) < rivet[R_RADIUS] ** 2
                    return (HOLE if bore else CONE), r, sides
                continue
            if circle(rivet, True, x, y) < rivet[R_RADIUS] ** 2:
                return (SLOT if _in_slot(rivet, x, y) else HEAD), r, sides
            if outer:
                return (RING if _in_open_arc(relief, r, x, y) else FILLED_RING), r, sides
    kind, deepest = PLATE, 0
    for s in range(relief.seams.shape[0]):
        if (grooves >> s) & 1 and exists(relief, s, sides):
            if relief.seams[s, S_CABLE] > 0.0:
                return CABLE, s, sides
            if kind == PLATE or relief.seams[s, S_DEPTH] > relief.seams[deepest, S_DEPTH]:
                kind, deepest = FLOOR, s
    return kind, deepest, sides


@kernel
def _bead_height(relief: Relief, bead: int, x: float, y: float) -> float:
    """A bead's surface: from the plates on one side of each seam to those on the other over its width, and a bulge."""
    t, xi = lateral(relief, bead, x, y)
    half = 0.5 * table(relief, bead, WIDTH, xi)[0]
    z = skin_height(relief.frame, x, y) + relief.seams[bead, S_DEPTH] * (1.0 - (t / half) ** 2)
    for s in range(relief.seams.shape[0]):
        if relief.seams[s, S_CABLE] == 0.0:
            across, at = lateral(relief, s, x, y)
            z += 0.5 * table(relief, s, STEP, at)[0] * min(max(across / half, -1.0), 1.0)
    for k in range(relief.dents.shape[0]):
        z -= dent_drop(relief.dents, k, x, y)
    return z


@kernel
def _head_plane(rivet: Floats, x: float, y: float) -> float:
    rise = rivet[R_HEAD_GX] * (x - rivet[R_HEAD_X]) + rivet[R_HEAD_GY] * (y - rivet[R_HEAD_Y])
    return float(rivet[R_HEAD_Z] + rise)


@kernel
def piece_height(relief: Relief, kind: int, index: int, sides: int, x: float, y: float) -> float:
    """Height of one piece's smooth surface at (x, y), also beyond its own borders."""
    if kind == BACKGROUND:
        return relief.frame[F_BACKGROUND]
    if kind == PLATE:
        return plate_height(relief, x, y, sides, -1) - chamfer_cut(relief, x, y, sides) + coat_at(relief, x, y)
    if kind == FLOOR:
        z = plate_height(relief, x, y, sides, index) - relief.seams[index, S_DEPTH]
        if relief.seams[index, S_FILLED] > 0.0:
            t, xi = lateral(relief, index, x, y)
            z += table(relief, index, STEP, xi)[0] * t / table(relief, index, WIDTH, xi)[0]
        return z
    if kind == CABLE:
        t, xi = lateral(relief, index, x, y)
        half = 0.5 * table(relief, index, WIDTH, xi)[0]
        return plate_height(relief, x, y, sides, -1) + math.sqrt(max(half * half - t * t, 0.0))
    if kind == BEAD:
        return _bead_height(relief, index, x, y)
    rivet = relief.rivets[index]
    if kind == HEAD:
        gx, gy = rivet[R_HEAD_GX], rivet[R_HEAD_GY]
        crown = rivet[R_DOME] * (1.0 - circle(rivet, True, x, y) / rivet[R_RADIUS] ** 2)
        return _head_plane(rivet, x, y) + crown * math.sqrt(1.0 + gx * gx + gy * gy)
    if kind == SLOT:
        return _head_plane(rivet, x, y) - rivet[R_SLOT_DEPTH]
    plate = plate_height(relief, x, y, sides, -1)
    if kind == FILLED_RING:
        inner = max(math.sqrt(circle(rivet, True, x, y)) - rivet[R_RADIUS], 0.0)
        outer = max(rivet[R_OUTER] - math.sqrt(circle(rivet, False, x, y)), 0.0)
        share = inner / max(inner + outer, 1e-12)
        return (1.0 - share) * _head_plane(rivet, x, y) + share * plate
    if kind == CONE:
        return plate - (rivet[R_OUTER] - math.sqrt(circle(rivet, False, x, y))) * rivet[R_CONE]
    return plate - rivet[R_RING_DEPTH]


@kernel
def cell_of(relief: Relief, x: float, y: float) -> tuple[int, int]:
    """Row and column of the cell of (x, y); (−1, −1) outside or where no rivet and no seam is near."""
    column = math.floor(x - relief.frame[F_ORIGIN_X])
    row = math.floor(y - relief.frame[F_ORIGIN_Y])
    if row < 0 or column < 0 or row >= relief.cells.shape[0] or column >= relief.cells.shape[1]:
        return -1, -1
    if relief.cells[row, column, 0] < 0 and relief.cells[row, column, -1] == 0:
        return -1, -1
    return row, column


@kernel
def beside_border(relief: Relief, x: float, y: float) -> bool:
    """Whether a ray that meets the skin at (x, y) may pass the panel's border."""
    frame = relief.frame
    margin = frame[F_ABOVE] + frame[F_BELOW] + 1.0
    inner_x = x > frame[F_X_MIN] + margin and x < frame[F_X_MAX] - margin
    return not (inner_x and y > frame[F_Y_MIN] + margin and y < frame[F_Y_MAX] - margin)

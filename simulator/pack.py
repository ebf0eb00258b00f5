"""From a panel's dataclasses to the arrays of `simulator.relief`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PchipInterpolator, PPoly

from metrology.arrays import Mask
from metrology.errors import SpecError
from simulator import relief as r
from simulator.clutter import Bead, Cable, Cleco, Speck
from simulator.pack_defects import no_dents, pack_dents
from simulator.paint import coat
from simulator.panel import Hole, Panel, Rivet, Seam
from simulator.relief import Floats, Relief
from simulator.survey import sides_at, survey

Line = Seam | Cable | Bead
Round = Rivet | Hole | Cleco | Speck

CORNER_MM = 4.0  # half length over which a polyline's corners are rounded
_STEEPEST = 1.0  # tangent of the steepest angle against the panel's normal at which a ray may come in


def pack(panel: Panel) -> Relief:
    """The panel as arrays.

    Rivets rest on the skin with its steps, so the seams are packed first.
    """
    lines: list[Line] = [*panel.seams, *panel.cables, *panel.beads]
    seams = np.array([_line(line) for line in lines]).reshape(-1, r.S_SIZE)
    bare = Relief(_frame(panel), np.zeros((0, r.R_SIZE)), np.hstack([seams, _tables(lines)]), _cells((1, 1), [], None),
                  no_dents(), coat(panel))  # fmt: skip
    _bind(panel, bare)
    bare = bare._replace(dents=pack_dents(panel, bare))
    # The first that lies at a place is seen there: specks and clecos stand above rivets and holes.
    items: list[Round] = [*panel.specks, *panel.clecos, *panel.rivets, *panel.holes]
    rows = [(item, row) for item in items for row in _rows(item, bare)]
    rivets = np.array([row for _, row in rows]).reshape(-1, r.R_SIZE)
    tall = [(c.height_mm + c.plunger_height_mm if isinstance(c, Cleco) else 0.0) for c, _ in rows]
    return _with_cells(bare._replace(rivets=np.hstack([rivets, _arcs([item for item, _ in rows])])), tall)


def _rows(item: Round, bare: Relief) -> list[Floats]:
    if isinstance(item, Rivet):
        return [_rivet(item, bare)]
    if isinstance(item, Hole):
        return [_hole(item, bare)]
    if isinstance(item, Cleco):
        return _cleco(item, bare)
    return [_lying(item, bare)]


def _frame(panel: Panel) -> Floats:
    skin = panel.skin
    direction, wave = math.radians(skin.direction_deg), math.radians(skin.wave_direction_deg)
    number = 2 * math.pi / skin.wavelength_mm
    x, y = panel.width_mm / 2, panel.height_mm / 2
    return np.array([
        1 / skin.radius_1_mm, 1 / skin.radius_2_mm, math.cos(direction), math.sin(direction), skin.waviness_mm,
        number * math.cos(wave), number * math.sin(wave), math.radians(skin.wave_phase_deg),
        -x, x, -y, y, -panel.background_mm, -x - 1.0, -y - 1.0, *_reach(panel),
    ])  # fmt: skip


def _line(line: Line) -> Floats:
    start, end = np.array(line.points_mm[0]), np.array(line.points_mm[-1])
    along = (end - start) / np.linalg.norm(end - start)
    row = np.zeros(r.S_SIZE)
    row[[r.S_BOUNDS, r.S_BOUNDS + 2]] = -1.0
    row[[r.S_X, r.S_Y, r.S_EX, r.S_EY]] = [*start, *along]
    if isinstance(line, Cable):
        row[[r.S_CABLE, r.S_FLOOR_REFLECTANCE, r.S_FILLED]] = 1.0, line.reflectance, 1.0
        return row
    if isinstance(line, Bead):
        row[[r.S_CABLE, r.S_FLOOR_REFLECTANCE, r.S_DEPTH]] = 2.0, line.reflectance, line.height_mm
        return row
    row[r.S_CHAMFER], row[r.S_SLOPE] = line.chamfer_mm, math.tan(math.radians(line.chamfer_deg))
    if line.edge_radius_mm:
        row[[r.S_CHAMFER, r.S_SLOPE, r.S_ROUND]] = line.edge_radius_mm, 1.0, 1.0
    row[r.S_LAP] = float(line.joint == "lap")
    row[r.S_DEPTH], row[r.S_FILLED] = line.depth_mm, float(line.filled)
    row[r.S_FLOOR_REFLECTANCE], row[r.S_EDGE_REFLECTANCE] = line.floor_reflectance, line.edge_reflectance
    return row


def _chord_coordinates(line: Line) -> Floats:
    """(n, 2) the course's points along the chord and to its left."""
    points = np.array(line.points_mm, float)
    along = points[-1] - points[0]
    along /= np.linalg.norm(along)
    d = points - points[0]
    return np.stack([d @ along, d @ np.array([-along[1], along[0]])], axis=1)


def course(line: Line) -> PPoly:
    """The centre line: offset to the left of the chord over the distance along it, straight beyond both ends."""
    xi, eta = _chord_coordinates(line).T
    if len(xi) == 2:
        return PPoly(np.zeros((4, 1)), np.array([0.0, xi[1]]))
    if not isinstance(line, Seam) or line.course == "smooth":
        return _extended(CubicSpline(xi, eta, bc_type="natural" if len(xi) > 3 else "not-a-knot"))
    return _rounded(xi, eta)


def _rounded(xi: Floats, eta: Floats) -> PPoly:
    """Straight pieces joined by parabolas of half length CORNER_MM about each corner."""
    if np.diff(xi).min() <= 2 * CORNER_MM:
        raise SpecError(
            f"points_mm: found corners {np.diff(xi).min():.1f} mm apart, expected over {2 * CORNER_MM:g} mm"
        )
    slopes = np.diff(eta) / np.diff(xi)
    breaks, pieces = [xi[0]], []
    for k, slope in enumerate(slopes):
        u = breaks[-1] - xi[k]
        pieces.append([0.0, 0.0, slope, eta[k] + slope * u])
        if k + 1 < len(slopes):
            bend = (slopes[k + 1] - slope) / (4 * CORNER_MM)
            breaks.append(xi[k + 1] - CORNER_MM)
            pieces.append([0.0, bend, slope, eta[k + 1] - slope * CORNER_MM])
            breaks.append(xi[k + 1] + CORNER_MM)
    return PPoly(np.array(pieces).T, np.array([*breaks, xi[-1]]))


def _extended(spline: PPoly) -> PPoly:
    """A spline with straight continuations."""
    x, c = spline.x, spline.c
    low, high = float(spline(x[0])), float(spline(x[-1]))
    before, after = float(spline(x[0], 1)), float(spline(x[-1], 1))
    margin = 500.0
    first = np.array([0.0, 0.0, before, low - before * margin])
    last = np.array([0.0, 0.0, after, high])
    return PPoly(np.column_stack([first, c, last]), np.array([x[0] - margin, *x, x[-1] + margin]))


def _profile(values: tuple[float, ...], length: float) -> PPoly:
    """Values at equal intervals along the chord, interpolated without overshoot, constant beyond both ends."""
    if len(values) == 1:
        return PPoly(np.array([[0.0], [0.0], [0.0], [values[0]]]), np.array([0.0, length]))
    if len(values) == 2:
        c = np.array([[0.0], [0.0], [(values[1] - values[0]) / length], [values[0]]])
        inner = PPoly(c, np.array([0.0, length]))
    else:
        knots = np.linspace(0, length, len(values))
        slopes = PchipInterpolator(knots, values).derivative()(knots)
        inner = CubicHermiteSpline(knots, values, slopes)
    first = np.array([0.0, 0.0, 0.0, values[0]])
    last = np.array([0.0, 0.0, 0.0, values[-1]])
    return PPoly(np.column_stack([first, inner.c, last]), np.array([-500.0, *inner.x, length + 500.0]))


def _tables(lines: list[Line]) -> Floats:
    """(lines, 15 size) piecewise cubics of all lines as `relief.table` reads them, padded to equal length."""
    rows = []
    for line in lines:
        length = float(_chord_coordinates(line)[-1, 0])
        width = (line.diameter_mm,) if isinstance(line, Cable) else line.width_mm
        width = width if isinstance(width, tuple) else (width,)
        step = line.step_mm if isinstance(line, Seam) else (0.0,)
        rows.append((course(line), _profile(width, length), _profile(step, length)))
    size = max((p.c.shape[1] for row in rows for p in row), default=1)
    tables = np.zeros((len(lines), 3, 5 * size))
    tables[:, :, :size] = np.inf
    for i, row in enumerate(rows):
        for k, p in enumerate(row):
            n = p.c.shape[1]
            tables[i, k, :n] = p.x[:-1]
            tables[i, k, size : size + 4 * n] = p.c.T.ravel()
    return tables.reshape(len(lines), 15 * size)


def _bind(panel: Panel, bare: Relief) -> None:
    """Note in the seams that begin or end at another: that one's index and the side of it on which they lie."""
    index = {seam.id: k for k, seam in enumerate(panel.seams)}
    for k, seam in enumerate(panel.seams):
        middle = np.array(seam.points_mm).mean(axis=0)
        sides = int(sides_at(bare, middle[:1], middle[1:])[0])
        for end, other in enumerate((seam.starts_at, seam.ends_at)):
            if other is not None:
                column = r.S_BOUNDS + 2 * end
                bare.seams[k, column : column + 2] = index[other], (sides >> index[other]) & 1


def leaning(normal: Floats, height: float, tilt_deg: float, azimuth_deg: float) -> tuple[Floats, Floats]:
    """Offset of a point `height` above the skin and the unit normal inclined there, from the skin's unit normal."""
    e1 = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    e1 /= np.linalg.norm(e1)
    azimuth, tilt = math.radians(azimuth_deg), math.radians(tilt_deg)
    lean = math.cos(azimuth) * e1 + math.sin(azimuth) * np.cross(normal, e1)
    return height * normal, math.cos(tilt) * normal + math.sin(tilt) * lean


def head_pose(rivet: Rivet, height: float, normal: Floats) -> tuple[Floats, Floats]:
    """Offset of the head's point above the skin point and the head's unit normal, from the skin's unit normal."""
    return leaning(normal, height, rivet.tilt_deg, rivet.tilt_azimuth_deg)


def _rivet(rivet: Rivet, bare: Relief) -> Floats:
    point, normal = survey(bare, rivet.x_mm, rivet.y_mm)
    # The rim lies below the mean of a domed head by half its crown (a paraboloid).
    offset, lean = head_pose(rivet, rivet.height_mm - 0.5 * rivet.crown_mm, normal)
    centre = point + offset
    row = np.zeros(r.R_SIZE)
    row[[r.R_HEAD_X, r.R_HEAD_Y, r.R_HEAD_Z]] = centre
    row[r.R_HEAD_GX], row[r.R_HEAD_GY] = -lean[0] / lean[2], -lean[1] / lean[2]
    row[r.R_RADIUS], row[r.R_DOME] = rivet.diameter_mm / 2, rivet.crown_mm
    row[r.R_RING_X], row[r.R_RING_Y] = centre[:2]
    row[r.R_RING_GX], row[r.R_RING_GY] = -normal[0] / normal[2], -normal[1] / normal[2]
    row[r.R_OUTER] = rivet.diameter_mm / 2 + rivet.ring_width_mm
    row[r.R_RING_DEPTH] = rivet.ring_depth_mm + max(0.0, -rivet.height_mm)
    row[r.R_HEAD_REFLECTANCE], row[r.R_RING_REFLECTANCE] = rivet.head_reflectance, rivet.ring_reflectance
    if rivet.slot is not None:
        angle = math.radians(rivet.slot.angle_deg)
        row[r.R_SLOT_COS], row[r.R_SLOT_SIN] = math.cos(angle), math.sin(angle)
        row[r.R_SLOT_LENGTH], row[r.R_SLOT_WIDTH] = rivet.slot.length_mm, rivet.slot.width_mm
        row[r.R_SLOT_DEPTH] = rivet.slot.depth_mm
        row[r.R_SLOT_CROSS] = float(rivet.slot.cross or rivet.slot.shape in ("cross", "torq-set"))
        row[r.R_RECESS] = {"torq-set": r.TORQ_SET, "hex": r.HEXAGON}.get(rivet.slot.shape, r.WINGS)
    return row


def _cleco(cleco: Cleco, bare: Relief) -> list[Floats]:
    """Plunger and body: discs above the skin whose walls stand upright in the panel's frame."""
    point, normal = survey(bare, cleco.x_mm, cleco.y_mm)
    top = cleco.height_mm + cleco.plunger_height_mm
    return [
        _disc(point + np.array([0.0, 0.0, height]), normal, 0.5 * diameter, 0.0, cleco.reflectance)
        for diameter, height in ((cleco.plunger_mm, top), (cleco.diameter_mm, cleco.height_mm))
    ]


def _lying(speck: Speck, bare: Relief) -> Floats:
    point, normal = survey(bare, speck.x_mm, speck.y_mm)
    offset, lean = leaning(normal, speck.height_mm, speck.tilt_deg, speck.tilt_azimuth_deg)
    return _disc(point + offset, lean, 0.5 * speck.diameter_mm, speck.crown_mm, speck.reflectance)


def _disc(centre: Floats, normal: Floats, radius: float, crown: float, reflectance: float) -> Floats:
    """A head without a ring."""
    row = np.zeros(r.R_SIZE)
    row[[r.R_HEAD_X, r.R_HEAD_Y, r.R_HEAD_Z]] = centre
    row[r.R_HEAD_GX], row[r.R_HEAD_GY] = -normal[0] / normal[2], -normal[1] / normal[2]
    row[[r.R_RING_X, r.R_RING_Y, r.R_RING_GX, r.R_RING_GY]] = row[[r.R_HEAD_X, r.R_HEAD_Y, r.R_HEAD_GX, r.R_HEAD_GY]]
    row[[r.R_RADIUS, r.R_OUTER, r.R_DOME]] = radius, radius, crown
    row[[r.R_HEAD_REFLECTANCE, r.R_RING_REFLECTANCE]] = reflectance
    return row


def _hole(hole: Hole, bare: Relief) -> Floats:
    point, normal = survey(bare, hole.x_mm, hole.y_mm)
    row = np.zeros(r.R_SIZE)
    row[[r.R_HEAD_X, r.R_HEAD_Y, r.R_HEAD_Z]] = point
    row[r.R_RING_X], row[r.R_RING_Y] = point[:2]
    row[r.R_RING_GX], row[r.R_RING_GY] = -normal[0] / normal[2], -normal[1] / normal[2]
    row[r.R_OUTER], row[r.R_RING_DEPTH] = hole.diameter_mm / 2, hole.depth_mm
    row[r.R_IS_HOLE], row[r.R_RING_REFLECTANCE] = 1.0, hole.reflectance
    if hole.countersink_mm:
        row[r.R_OUTER], row[r.R_RADIUS] = hole.countersink_mm / 2, hole.diameter_mm / 2
        # Along z, not along the normal.
        row[r.R_CONE] = 1 / (math.tan(math.radians(hole.countersink_deg / 2)) * normal[2])
    return row


def _arcs(items: list[Round]) -> Floats:
    """(items, 2 arcs) open arcs of all rings in rad; a ring open all around is one arc of a full turn."""
    full = ((0.0, 360.0),)
    rows = [i.arcs_deg if isinstance(i, Rivet) and i.arcs_deg is not None else full for i in items]
    arcs = np.full((len(items), max((len(row) for row in rows), default=1) or 1, 2), np.nan)
    for k, row in enumerate(rows):
        if row:
            arcs[k, : len(row)] = np.radians(row)
            # A full turn has no ends; a little over it leaves none to rounding.
            arcs[k, : len(row), 1] += np.where(np.ptp(arcs[k, : len(row)], axis=1) > 2 * np.pi - 1e-6, 1e-6, 0)
    return arcs.reshape(len(items), 2 * arcs.shape[1])


def _reach(panel: Panel) -> tuple[float, float]:
    """The most that anything stands above the undisturbed skin and lies below it."""
    plates = 0.5 * sum(max(abs(s) for s in seam.step_mm) for seam in panel.seams)
    up, down = [0.0], [0.0]
    for rivet in panel.rivets:
        rim = math.sin(math.radians(rivet.tilt_deg)) * rivet.diameter_mm / 2 + abs(rivet.crown_mm)
        sag = (rivet.diameter_mm / 2 + rivet.ring_width_mm) ** 2 / 300
        up.append(rivet.height_mm + rim + sag)
        depth = max(rivet.ring_depth_mm, rivet.slot.depth_mm if rivet.slot else 0.0)
        down.append(max(0.0, -rivet.height_mm) + rim + sag + depth)
    for speck in panel.specks:
        rim = math.sin(math.radians(speck.tilt_deg)) * speck.diameter_mm / 2
        up.append(speck.height_mm + speck.crown_mm + rim + (speck.diameter_mm / 2) ** 2 / 300)
        down.append(rim)
    dents = [dent.depth_mm for dent in panel.all_dents]
    above = max([0.0, *(-depth for depth in dents), *(gouge.lip_mm for gouge in panel.gouges)])
    below = max([0.0, *dents, *(gouge.depth_mm for gouge in panel.gouges)])
    thick = [p.thickness_mm for p in panel.surface.patches] + [s.thickness_mm for s in panel.surface.stencils]
    up += [bead.height_mm for bead in panel.beads] + [sum(sorted(thick)[-2:])]
    up += [cable.diameter_mm / 2 for cable in panel.cables]
    down += [hole.depth_mm for hole in panel.holes]
    for seam in panel.seams:
        slope = seam.chamfer_mm * math.tan(math.radians(seam.chamfer_deg))
        down.append(max(seam.depth_mm, slope, seam.edge_radius_mm))
    return max(up) + plates + 0.05 + 1.1 * above, max(down) + plates + 0.05 + 1.1 * below


def _with_cells(packed: Relief, tall: list[float]) -> Relief:
    """Fill the grid that tells which rivets and whether a seam may be met near a place."""
    frame = packed.frame
    margin = _STEEPEST * float(frame[r.F_ABOVE] + frame[r.F_BELOW]) + 1.5
    width, height = frame[r.F_X_MAX] - frame[r.F_X_MIN], frame[r.F_Y_MAX] - frame[r.F_Y_MIN]
    shape = (math.ceil(height) + 3, math.ceil(width) + 3)
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    x, y = x + frame[r.F_ORIGIN_X], y + frame[r.F_ORIGIN_Y]
    near = [
        np.hypot(x - rivet[r.R_RING_X], y - rivet[r.R_RING_Y]) < rivet[r.R_OUTER] + margin + _STEEPEST * height
        for rivet, height in zip(packed.rivets, tall, strict=True)
    ]
    cells = _cells(shape, near, _near_seam(packed, x, y, margin))
    # Only what stands far out of the skin reaches higher than the margin, and its cells are wider by as much.
    frame = frame.copy()
    frame[r.F_ABOVE] += max(tall, default=0.0)
    return packed._replace(cells=cells, frame=frame)


def _cells(shape: tuple[int, int], near: list[Mask], near_seam: Mask | None) -> NDArray[np.int32]:
    """The grid from one mask per rivet and one for all seams."""
    most = int(np.sum(near, axis=0).max()) if near else 0
    cells = np.full((*shape, most + 2), -1, np.int32)
    filled = np.zeros(shape, int)
    for k, mask in enumerate(near):
        rows, columns = np.nonzero(mask)
        cells[rows, columns, filled[rows, columns]] = k
        filled[rows, columns] += 1
    cells[..., -1] = 0 if near_seam is None else near_seam
    return cells


def _near_seam(packed: Relief, x: Floats, y: Floats, margin: float) -> Mask:
    near = np.zeros(x.shape, bool)
    for k, seam in enumerate(packed.seams):
        dx, dy = x - seam[r.S_X], y - seam[r.S_Y]
        xi, eta = dx * seam[r.S_EX] + dy * seam[r.S_EY], -dx * seam[r.S_EY] + dy * seam[r.S_EX]
        centre, width = evaluate(packed, k, r.COURSE, xi), evaluate(packed, k, r.WIDTH, xi)
        # The offset is measured across the chord; a course inclined to it is nearer than that.
        near |= np.abs(eta - centre) < (0.5 * width + seam[r.S_CHAMFER] + margin) * 1.5
    return near


def evaluate(packed: Relief, seam: int, which: int, xi: Floats, derivative: int = 0) -> Floats:
    """A seam's course, width or step at distances along its chord (numpy twin of `relief.table`)."""
    pieces = (packed.seams.shape[1] - r.S_SIZE) // 15
    table = packed.seams[seam, r.S_SIZE :].reshape(3, 5 * pieces)[which]
    breaks = table[:pieces]
    i = np.clip(np.searchsorted(breaks, xi, side="right") - 1, 0, None)
    c, u = table[pieces:].reshape(pieces, 4)[i], xi - breaks[i]
    if derivative:
        return np.asarray((3 * c[..., 0] * u + 2 * c[..., 1]) * u + c[..., 2])
    return np.asarray(((c[..., 0] * u + c[..., 1]) * u + c[..., 2]) * u + c[..., 3])

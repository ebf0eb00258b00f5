"""What is true of a rendered scene, by the paper's definitions, computed from the panel's exact geometry."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Ints
from metrology.rig import Rig
from simulator import relief as r
from simulator.clutter import Cleco
from simulator.pack import evaluate, head_pose
from simulator.panel import Hole, Panel, Rivet, Seam
from simulator.relief import Floats, Relief
from simulator.survey import plate_heights, plate_normals, seen, sides_at, survey
from simulator.true_dents import TrueDent, true_dents

STATION_MM = 1.0
_CLEAR_MM = 1.0  # a station nearer than that to a border or to another seam's edge is not counted as visible
_LIFT = 1e-6  # mm above the surface, where sight lines start


@dataclass(frozen=True)
class Pose:
    """Where the panel stands: panel coordinates p are at R p + t in the rig frame (mm)."""

    R: Floats
    t: Floats

    def to_rig(self, points: Floats) -> Floats:
        """(..., 3) points in the rig frame."""
        return np.asarray(points @ self.R.T + self.t)

    def to_panel(self, points: Floats) -> Floats:
        """(..., 3) points of the rig frame in the panel's."""
        return np.asarray((points - self.t) @ self.R)


@dataclass(frozen=True)
class TrueRivet:
    """One rivet."""

    id: str
    xyz_mm: list[float]
    """Head centre (at its mean height) in the rig frame."""
    uv_px: list[float]
    """Its image in the left camera."""
    diameter_mm: float
    visible: bool
    """Inside both images and the projector's field, and not hidden."""
    height_mean_mm: float
    """Distance of the head to the skin's tangent plane at its centre, + proud, mean over the head."""
    head_edge_rise_mm: float
    """How far the rim rises and falls about that by the tilt alone."""
    tilt_deg: float
    dome_mm: float
    kind: str = "head"
    """"head", or "recessed" where it has a recess."""


@dataclass(frozen=True)
class TrueHole:
    """An open hole, one filled with sealant ("hole") or a temporary fastener ("cleco"): among the rivets in a file."""

    id: str
    xyz_mm: list[float]
    uv_px: list[float]
    """xyz_mm, uv_px: middle of its outer border on the skin (a cleco: of its top) in the rig frame and the left image.
    """
    diameter_mm: float
    """Of the bore, or of a cleco's body."""
    visible: bool
    height_mean_mm: float
    """Of its ground (negative), or of a cleco's top, above the skin."""
    kind: str
    countersink_mm: float = 0.0
    countersink_depth_mm: float = 0.0
    countersink_deg: float = 0.0
    """countersink_mm, countersink_depth_mm, countersink_deg: 0 without a countersink."""
    filled: bool = False
    """Closed with sealant up to its ground."""
    head_edge_rise_mm: float = 0.0
    tilt_deg: float = 0.0
    dome_mm: float = 0.0


@dataclass(frozen=True)
class TrueSeam:
    """One seam, station by station (about every millimetre along its course)."""

    id: str
    visible: list[bool]
    """Both edges and some skin beside them are in both images, lit, and clear of borders and other seams."""
    uv_px: list[list[float]]
    xyz_mm: list[list[float]]
    """xyz_mm, uv_px: midpoint of the ideal edges D′ and G′ in the rig frame and the left image."""
    step_mm: list[float]
    """Height of side B minus side A, eqs 6–8 with their signs."""
    width_mm: list[float]
    """Eqs 9–11."""
    chamfer_mm: float
    kind: str = "butt"
    """"butt", "sealed" (a butt joint filled with sealant) or "lap"."""
    edge_radius_mm: float = 0.0
    """chamfer_mm, edge_radius_mm: width of the broken edges, or their radius."""


@dataclass(frozen=True)
class Truth:
    """All that is true of a scene."""

    rivets: tuple[TrueRivet, ...]
    seams: tuple[TrueSeam, ...]
    holes: tuple[TrueHole, ...] = ()
    dents: tuple[TrueDent, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """As truth.json has it: holes and temporary fasteners are among the rivets there, told by their kind."""
        return {
            "rivets": [asdict(v) for v in self.rivets] + [asdict(v) for v in self.holes],
            "seams": [asdict(v) for v in self.seams],
            "dents": [asdict(v) for v in self.dents],
        }


def truth(panel: Panel, relief: Relief, rig: Rig, pose: Pose) -> Truth:
    """The truth of one scene.

    Parameters
    ----------
    relief : Relief
        The same panel, packed.
    rig : Rig
        The rig as it really is.
    """
    rivets = tuple(_rivet(rivet, relief, rig, pose) for rivet in panel.rivets)
    seams = tuple(_seam(k, seam, panel, relief, rig, pose) for k, seam in enumerate(panel.seams))
    holes = [_hole(hole, f"H{k:02d}", relief, rig, pose) for k, hole in enumerate(panel.holes, 1)]
    clecos = [_cleco(cleco, f"C{k:02d}", relief, rig, pose) for k, cleco in enumerate(panel.clecos, 1)]

    def visible(points: Floats) -> NDArray[np.bool_]:
        return _in_all_fields(rig, pose.to_rig(points)) & _unhidden(relief, rig, pose, points)

    def place(point: Floats) -> tuple[list[float], list[float]]:
        at = pose.to_rig(point)
        return at.tolist(), rig.left.project(at).tolist()

    return Truth(rivets, seams, (*holes, *clecos), true_dents(panel, relief, place, visible))


def _in_all_fields(rig: Rig, points: Floats) -> NDArray[np.bool_]:
    """Whether rig-frame points are in both images and the projector's field."""
    devices = (rig.left, rig.with_right(), rig.with_projector())
    return np.logical_and.reduce([d.inside(d.project(points)) for d in devices])


def _unhidden(relief: Relief, rig: Rig, pose: Pose, points: Floats) -> NDArray[np.bool_]:
    """Whether panel-frame points are seen by both cameras and lit by the projector."""
    eyes = [pose.to_panel(d.centre) for d in (rig.left, rig.with_right(), rig.with_projector())]
    return np.logical_and.reduce([seen(relief, points, eye) for eye in eyes])


def _rivet(rivet: Rivet, relief: Relief, rig: Rig, pose: Pose) -> TrueRivet:
    point, normal = survey(relief, rivet.x_mm, rivet.y_mm)
    offset, _ = head_pose(rivet, rivet.height_mm, normal)
    centre = pose.to_rig(point + offset)
    angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    around = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * (rivet.diameter_mm / 2)
    surface = (point + offset + (abs(rivet.crown_mm) + _LIFT) * normal)[None]
    shown = _in_all_fields(rig, pose.to_rig(point + around)).all() and _unhidden(relief, rig, pose, surface).all()
    rise = rivet.diameter_mm / 2 * math.sin(math.radians(rivet.tilt_deg))
    return TrueRivet(
        rivet.id, centre.tolist(), rig.left.project(centre).tolist(), rivet.diameter_mm, bool(shown),
        rivet.height_mm, rise, rivet.tilt_deg, rivet.crown_mm, "recessed" if rivet.slot else "head",
    )  # fmt: skip


def _hole(hole: Hole, name: str, relief: Relief, rig: Rig, pose: Pose) -> TrueHole:
    point, normal = survey(relief, hole.x_mm, hole.y_mm)
    outer = max(hole.diameter_mm, hole.countersink_mm)
    shown = _shows_round(point + _LIFT * normal, outer + 0.2, relief, rig, pose)
    centre = pose.to_rig(point)
    return TrueHole(
        hole.id or name, centre.tolist(), rig.left.project(centre).tolist(), hole.diameter_mm, shown, -hole.depth_mm,
        "hole", hole.countersink_mm, hole.countersink_depth_mm,
        hole.countersink_deg if hole.countersink_mm else 0.0, hole.filled,
    )  # fmt: skip


def _cleco(cleco: Cleco, name: str, relief: Relief, rig: Rig, pose: Pose) -> TrueHole:
    point, _ = survey(relief, cleco.x_mm, cleco.y_mm)
    height = cleco.height_mm + cleco.plunger_height_mm
    top = point + np.array([0.0, 0.0, height + _LIFT])
    shown = _shows_round(top, 0.5 * cleco.plunger_mm, relief, rig, pose)
    centre = pose.to_rig(top)
    return TrueHole(
        cleco.id or name, centre.tolist(), rig.left.project(centre).tolist(), cleco.diameter_mm, shown, height, "cleco"
    )


def _shows_round(centre: Floats, diameter: float, relief: Relief, rig: Rig, pose: Pose) -> bool:
    """Whether a circle just above the surface is in all fields, and half of its edge at least is not hidden."""
    angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    around = centre + np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * (diameter / 2)
    if not _in_all_fields(rig, pose.to_rig(around)).all():
        return False
    x, y = around[:, 0].copy(), around[:, 1].copy()
    around[:, 2] = np.maximum(around[:, 2], plate_heights(relief, x, y, sides_at(relief, x, y)) + _LIFT)
    return bool(_unhidden(relief, rig, pose, around).mean() >= 0.5)


def stations(seam: int, relief: Relief, panel: Panel) -> Floats:
    """Distances along a seam's chord about STATION_MM of arc apart, from end to end within the panel."""
    row = relief.seams[seam]
    fine = np.linspace(-20.0, _length(panel.seams[seam]) + 20.0, 8001)
    x, y = _on_course(relief, seam, fine, np.zeros_like(fine))
    on = _inside(relief, x, y, 0.0)
    on &= (fine >= 0) & (fine <= _length(panel.seams[seam]))
    sides = sides_at(relief, x, y)
    for other, side in relief.seams[seam, r.S_BOUNDS : r.S_BOUNDS + 4].astype(int).reshape(2, 2):
        if other >= 0:
            on &= ((sides >> other) & 1) == side
    fine, x, y = fine[on], x[on], y[on]
    if len(fine) < 2 or row.size == 0:
        return np.empty(0)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    count = int(arc[-1] / STATION_MM)
    return np.interp(np.arange(count + 1) * STATION_MM + 0.5 * (arc[-1] - count * STATION_MM), arc, fine)


def _inside(relief: Relief, x: Floats, y: Floats, margin: float) -> NDArray[np.bool_]:
    """Whether places are on the panel, `margin` away from its border."""
    x_min, x_max, y_min, y_max = relief.frame[r.F_X_MIN : r.F_Y_MAX + 1]
    inside = (x > x_min + margin) & (x < x_max - margin) & (y > y_min + margin) & (y < y_max - margin)
    return np.asarray(inside)


def _length(seam: Seam) -> float:
    (x0, y0), (x1, y1) = seam.points_mm[0], seam.points_mm[-1]
    return math.hypot(x1 - x0, y1 - y0)


def _on_course(relief: Relief, seam: int, xi: Floats, t: Floats) -> tuple[Floats, Floats]:
    """x, y at the distances xi along the chord and t to the left of the centre line."""
    row = relief.seams[seam]
    slope = evaluate(relief, seam, r.COURSE, xi, 1)
    scale = np.sqrt(1 + slope**2)
    along = xi - t * slope / scale
    across = evaluate(relief, seam, r.COURSE, xi) + t / scale
    return (row[r.S_X] + along * row[r.S_EX] - across * row[r.S_EY],
            row[r.S_Y] + along * row[r.S_EY] + across * row[r.S_EX])  # fmt: skip


@dataclass(frozen=True)
class _Edge:
    """One side of a seam at all stations, panel frame: skin point above the wall, D, D′, and the skin's directions."""

    skin: Floats
    inflection: Floats
    ideal: Floats
    normal: Floats
    across: Floats


def _edge(relief: Relief, seam: int, xi: Floats, t: Floats, sides: Ints, along: Floats) -> _Edge:
    """The edge whose wall stands at t. D is the chamfer's lower end, D′ its foot on the skin line (paper, Fig. 8)."""
    x, y = _on_course(relief, seam, xi, t)
    skin = np.stack([x, y, plate_heights(relief, x, y, sides)], axis=1)
    across = np.cross(plate_normals(relief, x, y, sides), along)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    normal = np.cross(along, across)
    row = relief.seams[seam]
    # A lap has one broken edge, and its step is told by the skin lines alone.
    drop = 0.0 if row[r.S_LAP] else row[r.S_CHAMFER] * row[r.S_SLOPE]
    inflection = skin - np.array([0.0, 0.0, drop])
    ideal = skin + np.sum((inflection - skin) * across, axis=1, keepdims=True) * across
    return _Edge(skin, inflection, ideal, normal, across)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.sum(a * b, axis=1))


def section(relief: Relief, seam: int, xi: Floats) -> tuple[_Edge, _Edge, Floats, Floats]:
    """Both edges, step (left above right) and width of a seam, eqs 6–11, at distances along its chord."""
    h = 1e-3
    middle = [np.stack(_on_course(relief, seam, xi + d, np.zeros_like(xi)), axis=1) for d in (-h, 0.0, h)]
    on_left = sides_at(relief, middle[1][:, 0], middle[1][:, 1]) | (1 << seam)
    on_right = on_left & ~(1 << seam)
    heights = [0.5 * (plate_heights(relief, m[:, 0], m[:, 1], on_left)
                      + plate_heights(relief, m[:, 0], m[:, 1], on_right)) for m in middle]  # fmt: skip
    along = np.column_stack([middle[2] - middle[0], heights[2] - heights[0]])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    half = 0.5 * evaluate(relief, seam, r.WIDTH, xi)
    left = _edge(relief, seam, xi, half, on_left, along)
    right = _edge(relief, seam, xi, -half, on_right, along)
    # Eqs 7 and 8 with signs: each ideal edge above the other side's line; the skin's curvature cancels in the mean.
    step = 0.5 * (_dot(left.ideal - right.ideal, right.normal) - _dot(right.ideal - left.ideal, left.normal))
    # Eqs 10 and 11: each inflection point's distance from the other side's normal through its ideal edge.
    width = 0.5 * (np.abs(_dot(left.inflection - right.ideal, right.across))
                   + np.abs(_dot(right.inflection - left.ideal, left.across)))  # fmt: skip
    return left, right, step, width


def _seam(index: int, seam: Seam, panel: Panel, relief: Relief, rig: Rig, pose: Pose) -> TrueSeam:
    xi = stations(index, relief, panel)
    if not len(xi):
        return TrueSeam(seam.id, [], [], [], [], [], seam.chamfer_mm)
    left, right, step, width = section(relief, index, xi)
    middle = pose.to_rig(0.5 * (left.ideal + right.ideal))
    uv = rig.left.project(middle)
    # Side B is the one at larger u of a seam nearer to vertical in the left image, at larger v otherwise.
    run = uv[-1] - uv[0] if len(uv) > 1 else np.array([0.0, 1.0])
    axis = 0 if abs(run[1]) > abs(run[0]) else 1
    # Across the seam on the skin: its edges themselves lie at different heights, and a camera sees that aside.
    ideal = 0.5 * (left.ideal + right.ideal)
    towards = rig.left.project(pose.to_rig(ideal + left.across)) - rig.left.project(pose.to_rig(ideal))
    sign = 1.0 if np.median(towards[:, axis]) > 0 else -1.0
    return TrueSeam(
        seam.id, _visible(index, xi, panel, relief, rig, pose).tolist(), uv.tolist(), middle.tolist(),
        (sign * step).tolist(), (width if seam.joint == "butt" else 0.0 * width).tolist(), seam.chamfer_mm,
        "lap" if seam.joint == "lap" else "sealed" if seam.filled else "butt", seam.edge_radius_mm,
    )  # fmt: skip


def _visible(index: int, xi: Floats, panel: Panel, relief: Relief, rig: Rig, pose: Pose) -> NDArray[np.bool_]:
    half = 0.5 * evaluate(relief, index, r.WIDTH, xi) + relief.seams[index, r.S_CHAMFER]
    visible = np.ones(len(xi), bool)
    for sign in (-1.0, 1.0):
        x, y = _on_course(relief, index, xi, sign * (half + 0.5))
        sides = sides_at(relief, x, y)
        points = np.stack([x, y, plate_heights(relief, x, y, sides) + _LIFT], axis=1)
        visible &= _inside(relief, x, y, _CLEAR_MM)
        visible &= _in_all_fields(rig, pose.to_rig(points)) & _unhidden(relief, rig, pose, points)
        for other in range(len(panel.seams)):
            if other != index:
                visible &= _clear_of(relief, other, x, y, sides)
    return visible


def _clear_of(relief: Relief, seam: int, x: Floats, y: Floats, sides: Ints) -> NDArray[np.bool_]:
    """Whether places are off another seam's gap and chamfers."""
    row = relief.seams[seam]
    dx, dy = x - row[r.S_X], y - row[r.S_Y]
    xi, eta = dx * row[r.S_EX] + dy * row[r.S_EY], -dx * row[r.S_EY] + dy * row[r.S_EX]
    t = (eta - evaluate(relief, seam, r.COURSE, xi)) / np.sqrt(1 + evaluate(relief, seam, r.COURSE, xi, 1) ** 2)
    clear = np.abs(t) > 0.5 * evaluate(relief, seam, r.WIDTH, xi) + row[r.S_CHAMFER] + _CLEAR_MM
    for other, side in relief.seams[seam, r.S_BOUNDS : r.S_BOUNDS + 4].astype(int).reshape(2, 2):
        if other >= 0:
            clear |= ((sides >> other) & 1) != side
    return np.asarray(clear)

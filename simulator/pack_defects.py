"""From a panel's dents, hail and scratches to the rows of `simulator.overlay`."""

from __future__ import annotations

import math

import numpy as np

from simulator import overlay as v
from simulator.defects import Dent, Gouge
from simulator.panel import Panel
from simulator.relief import Floats, Relief
from simulator.survey import survey

_SMOOTH_MM = 25.0  # surfaces bent less than that radius are flat within a pixel to a tenth of a micrometre


def no_dents() -> Floats:
    """The rows of a panel without defects."""
    return np.zeros((0, v.D_SIZE))


def pack_dents(panel: Panel, bare: Relief) -> Floats:
    """(n, D_SIZE) the rows of all dents, then all gouges, laid into the tangent planes of the skin without them."""
    rows = [_dent(dent, bare) for dent in panel.all_dents] + [_gouge(gouge, bare) for gouge in panel.gouges]
    return np.array(rows).reshape(-1, v.D_SIZE)


def _laid(x: float, y: float, angle_deg: float, axes: tuple[float, float], bare: Relief) -> tuple[Floats, float]:
    """A row with its place and axes, and how much longer a way along z is than one along the normal."""
    _, normal = survey(bare, x, y)
    slope = -normal[:2] / normal[2]
    e1 = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(normal, e1)
    angle = math.radians(angle_deg)
    row = np.zeros(v.D_SIZE)
    row[v.D_X], row[v.D_Y] = x, y
    for first, axis, unit in (
        (v.D_UX, axes[0], math.cos(angle) * e1 + math.sin(angle) * e2),
        (v.D_VX, axes[1], -math.sin(angle) * e1 + math.cos(angle) * e2),
    ):
        row[first : first + 2] = (unit[:2] + unit[2] * slope) / axis
    return row, 1 / float(normal[2])


def _dent(dent: Dent, bare: Relief) -> Floats:
    half = dent.half_axes_mm
    row, steep = _laid(dent.x_mm, dent.y_mm, dent.angle_deg, half, bare)
    row[v.D_DEPTH], row[v.D_BLUNT] = dent.depth_mm * steep, dent.blunt
    row[v.D_SHAPE] = {"smooth": v.SMOOTH, "sharp": v.POINT, "crease": v.FOLD}[dent.shape]
    row[v.D_REACH] = (
        math.hypot(half[0] * dent.foot[0], half[1] * dent.foot[1])
        if dent.shape == "crease"
        else max(half[0] * dent.foot[0], half[1] * dent.foot[1])
    )
    row[v.D_SHARP] = float(dent.least_radius_mm < _SMOOTH_MM)
    return row


def _gouge(gouge: Gouge, bare: Relief) -> Floats:
    dx, dy = gouge.end_mm[0] - gouge.start_mm[0], gouge.end_mm[1] - gouge.start_mm[1]
    half = 0.5 * gouge.width_mm
    x, y = gouge.middle_mm
    row, steep = _laid(x, y, math.degrees(math.atan2(dy, dx)), (half, half), bare)
    row[v.D_DEPTH], row[v.D_LIP] = gouge.depth_mm * steep, gouge.lip_mm * steep
    row[v.D_SHAPE], row[v.D_END] = v.GROOVE, gouge.length_mm / gouge.width_mm
    row[v.D_REACH] = 0.5 * gouge.length_mm + 4 * half
    row[v.D_SHARP] = 1.0
    return row

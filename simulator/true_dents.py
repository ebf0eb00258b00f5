"""What is true of dents, bumps and scratches: in the tangent plane of the skin as it would be without them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.defects import POINTED, Dent, Gouge
from simulator.pack_defects import no_dents
from simulator.panel import Panel
from simulator.relief import Floats, Relief
from simulator.survey import survey

_LIFT = 1e-4  # mm above a dent's outline, where sight lines start

Place = Callable[[Floats], tuple[list[float], list[float]]]
Visible = Callable[[Floats], NDArray[np.bool_]]


@dataclass(frozen=True)
class TrueDent:
    """One defect, as if it were alone."""

    id: str
    xyz_mm: list[float]
    uv_px: list[float]
    """xyz_mm, uv_px: its deepest (highest) point in the rig frame and the left image."""
    depth_mm: float
    """Along the normal there, below the skin without it; negative above."""
    half_depth_axes_mm: list[float]
    foot_axes_mm: list[float]
    """half_depth_axes_mm, foot_axes_mm: full length and width of its outline at half depth, and where it ends."""
    angle_deg: float
    """Direction of its length from the panel's +x."""
    area_mm2: float
    foot_area_mm2: float
    """area_mm2, foot_area_mm2: within these two outlines, in the tangent plane."""
    volume_mm3: float
    """Between it and the skin without it; negative above (a gouge: without its lips)."""
    least_radius_mm: float
    """Of curvature at its bottom, the skin's own left out."""
    visible: bool
    """All of its half-depth outline and its deepest point are in both images, lit and not hidden."""
    kind: str
    """"dent", "bump", "crease" or "scratch"."""
    shape: str
    """As specified, "gouge" for a scratch."""
    lip_mm: float = 0.0
    """How high a scratch's edges stand."""


def true_dents(panel: Panel, relief: Relief, place: Place, visible: Visible) -> tuple[TrueDent, ...]:
    """The truth of all defects.

    Parameters
    ----------
    place : callable
        (3,) panel-frame point to rig frame and left image.
    visible : callable
        (n, 3) panel-frame points to whether each is seen by both cameras and lit.
    """
    bare = relief._replace(dents=no_dents())
    dents = [_dent(dent, bare, place, visible) for dent in panel.all_dents]
    return (*dents, *(_gouge(gouge, bare, place, visible) for gouge in panel.gouges))


def _dent(dent: Dent, bare: Relief, place: Place, visible: Visible) -> TrueDent:
    point, normal = survey(bare, dent.x_mm, dent.y_mm)
    a, b = dent.half_axes_mm
    area, foot, volume = _extent(dent)
    kind = "bump" if dent.depth_mm < 0 else "crease" if dent.shape == "crease" else "dent"
    xyz, uv = place(point - dent.depth_mm * normal)
    return TrueDent(
        dent.id, xyz, uv, dent.depth_mm, list(dent.axes_mm), [2 * a * dent.foot[0], 2 * b * dent.foot[1]],
        dent.angle_deg, area * a * b, foot * a * b, volume * a * b * dent.depth_mm, dent.least_radius_mm,
        _shown(point, normal, dent.angle_deg, (a, b), dent.depth_mm, visible), kind, dent.shape,
    )  # fmt: skip


def _extent(dent: Dent) -> tuple[float, float, float]:
    """Areas within half depth and foot, and volume, of a dent of unit depth and half axes."""
    if dent.shape == "smooth":
        return math.pi, 4 * math.pi, 4 * math.pi * (1 - 4 / math.pi**2) / 2
    rho = np.linspace(0.0, dent.foot[1], 20001)
    profile = _pointed(rho, dent.blunt)
    if dent.shape == "sharp":
        volume = float(np.trapezoid(2 * math.pi * rho * profile, rho))
        return math.pi, math.pi * dent.foot[0] ** 2, volume
    # A fold: cos²(π u / 4) along, the profile across; half depth where their product is a half.
    u = np.linspace(0.0, 1.0, 4001)
    rise = (POINTED * (1 - np.sqrt(0.5) / np.cos(0.25 * math.pi * u)) + dent.blunt) ** 2 - dent.blunt**2
    across = np.sqrt(np.maximum(rise, 0.0) / (1 + 2 * dent.blunt))
    area = 4 * float(np.trapezoid(across, u))
    # ∫ cos² over its length is 2 (half axes); a fold's foot is a rectangle.
    return area, 4 * dent.foot[0] * dent.foot[1], 2 * 2 * float(np.trapezoid(profile, rho))


def _pointed(rho: Floats, blunt: float) -> Floats:
    """(1 − ρ/r)², its point rounded (numpy twin of the kernel)."""
    return np.maximum(1 - (np.sqrt((1 + 2 * blunt) * rho**2 + blunt**2) - blunt) / POINTED, 0.0) ** 2


def _gouge(gouge: Gouge, bare: Relief, place: Place, visible: Visible) -> TrueDent:
    point, normal = survey(bare, *gouge.middle_mm)
    a, b = 0.5 * gouge.length_mm, 0.5 * gouge.width_mm
    dx, dy = gouge.end_mm[0] - gouge.start_mm[0], gouge.end_mm[1] - gouge.start_mm[1]
    angle = math.degrees(math.atan2(dy, dx))
    xyz, uv = place(point - gouge.depth_mm * normal)
    # Its profile: full depth up to a half width before the half-depth end, cos² from there over two half widths.
    s = np.linspace(0.0, 1.0, 2001)
    ends = 2 * b * b * float(np.trapezoid(2 * 4 / math.pi * np.arccos(np.sqrt(0.5) / np.cos(0.25 * math.pi * s)), s))
    return TrueDent(
        gouge.id, xyz, uv, gouge.depth_mm, [2 * a, 2 * b], [2 * (a + b), 4 * b], angle,
        4 * (a - b) * b + ends, 8 * (a + b) * b, gouge.depth_mm * 2 * a * 2 * b,
        8 * b**2 / (math.pi**2 * gouge.depth_mm),
        _shown(point, normal, angle, (a, b), gouge.depth_mm, visible), "scratch", "gouge", gouge.lip_mm,
    )  # fmt: skip


def _shown(
    point: Floats, normal: Floats, angle_deg: float, half: tuple[float, float], depth: float, visible: Visible
) -> bool:
    e1 = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(normal, e1)
    angle = math.radians(angle_deg)
    along, across = math.cos(angle) * e1 + math.sin(angle) * e2, math.cos(angle) * e2 - math.sin(angle) * e1
    turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    rim = point + half[0] * np.cos(turn)[:, None] * along + half[1] * np.sin(turn)[:, None] * across
    points = np.vstack([rim - (0.5 * min(depth, 0.0) - 0.1) * normal, point + (_LIFT - depth) * normal])
    return bool(visible(points).all())

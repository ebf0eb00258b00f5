"""Diameter, place and countersink of open holes; temporary fasteners by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.holes.countersink import Countersink, countersink
from metrology.holes.find import Opening, brightness
from metrology.holes.rim import DIRECTIONS, RimCircle, cloud_edges, picture_edges, rim_circle
from metrology.results import COVERAGE_95, Hole, HoleKind, RivetDetection
from metrology.rig import Device
from metrology.rivets.patch import Patch, blocked_pixels, cut_patch, point_sets
from metrology.rivets.settings import RivetSettings
from metrology.surfaces import Polynomial

if TYPE_CHECKING:
    from metrology.sighted import Sighted

Array = NDArray[np.float64]
View = tuple[Device, NDArray[np.float32]]

_ENOUGH = 0.25  # of all directions in which pictures must show a rim; below it the cloud tells
_LEAST_MM = 0.5
_DARK = 0.15  # of the skin's brightness: black paint sends back more than a hole into which no light falls
_PROFILE_PX = 8.0  # of skin beyond the largest radius of a rim
_ON_CONE_PX = 1.5  # within a countersink: clear of the blur of its border, and wide enough to tell its brightness
_DEEPER = 3  # rounds in which a rim's depth and its place agree
_SIZE = 1.35  # times the radius at which it was found may the rim lie


def measure_holes(
    openings: Sequence[Opening], reconstruction: Reconstruction, settings: RivetSettings | None = None
) -> list[Hole]:
    """Holes in their order, numbered H01 …; what could not be measured is None, with the reason."""
    if not openings:
        return []
    settings = settings or RivetSettings()
    blocked = blocked_pixels(reconstruction)
    rows = []
    for k, opening in enumerate(openings, 1):
        e = opening.ellipse
        found = RivetDetection(e.u, e.v, 2 * e.a, 2 * e.b, float(np.degrees(e.angle)), 1.0)
        empty = Hole(f"H{k:02d}", x_mm=None, y_mm=None, z_mm=None, u_px=e.u, v_px=e.v, kind=_kind(opening))
        patch = cut_patch(found, (), reconstruction, blocked, np.zeros_like(blocked), settings)
        rows.append(
            replace(empty, decision="not measured", reason=patch)
            if isinstance(patch, str)
            else _measured(empty, opening, patch, reconstruction, settings)
        )
    return rows


def measure_sighted(sighted: Sighted, settings: RivetSettings | None) -> list[Hole]:
    """The holes of a scan in which fasteners were looked for."""
    return measure_holes(sighted.openings, sighted.reconstruction, settings)


def _kind(opening: Opening) -> HoleKind:
    """What stands far out of the skin holds two sheets together for a while."""
    return "temporary fastener" if opening.inside_mm is not None and opening.inside_mm > 0 else "open hole"


def _measured(
    empty: Hole, opening: Opening, patch: Patch, reconstruction: Reconstruction, settings: RivetSettings
) -> Hole:
    """The table's row of a hole."""
    skin = patch.surface(point_sets(patch, settings)[1], 2, np.random.default_rng(0))
    if skin is None:
        return replace(empty, decision="not measured", reason="skin: its points lie too unevenly for a surface")
    centre = patch.frame.rig([0.0, 0.0, float(skin.height(0.0, 0.0))])
    placed = _at(empty, centre, reconstruction)
    if empty.kind == "temporary fastener":
        reason = f"temporary fastener: it stands {opening.inside_mm:.1f} mm proud; flushness is not measured"
        return replace(placed, decision="not measured", reason=reason)
    height = patch.h - skin.height(patch.x, patch.y)
    cone = countersink(np.hypot(patch.x, patch.y), height, patch.guard / patch.guard_px, _SIZE * patch.radius)
    rim = _rim(patch, skin, reconstruction, cone)
    if cone is not None:
        placed = replace(
            placed,
            countersink_diameter_mm=cone.diameter_mm,
            countersink_diameter_u95_mm=COVERAGE_95 * cone.diameter_sd_mm,
            countersink_depth_mm=None if rim is None else cone.depth_at(rim.radius),
            countersink_angle_deg=cone.angle_deg,
        )
    if rim is None or rim.radius < _LEAST_MM:
        below = "" if cone is None else " below its countersink"
        return replace(placed, decision="not measured", reason=f"no circle follows its rim{below}")
    row = _at(placed, patch.frame.rig([rim.x, rim.y, float(skin.height(rim.x, rim.y))]), reconstruction)
    row = replace(row, diameter_mm=2 * rim.radius, diameter_u95_mm=2 * COVERAGE_95 * rim.radius_sd)
    if opening.inside_mm is None and (share := brightness(opening.ellipse, reconstruction.left.texture)) > _DARK:
        reason = f"nothing was measured inside, yet it is {share:.0%} as bright as the skin: a hole or black paint"
        return replace(row, decision="unconfirmed", reason=reason)
    return replace(row, depth_mm=None if opening.inside_mm is None else -opening.inside_mm)


def _at(row: Hole, point: Array, reconstruction: Reconstruction) -> Hole:
    """The row with its place."""
    u, v = reconstruction.rig.left.project(point)
    x, y, z = (float(c) for c in point)
    return replace(row, x_mm=x, y_mm=y, z_mm=z, u_px=float(u), v_px=float(v))


def _rim(patch: Patch, skin: Polynomial, reconstruction: Reconstruction, cone: Countersink | None) -> RimCircle | None:
    """The hole's own rim, at the lower end of a countersink where there is one."""
    pixel_mm = patch.guard / patch.guard_px
    rig = reconstruction.rig
    views = (rig.left, reconstruction.left.texture), (rig.right, reconstruction.right.texture)
    if cone is not None:
        return _rim_below(patch, skin, views, cone, pixel_mm)
    within = _SIZE * patch.radius
    edges = picture_edges(patch, skin, views, pixel_mm, within + _PROFILE_PX * pixel_mm, within + 2 * pixel_mm)
    if edges.directions < _ENOUGH * DIRECTIONS:
        edges = cloud_edges(patch, patch.h - skin.height(patch.x, patch.y), pixel_mm, within)
    return rim_circle(edges, pixel_mm)


def _rim_below(
    patch: Patch, skin: Polynomial, views: tuple[View, ...], cone: Countersink, pixel_mm: float
) -> RimCircle | None:
    """The rim where a countersink ends; how deep that is follows from how wide it is."""
    start = 0.5 * cone.diameter_mm - _ON_CONE_PX * pixel_mm
    radius = min(0.5 * cone.lower_diameter_mm, start - _ON_CONE_PX * pixel_mm)
    rim = None
    for _ in range(_DEEPER):
        edges = picture_edges(
            patch, skin, views, pixel_mm, start, start - _ON_CONE_PX * pixel_mm, cone.depth_at(radius)
        )
        rim = rim_circle(edges, pixel_mm)
        if rim is None or rim.directions < _ENOUGH * DIRECTIONS or not _LEAST_MM < rim.radius < start:
            return None
        radius = rim.radius
    return rim

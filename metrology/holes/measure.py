"""Diameter, place and countersink of open holes; temporary fasteners by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.holes.countersink import Countersink, countersink
from metrology.holes.find import Opening
from metrology.holes.rim import DIRECTIONS, RimCircle, cloud_edges, picture_edges, rim_circle
from metrology.results import COVERAGE_95, Hole, HoleKind, RivetDetection
from metrology.rivets.patch import Patch, blocked_pixels, cut_patch, point_sets
from metrology.rivets.settings import RivetSettings
from metrology.surfaces import Polynomial

if TYPE_CHECKING:
    from metrology.sighted import Sighted

Array = NDArray[np.float64]

_ENOUGH = 0.25  # of all directions in which pictures must show a rim; below it the cloud tells
_LEAST_MM = 0.5
_DARK = 0.15  # of the skin's brightness: black paint sends back more than a hole into which no light falls
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
    if rim is None or rim.radius < _LEAST_MM:
        return replace(placed, decision="not measured", reason="no circle follows its rim")
    row = _at(empty, patch.frame.rig([rim.x, rim.y, float(skin.height(rim.x, rim.y))]), reconstruction)
    row = replace(row, diameter_mm=2 * rim.radius, diameter_u95_mm=2 * COVERAGE_95 * rim.radius_sd)
    if cone is not None:
        row = replace(
            row,
            countersink_diameter_mm=cone.diameter_mm,
            countersink_diameter_u95_mm=COVERAGE_95 * cone.diameter_sd_mm,
            countersink_depth_mm=cone.depth_mm,
            countersink_angle_deg=cone.angle_deg,
        )
    if opening.inside_mm is None and (brightness := _brightness(opening, reconstruction)) > _DARK:
        reason = f"nothing was measured inside, yet it is {brightness:.0%} as bright as the skin: a hole or black paint"
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
    deeper = 0.0 if cone is None else cone.depth_mm
    within = _SIZE * patch.radius if cone is None else 0.5 * cone.lower_diameter_mm + 2 * pixel_mm
    rig = reconstruction.rig
    views = (rig.left, reconstruction.left.texture), (rig.right, reconstruction.right.texture)
    edges = picture_edges(patch, skin, views, pixel_mm, within, deeper)
    if edges.directions < _ENOUGH * DIRECTIONS:
        edges = cloud_edges(patch, patch.h - skin.height(patch.x, patch.y) + deeper, pixel_mm, within)
    return rim_circle(edges, pixel_mm)


def _brightness(opening: Opening, reconstruction: Reconstruction) -> float:
    """Brightness inside a hole, as a share of that of the skin round it."""
    e, texture = opening.ellipse, reconstruction.left.texture
    reach = int(1.6 * e.a) + 2
    rows = slice(max(0, int(e.v) - reach), int(e.v) + reach + 1)
    columns = slice(max(0, int(e.u) - reach), int(e.u) + reach + 1)
    part = texture[rows, columns]
    v, u = np.mgrid[rows.start : rows.start + part.shape[0], columns.start : columns.start + part.shape[1]]
    level = e.level(u, v)
    return float(np.nanmedian(part[level < 0.6]) / np.nanmedian(part[(level > 1.2) & (level < 1.6)]))

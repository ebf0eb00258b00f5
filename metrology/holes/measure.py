"""Diameter, place and countersink of open holes; temporary fasteners by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.holes.bore import bore_circle
from metrology.holes.countersink import Countersink, countersink
from metrology.holes.find import Opening, brightness
from metrology.holes.rim import CLOUD_SD_PX, DIRECTIONS, RimCircle, View, cloud_edges, picture_edges, rim_circle
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
_PROFILE_PX = 8.0  # of skin beyond the largest radius of a rim
_BORDER_PX = 1.0  # by which a cone's border in pictures may lie off the cloud's, beyond its U95
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
    pixel_mm = patch.guard / patch.guard_px
    views = tuple((device, view.texture) for device, view in reconstruction.cameras.values())
    rim = _rim(patch, skin, views, pixel_mm)
    if cone is not None:
        rim, placed = _below(cone, rim, placed, patch, skin, views, pixel_mm)
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


def _rim(patch: Patch, skin: Polynomial, views: tuple[View, ...], pixel_mm: float) -> RimCircle | None:
    """Where the skin ends."""
    within = _SIZE * patch.radius
    edges = picture_edges(patch, skin, views, pixel_mm, within + _PROFILE_PX * pixel_mm, within + 2 * pixel_mm)
    rim = rim_circle(edges, pixel_mm) if edges.directions >= _ENOUGH * DIRECTIONS else None
    height = patch.h - skin.height(patch.x, patch.y)
    return rim or rim_circle(cloud_edges(patch, height, pixel_mm, within), pixel_mm)


def _below(
    cone: Countersink, rim: RimCircle | None, placed: Hole, patch: Patch, skin: Polynomial, views: tuple[View, ...],
    pixel_mm: float,
) -> tuple[RimCircle | None, Hole]:  # fmt: skip
    """The bore below a countersink, and the row with the countersink: its border of pictures, else of the cloud."""
    diameter, sd = cone.diameter_mm, cone.diameter_sd_mm
    outer = RimCircle(0.0, 0.0, 0.5 * diameter, 0.5 * sd, 0)
    off = np.inf if rim is None or rim.radius_sd > CLOUD_SD_PX * pixel_mm else abs(2 * rim.radius - diameter)
    if rim is not None and off < COVERAGE_95 * sd + _BORDER_PX * pixel_mm:
        outer, diameter, sd = rim, 2 * rim.radius, 2 * rim.radius_sd
    bore = bore_circle(patch, skin, views, cone, outer, pixel_mm)
    row = replace(
        placed,
        countersink_diameter_mm=diameter,
        countersink_diameter_u95_mm=COVERAGE_95 * sd,
        countersink_depth_mm=None if bore is None else cone.depth_at(bore.radius),
        countersink_angle_deg=cone.angle_deg,
    )
    return bore, row

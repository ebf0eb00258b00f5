"""Diameter, place and countersink of open holes; temporary fasteners by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.holes.bore import bore_circle
from metrology.holes.countersink import Countersink, countersink
from metrology.holes.find import Opening, brightness
from metrology.holes.rim import (
    CLOUD_SD_PX,
    DIRECTIONS,
    FALL_MM,
    Edges,
    RimCircle,
    View,
    cloud_edges,
    picture_edges,
    rim_circle,
)
from metrology.results import COVERAGE_95, Hole, HoleKind, RivetDetection, SeamLine
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.patch import Patch, blocked_pixels, cut_patch, point_sets
from metrology.rivets.settings import RivetSettings
from metrology.surfaces import Polynomial

if TYPE_CHECKING:
    from metrology.sighted import Sighted


_ENOUGH = 0.25  # of all directions in which pictures must show a rim; below it the cloud tells
_LEAST_MM = 0.5
_DARK = 0.15  # of the skin's brightness: black paint sends back more than a hole into which no light falls
_PROFILE_PX = 8.0  # of skin beyond the largest radius of a rim
_BORDER_PX = 1.0  # by which a cone's border in pictures may lie off the cloud's, beyond its U95
_SMEAR_PX = 2.5  # to either side of a wall that matching bends
_SHOWN = 0.75  # of all directions in which pictures show the skin's edge
_SHARP_PX = 0.35  # standard deviation of the radius of an edge that is one
_IN_GAP = 1.5  # times a gap's width may a piece of it be wide
_MOST_BROKEN_MM = 0.35  # below the skin does an edge lie that is but broken; a countersink's lies deeper
_WHOLE = 0.9  # of the way to the ground: a cone that is a bent wall goes as far
_BLURRED = 1.25  # times as wide is a bent wall in a blurred picture
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
    """The holes of a scan in which fasteners and seams were looked for."""
    openings = [opening for opening in sighted.openings if not _of_a_gap(opening.ellipse, sighted.lines)]
    return measure_holes(openings, sighted.reconstruction, settings)


def _of_a_gap(ellipse: Ellipse, seams: Sequence[SeamLine]) -> bool:
    """Whether a circle is a piece of a seam's gap: it lies in its band and hardly reaches beyond."""
    for seam in seams:
        off = np.hypot(seam.centre_px[:, 0] - ellipse.u, seam.centre_px[:, 1] - ellipse.v)
        width = seam.width_px[np.argmin(off)]
        if seam.relief and off.min() < 0.5 * width and 2 * ellipse.b < _IN_GAP * width:
            return True
    return False


def _kind(opening: Opening) -> HoleKind:
    """What stands far out of the skin holds two sheets together for a while."""
    if opening.filled:
        return "filled hole"
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
    pixel_mm, within = patch.guard / patch.guard_px, _SIZE * patch.radius
    views = tuple((device, view.texture) for device, view in reconstruction.cameras.values())
    edges = picture_edges(patch, skin, views, pixel_mm, within + _PROFILE_PX * pixel_mm, within + 2 * pixel_mm)
    if opening.filled and opening.inside_mm is not None:
        rim = _rim(edges, patch, height, pixel_mm, -0.5 * opening.inside_mm)
        return _filled(placed, rim, patch, skin, reconstruction, opening.inside_mm)
    rim = _rim(edges, patch, height, pixel_mm)
    cone, axis = _cone(rim, patch, height, pixel_mm, within)
    if cone is not None and rim is not None and _smeared(cone, rim, pixel_mm, opening.inside_mm):
        cone = None
    if cone is None and rim is not None and rim.deeper <= _MOST_BROKEN_MM:
        rim = rim.below_broken_edge
    elif cone is None and rim is not None:
        lies = f"its edge in the pictures lies {rim.deeper:.1f} mm below the skin"
        reason = f"{lies}: a countersink of unknown size, or a shadow"
        return replace(placed, decision="not measured", reason=reason)
    if cone is not None:
        rim, placed = _below(cone, axis, rim, placed, patch, skin, views, pixel_mm, edges.blur_px)
    if rim is None or rim.radius < _LEAST_MM:
        below = "" if cone is None else " below its countersink"
        return replace(placed, decision="not measured", reason=f"no circle follows its rim{below}")
    row = _at(placed, patch.frame.rig([rim.x, rim.y, float(skin.height(rim.x, rim.y))]), reconstruction)
    row = replace(row, diameter_mm=2 * rim.radius, diameter_u95_mm=2 * COVERAGE_95 * rim.radius_sd)
    if opening.inside_mm is None and (share := brightness(opening.ellipse, reconstruction.left.texture)) > _DARK:
        reason = f"nothing was measured inside, yet it is {share:.0%} as bright as the skin: a hole or black paint"
        return replace(row, decision="unconfirmed", reason=reason)
    return replace(row, depth_mm=None if opening.inside_mm is None else -opening.inside_mm)


def _filled(
    placed: Hole, rim: RimCircle | None, patch: Patch, skin: Polynomial, reconstruction: Reconstruction,
    inside_mm: float,
) -> Hole:  # fmt: skip
    """The row of a hole with sealant in it."""
    row = replace(placed, depth_mm=-inside_mm)
    if rim is None or rim.radius < _LEAST_MM or rim.deeper > 0:
        return replace(row, decision="not measured", reason="no circle follows its rim")
    row = _at(row, patch.frame.rig([rim.x, rim.y, float(skin.height(rim.x, rim.y))]), reconstruction)
    return replace(row, diameter_mm=2 * rim.radius, diameter_u95_mm=2 * COVERAGE_95 * rim.radius_sd)


def _at(row: Hole, point: Array, reconstruction: Reconstruction) -> Hole:
    """The row with its place."""
    u, v = reconstruction.rig.left.project(point)
    x, y, z = (float(c) for c in point)
    return replace(row, x_mm=x, y_mm=y, z_mm=z, u_px=float(u), v_px=float(v))


def _smeared(cone: Countersink, rim: RimCircle, pixel_mm: float, inside_mm: float | None) -> bool:
    """Whether a cone is but a bore's wall as matching smears it: pictures show the skin's edge inside its border.

    By more than the border's U95, or by half a pixel where it goes down to the ground, which no countersink should.
    """
    inside = 0.5 * cone.diameter_mm - rim.radius
    shown = rim.directions > _SHOWN * DIRECTIONS and rim.deeper <= 0 and rim.radius_sd < _SHARP_PX * pixel_mm
    to_ground = inside_mm is not None and cone.depth_mm > -_WHOLE * inside_mm
    least = 0.5 * COVERAGE_95 * cone.diameter_sd_mm
    if to_ground:
        least = min(least, 0.5 * pixel_mm)
    narrow = _narrow(cone, pixel_mm * (_BLURRED if to_ground else 1.0))
    return narrow and shown and least < inside < _SMEAR_PX * pixel_mm


def _cone(
    rim: RimCircle | None, patch: Patch, height: Array, pixel_mm: float, within: float
) -> tuple[Countersink | None, tuple[float, float]]:
    """The countersink and its axis: the patch's or, since off its axis a cone is none, the rim's."""
    cone = countersink(np.hypot(patch.x, patch.y), height, pixel_mm, within)
    if cone is not None or rim is None or rim.radius < 4 * _SMEAR_PX * pixel_mm:  # what a wall's blur fills
        return cone, (0.0, 0.0)
    cone = countersink(np.hypot(patch.x - rim.x, patch.y - rim.y), height, pixel_mm, within)
    return None if cone is None or _narrow(cone, pixel_mm) else cone, (rim.x, rim.y)


def _narrow(cone: Countersink, pixel_mm: float) -> bool:
    """Whether a cone is no wider than the blur of a wall in the cloud."""
    return cone.diameter_mm - cone.lower_diameter_mm < 4 * _SMEAR_PX * pixel_mm


def _rim(edges: Edges, patch: Patch, height: Array, pixel_mm: float, fall_mm: float = FALL_MM) -> RimCircle | None:
    """Where the skin ends: in the pictures, else in the cloud, where it has fallen so far."""
    rim = rim_circle(edges, pixel_mm) if edges.directions >= _ENOUGH * DIRECTIONS else None
    return rim or rim_circle(cloud_edges(patch, height, pixel_mm, _SIZE * patch.radius, fall_mm), pixel_mm)


def _below(
    cone: Countersink, axis: tuple[float, float], rim: RimCircle | None, placed: Hole, patch: Patch, skin: Polynomial,
    views: tuple[View, ...], pixel_mm: float, blur_px: float,
) -> tuple[RimCircle | None, Hole]:  # fmt: skip
    """The bore below a countersink, and the row with the countersink: its border of pictures, else of the cloud."""
    diameter, sd = cone.diameter_mm, cone.diameter_sd_mm
    outer = RimCircle(*axis, 0.5 * diameter, 0.5 * sd, 0)
    off = np.inf if rim is None or rim.radius_sd > CLOUD_SD_PX * pixel_mm else abs(2 * rim.radius - diameter)
    if rim is not None and rim.deeper <= 0 and off < COVERAGE_95 * sd + _BORDER_PX * pixel_mm:
        outer, diameter, sd = rim, 2 * rim.radius, 2 * rim.radius_sd
    bore = bore_circle(patch, skin, views, cone, outer, pixel_mm, blur_px)
    row = replace(
        placed,
        countersink_diameter_mm=diameter,
        countersink_diameter_u95_mm=COVERAGE_95 * sd,
        countersink_depth_mm=None if bore is None else cone.depth_at(bore.radius),
        countersink_angle_deg=cone.angle_deg,
    )
    return bore, row

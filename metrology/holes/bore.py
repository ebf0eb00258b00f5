"""The bore below a countersink: of all edges on the cone in both pictures, those that lie on one circle about its axis.

A cone is lit on one side and lies in its own shadow on the other, so the first edge from the skin inwards need not be
the bore's. Shadows and highlights change their radius from direction to direction; the bore does not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from metrology.arrays import Array
from metrology.holes.countersink import Countersink
from metrology.holes.rim import DIRECTIONS, EDGE_SD_PX, Edges, RimCircle, View, leans, rim_circle
from metrology.rivets.bilinear import sample_image
from metrology.rivets.patch import Patch
from metrology.surfaces import Polynomial

_SPACING_PX = 0.25
_CLEAR_PX = 1.5  # of the countersink's border
_INNERMOST = 0.3  # of the countersink's radius: no bore is smaller
_SMOOTH_PX = 0.7  # of the derivative along a profile
_STEEP = 0.06  # of the skin's brightness per pixel: an edge; grain is a third of it
_TOGETHER_PX = 0.75  # within which edges are of one circle, before its own centre is known
_APART = 2  # samples along a profile, at least, between two circles
_AS_GOOD = 0.9  # of the best circle's directions: as well supported
_WORTH = 0.5  # of them, about an axis that may lie off its own: worth a look
_OFF_CONE_MM = 0.6  # by which a circle may seem to lie off the cone; a shadow's edge lies anywhere
_ENOUGH = 0.3  # of all directions in which there must be an edge of it


def bore_circle(
    patch: Patch,
    skin: Polynomial,
    views: tuple[View, ...],
    cone: Countersink,
    outer: RimCircle,
    pixel_mm: float,
    blur_px: float,
) -> RimCircle | None:
    """The circle in which a countersink ends; None where too few edges lie on one.

    Parameters
    ----------
    views : tuple of (Device, texture)
    outer : RimCircle
        Where the countersink meets the skin.
    blur_px : float
        Of the pictures.
    """
    radii = np.arange(outer.radius - _CLEAR_PX * pixel_mm, _INNERMOST * outer.radius, -_SPACING_PX * pixel_mm)
    if len(radii) < 4 / _SPACING_PX:
        return None
    turn = np.asarray(np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS), float)
    x, y = (c + radii * f(turn)[:, None] for c, f in ((outer.x, np.cos), (outer.y, np.sin)))
    # Every sample lies on the cone; only where the cone ends it does not.
    depth = np.array([cone.depth_at(radius) for radius in radii])
    places = patch.frame.rig(np.stack([x, y, skin.height(x, y) - depth], axis=-1))
    which, at, lean = [], [], []
    fall = cone.depth_at(0.0) - cone.depth_at(1.0)
    for device, texture in views:
        directions, positions = _steep_places(sample_image(texture, device.project(places)))
        which.append(directions)
        at.append(np.interp(positions, np.arange(len(radii)), radii))
        sideways = leans(at[-1], turn[directions], patch.frame.local(device.centre))
        lean.append(sideways / (1 - fall * sideways))  # the place on the cone that is seen there lies higher, too
    direction, radius = np.concatenate(which), np.concatenate(at)
    if len(radius) == 0:
        return None
    angle, blur_px = turn[direction], float(np.hypot(blur_px, _SMOOTH_PX))
    x, y = outer.x + radius * np.cos(angle), outer.y + radius * np.sin(angle)
    edges = Edges(x, y, direction, np.concatenate(lean), EDGE_SD_PX, blur_px)
    bore = _outermost(edges, radius, radii, pixel_mm)
    return None if bore is None or abs(bore.deeper) > _OFF_CONE_MM else bore


def _outermost(edges: Edges, radius: Array, radii: Array, pixel_mm: float) -> RimCircle | None:
    """The best supported circle, from the skin inwards, or one about it with as much of a support.

    What lies inside a bore, a shadow on its ground or the ground's border, may be as good a circle. The countersink's
    axis may be a pixel off the bore's: how well a circle is supported is asked about its own centre.
    """
    together = _TOGETHER_PX * pixel_mm
    near = np.abs(radius[:, None] - radii) < together
    supported = np.array([len(np.unique(edges.direction[column])) for column in near.T])
    highest = supported == maximum_filter1d(supported, 2 * _APART + 1)
    circles, support = [], []
    for k in np.flatnonzero(highest & (supported >= max(_WORTH * supported.max(), _ENOUGH * DIRECTIONS))):
        circle = rim_circle(edges.at(near[:, k]), pixel_mm)
        if circle is not None:
            off = np.hypot(edges.x - circle.x, edges.y - circle.y) - circle.radius
            circles.append(circle)
            support.append(len(np.unique(edges.direction[np.abs(off) < together])))
    return next((c for c, n in zip(circles, support, strict=True) if n >= _AS_GOOD * max(support)), None)


def _steep_places(profiles: Array) -> tuple[NDArray[np.int64], Array]:
    """Profile and position (index, between samples) of the places where brightness changes fastest."""
    known = np.flatnonzero(np.isfinite(profiles).all(axis=1))
    level = float(np.median(profiles[known].max(axis=1))) if len(known) else 1.0
    slope = np.abs(gaussian_filter1d(profiles[known] / level, _SMOOTH_PX / _SPACING_PX, axis=1, order=1)) / _SPACING_PX
    peak = (slope == maximum_filter1d(slope, 5, axis=1)) & (slope > _STEEP)
    peak[:, [0, -1]] = False
    row, column = np.nonzero(peak)
    before, here, after = (slope[row, column + k] for k in (-1, 0, 1))
    bend = before - 2 * here + after
    return known[row], column + 0.5 * (before - after) / np.where(bend < 0, bend, -1.0)

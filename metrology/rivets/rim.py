"""A head's rim as both cameras see it: where the head's own edge is, whatever of gap, wall and shadow shows beside it.

Across the rim a camera sees, from head to skin: the head's broken edge, brighter where it leans towards the light; the
head's side wall, where the camera stands on this side of a proud head; the shadow that the head throws on the skin; the
floor of the gap. On the far side a proud head hides what lies behind it. Of a sunk head the skin's edge hides the near
side of the gap, its wall shows on the far side, and the shadow lies inside. With h the head's height, g the gap's
width, and t, l the slopes of the directions to camera and projector along the rim's normal, the brightness steps (in
the plane of the head, as the camera sees it, at distances from the head's edge) are for a proud head

    edge break −e … 0,   wall 0 … ht,   shadow … max(0, ht − hl),   floor … g + ht,

each at least as far out as the one before; for a sunk head the floor ends at g + min(0, hl), the shadow at g, the wall
at g + ht. Slopes are known from the rig and heights from the cloud, so that what is left is one circle, gap and edge
break for both cameras, blurred by a Gaussian. The middle of the dark line alone lies up to a quarter of ht off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.rig import Device
from metrology.rivets.bilinear import sample_image
from metrology.rivets.rim_kernel import BREAK, FLOOR, GAP, RADIUS, SHIFT, UNKNOWNS, fit_rim_kernel
from metrology.surfaces import Frame

_DIRECTIONS = 40
_SPACING_PX = 0.5
_REACH_PX = 3.5  # of the profiles beyond the outermost step that is expected
_ITERATIONS = 14
# Of gaps and edge breaks of countersunk fasteners, mm, and of the brightness of gaps and shadows: mean and spread.
_GAP_MM, _GAP_SPREAD_MM = 0.15, 0.1
_BREAK_MM, _BREAK_SPREAD_MM = 0.08, 0.08
_FLOOR, _FLOOR_SPREAD = 0.3, 0.3
_BLACK, _BLACK_SPREAD = 0.15, 0.07
_BLUR_SPREAD = 0.1  # relative
_BREAK_DARKNESS = 1 - np.sqrt(0.5)  # of an edge broken at 45°
_LEAST_DARKNESS = 0.05  # of a gap that can be seen
_FAR_MM = 1.0  # spread of centre and radius: free
_MOST_SHIFT_PX = 1.0  # from where the ring alone puts the rim, beyond half of what the head hides


@dataclass(frozen=True)
class Circle:
    """A circle on a plane h = const of a frame, mm."""

    x: float
    y: float
    radius: float


def head_circle(
    reconstruction: Reconstruction, frame: Frame, start: Circle, head_height: float, skin_height: float, sigma_px: float
) -> Circle | None:
    """The head's circle from its rim in both textures; None where the rim cannot be followed.

    Parameters
    ----------
    start : Circle
        Where the ring in the left image puts it.
    head_height, skin_height : float
        In the frame at the head's centre, mm.
    sigma_px : float
        Half-width of the ring's image, px.

    Returns
    -------
    Circle
        Centre of the head's edge; the radius reaches to the middle of the dark line, as it would show on a flush head.
    """
    rig = reconstruction.rig
    if rig.screen is None or rig.right is None:  # where the light comes from tells the rim's shadow
        return None
    origin = np.array([start.x, start.y, head_height])
    slopes = np.array([_slope(device, frame, origin) for device in (rig.left, rig.right, rig.screen)])
    height = head_height - skin_height
    hidden = abs(height) * float(np.linalg.norm(slopes[:2], axis=1).max())
    pixel = _pixel_mm(rig.left, frame, origin)
    spacing, reach = _SPACING_PX * pixel, _REACH_PX * pixel
    inside = min(reach + (hidden if height < 0 else 0.0), 0.8 * start.radius)
    distances = np.arange(-inside, _GAP_MM + hidden + reach, spacing)
    turn = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    normals = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    profiles, ends = _profiles(reconstruction, frame, origin, start.radius + distances, normals)
    if not np.isfinite(ends).all():
        return None
    blur = sigma_px * pixel
    expected = np.array([0.0, 0.0, -0.5 * _GAP_MM, _GAP_MM, _BREAK_MM, _FLOOR, _BLACK, blur])
    spread = np.array(
        [_FAR_MM, _FAR_MM, _FAR_MM, _GAP_SPREAD_MM, _BREAK_SPREAD_MM, _FLOOR_SPREAD, _BLACK_SPREAD, _BLUR_SPREAD * blur]
    )
    found = np.empty(UNKNOWNS + 1)
    good = fit_rim_kernel(
        profiles, ends, -inside, spacing, normals, height, slopes[:2], slopes[2], expected, spread, _ITERATIONS, found
    )
    if not good or not np.isfinite(found).all():
        return None
    x, y, outwards = found[SHIFT], found[SHIFT + 1], found[RADIUS] + _ridge(found)
    if max(abs(x), abs(y), abs(outwards)) > 0.5 * hidden + _MOST_SHIFT_PX * pixel:
        return None
    return Circle(start.x + float(x), start.y + float(y), start.radius + float(outwards))


def _profiles(
    reconstruction: Reconstruction, frame: Frame, origin: Array, radii: Array, normals: Array
) -> tuple[Array, Array]:
    """(2, k, m) both textures along normals of a circle, shares of the usual brightness, and (2, k, 2) their ends'."""
    places = np.empty((len(normals), len(radii), 3))
    places[..., :2] = origin[:2] + normals[:, None] * radii[:, None]
    places[..., 2] = origin[2]
    points = frame.rig(places)
    profiles = np.stack(
        [sample_image(view.texture, device.project(points)) for device, view in reconstruction.cameras.values()]
    )
    ends = np.stack([profiles[..., :2].mean(axis=-1), profiles[..., -2:].mean(axis=-1)], axis=-1)
    known = [e[np.isfinite(e)] for e in ends]
    level = np.array([np.median(k) if len(k) else np.nan for k in known])[:, None, None]
    shares = ends / level
    return profiles / level, np.where(np.isnan(shares) & np.isfinite(level), 1.0, shares)


def _ridge(found: Array) -> float:
    """Distance of the dark line's middle from the head's edge if the head were flush, mm."""
    gap = max(1 - found[FLOOR], _LEAST_DARKNESS) * found[GAP]
    edge = _BREAK_DARKNESS * found[BREAK]
    return float(0.5 * (gap * found[GAP] - edge * found[BREAK]) / (gap + edge))


def _slope(device: Device, frame: Frame, origin: Array) -> Array:
    """Lateral over vertical part of the direction from a place in the frame to a device."""
    x, y, h = frame.local(device.centre) - origin
    return np.array([x / h, y / h])


def _pixel_mm(camera: Device, frame: Frame, origin: Array) -> float:
    """Size of a pixel on the head, mm."""
    ends = camera.project(frame.rig(origin + np.array([[0, 0, 0], [1e-2, 0, 0], [0, 1e-2, 0]])))
    return float(1e-2 / np.sqrt(abs(np.linalg.det(ends[1:] - ends[0]))))

"""The cloud round one head, in the head's own frame, and the points of it that may be used (paper Fig. 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Mask
from metrology.cloud import PixelFlag, Reconstruction
from metrology.results import RivetDetection, SeamLine
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.geometry import lay_on_plane
from metrology.rivets.settings import RivetSettings
from metrology.robust import MAD
from metrology.surfaces import Frame, Polynomial, fit_surface

_LEAST_POINTS = 50
_FRAME_POINTS = 400  # are enough for a frame
_DEFAULT_SEAM_PX = 4.0  # width of a seam that tells none
_NEAREST_PX = 4.0  # narrower than a seam with its margin, so that no far side lies so near
_LEAST_PIECE = 0.05  # of the pixels next to the rim; fewer are a corner's
_DEFAULT_RIM_SIGMA_PX = 1.0  # of a head without a visible rim


_OF_POINTS = ("x", "y", "h", "sigma", "u", "v", "usable", "edge")


@dataclass(frozen=True)
class Patch:
    """The cloud round a head, in a frame on the skin with the head's centre as origin."""

    frame: Frame
    radius: float
    """Of the head, mm."""
    guard: float
    guard_px: float
    """guard, guard_px: distance from the rim that points keep, mm and pixels."""
    x: Array
    y: Array
    h: Array
    sigma: Array
    """x, y, h, sigma: (n,): local coordinates and σ of h, mm."""
    u: NDArray[np.int64]
    v: NDArray[np.int64]
    """u, v: (n,) of int: pixels of the points."""
    usable: Mask
    """(n,): neither on a seam, beyond one, nor on a neighbour."""
    edge: Mask
    """(n,): flagged as beside a reflectance or depth edge."""

    def surface(
        self, members: Mask, order: int, generator: np.random.Generator, scale: float | None = None
    ) -> Polynomial | None:
        """Surface through some of the points, see `fit_surface`."""
        x, y, h, sigma = (a[members] for a in (self.x, self.y, self.h, self.sigma))
        return fit_surface(x, y, h, sigma, order, generator, scale=scale)

    def at(self, members: Mask) -> Patch:
        """Some of the points."""
        return replace(self, **{name: getattr(self, name)[members] for name in _OF_POINTS})


def ellipse_of(detection: RivetDetection) -> Ellipse:
    """The detection's ellipse with semi-axes and radians."""
    return Ellipse.of(
        [
            detection.u_px,
            detection.v_px,
            detection.major_px / 2,
            detection.minor_px / 2,
            np.radians(detection.angle_deg),
        ]
    )


def blocked_pixels(reconstruction: Reconstruction) -> Mask:
    """(h, w) pixels without a trustworthy point."""
    return ~reconstruction.valid | ((reconstruction.flags & np.uint16(PixelFlag.SLOPE)) != 0)


def saturated_share(detection: RivetDetection, reconstruction: Reconstruction) -> float:
    """Share of a head's pixels that are saturated in every exposure."""
    ellipse = ellipse_of(detection)
    window = _window(ellipse, ellipse.a, reconstruction.flags.shape)
    v, u = np.mgrid[window]
    flags = reconstruction.flags[window][ellipse.level(u, v) < 1]
    return float(((flags & np.uint16(PixelFlag.SATURATED)) != 0).mean()) if flags.size else 0.0


def seam_pixels(seams: Sequence[SeamLine], size: tuple[int, ...], margin_px: float) -> Mask:
    """(h, w) pixels on a seam or within a margin of it."""
    band = np.zeros(size, np.uint8)
    for seam in seams:
        known = seam.width_px[np.isfinite(seam.width_px)]
        usual = float(np.median(known)) if len(known) else _DEFAULT_SEAM_PX
        for (u, v), width in zip(seam.centre_px, seam.width_px, strict=True):
            half = 0.5 * (float(width) if np.isfinite(width) else usual)
            cv2.circle(band, (round(float(u)), round(float(v))), int(np.ceil(half + margin_px)), 1, -1)
    return band > 0


def cut_patch(
    detection: RivetDetection,
    others: Sequence[RivetDetection],
    reconstruction: Reconstruction,
    blocked: Mask,
    on_seam: Mask,
    settings: RivetSettings,
) -> Patch | str:
    """The cloud round a head; a reason where there is none.

    Parameters
    ----------
    others : sequence of RivetDetection
        Neighbours, whose heads are cut out.
    blocked, on_seam : (h, w) bool
        See `blocked_pixels` and `seam_pixels`.
    """
    ellipse = ellipse_of(detection)
    scale = _pixels_per_mm(reconstruction, ellipse)
    if scale is None:
        return "no points at the head"
    sigma_px = detection.rim_sigma_px if detection.rim_sigma_px is not None else _DEFAULT_RIM_SIGMA_PX
    guard_px = settings.guard_px + settings.guard_sigmas * sigma_px
    reach = outer_radius(ellipse.radius / scale, settings) * scale * ellipse.a / ellipse.radius + 4
    window = _window(ellipse, reach, blocked.shape)
    v, u = np.nonzero(np.isfinite(reconstruction.points[window][..., 2]))
    v0, u0 = window[0].start, window[1].start
    u, v = u + u0, v + v0
    level = ellipse.level(u, v)
    near = level * ellipse.a < reach
    u, v, level = u[near], v[near], level[near]
    cloud = reconstruction.points[v, u].astype(float)
    usable = ~blocked[v, u] & _this_side_of_seams(on_seam[window], ellipse, window, guard_px)[v - v0, u - u0]
    for other in map(ellipse_of, others):
        if np.hypot(other.u - ellipse.u, other.v - ellipse.v) < reach + other.a:
            usable &= (other.level(u, v) - 1) * other.b > guard_px
    edge = (reconstruction.flags[v, u] & np.uint16(PixelFlag.EDGE)) != 0
    skin = usable & ((level - 1) * ellipse.b > guard_px)
    if skin.sum() < _LEAST_POINTS:
        return f"skin: {int(skin.sum())} usable points, at least {_LEAST_POINTS} needed"
    # A seam or the panel's border is farther away than the nearer half of the skin.
    nearest = np.flatnonzero(skin)[:: max(1, int(skin.sum()) // (2 * _FRAME_POINTS))]
    frame = _skin_frame(cloud[nearest[level[nearest] <= np.median(level[nearest])]])
    x, y, radius = lay_on_plane(reconstruction.rig.left, ellipse, frame)
    frame = Frame(frame.rig([x, y, 0.0]), frame.axes)
    local = frame.local(cloud)
    sigma = frame.height_sigma(cloud, reconstruction.sigma_z[v, u])
    usable &= np.isfinite(sigma) & (sigma > 0)
    x, y, h = local.T
    return Patch(frame, radius, guard_px / scale, guard_px, x, y, h, sigma, u, v, usable, edge)


def outer_radius(radius_mm: float, settings: RivetSettings) -> float:
    """Outer radius of the skin's annulus, mm."""
    return max(settings.outer_radii[1] * radius_mm, radius_mm + settings.min_outer_width_mm)


def set_radii(patch: Patch, settings: RivetSettings) -> tuple[float, tuple[float, float]]:
    """Within which distance of the centre the head's points lie, and between which the skin's, mm."""
    inner = max(min(settings.inner_radius * patch.radius, patch.radius - patch.guard), 0.5 * patch.radius)
    start = max(settings.outer_radii[0] * patch.radius, patch.radius + patch.guard)
    return inner, (start, outer_radius(patch.radius, settings))


def point_sets(patch: Patch, settings: RivetSettings) -> tuple[Mask, Mask]:
    """Points of head and skin, (n,) bool each.

    Both keep the guard from the rim; the inner set of a very small head keeps at least half its radius. Points flagged
    as beside an edge are left out, but where most are flagged, it is the metal's grain that is taken for edges: then
    they stay, and the guard alone keeps the rim away.
    """
    r = np.hypot(patch.x, patch.y)
    inner, (start, end) = set_radii(patch, settings)
    sets = []
    for members in (r < inner, (r > start) & (r < end)):
        points = patch.usable & members
        clear = points & ~patch.edge
        sets.append(clear if clear.sum() > settings.min_clear_share * points.sum() else points)
    return sets[0], sets[1]


def _this_side_of_seams(on_seam: Mask, ellipse: Ellipse, window: tuple[slice, slice], guard_px: float) -> Mask:
    """(h, w) pixels of a window that no seam parts from the head.

    Of the pieces into which seams divide the window those count that come as near to the rim as the guard allows.
    """
    if not on_seam.any():
        return ~on_seam
    _, piece = cv2.connectedComponents((~on_seam).astype(np.uint8), connectivity=4)
    v, u = np.mgrid[window]
    beyond = (ellipse.level(u, v) - 1) * ellipse.b - guard_px
    here = np.bincount(piece[(beyond > 0) & (beyond < _NEAREST_PX) & ~on_seam], minlength=int(piece.max()) + 1)
    return np.asarray((here > _LEAST_PIECE * here.sum())[piece] & ~on_seam)


def _window(ellipse: Ellipse, reach: float, size: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns within `reach` of an ellipse's centre."""
    rows = slice(max(0, int(ellipse.v - reach)), max(0, min(size[0], int(ellipse.v + reach) + 2)))
    columns = slice(max(0, int(ellipse.u - reach)), max(0, min(size[1], int(ellipse.u + reach) + 2)))
    return rows, columns


def _pixels_per_mm(reconstruction: Reconstruction, ellipse: Ellipse) -> float | None:
    """Scale at a head from the distance of the points there: focal length over depth."""
    z = reconstruction.points[_window(ellipse, 1.3 * ellipse.a, reconstruction.points.shape)][..., 2]
    z = z[np.isfinite(z)]
    if len(z) == 0:
        return None
    K = reconstruction.rig.left.K
    return float(np.sqrt(K[0, 0] * K[1, 1]) / np.median(z))


def _skin_frame(points: Array) -> Frame:
    """Frame on the plane that most points share."""
    keep = np.ones(len(points), bool)
    frame = Frame(points.mean(axis=0), np.eye(3))
    for _ in range(2):
        centre = points[keep].mean(axis=0)
        normal = np.linalg.eigh(np.cov((points[keep] - centre).T))[1][:, 0]
        frame = Frame.on_plane(centre, normal)
        h = np.abs(frame.local(points)[:, 2])
        keep = h < 3 * MAD * np.median(h) + 1e-9
    return frame

"""Flushness of rivet heads from the cloud (paper §4.1): height, tilt and crown against the skin, with uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import PixelFlag, Reconstruction
from metrology.results import Rivet, RivetDetection, SeamLine
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.geometry import lay_on_plane
from metrology.rivets.settings import RivetSettings
from metrology.surfaces import Frame, Polynomial, fit_surface

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Patch:
    """The cloud round a head, in a frame on the skin with the head's centre as origin.

    Attributes
    ----------
    frame : Frame
    radius : float
        Of the head, mm.
    pixels_per_mm : float
    x, y, h, sigma : (n,) ndarray
        Local coordinates and σ of h, mm.
    u, v : (n,) ndarray of int
        Pixels of the points.
    usable : (n,) bool
        Not flagged, and neither on a seam nor on a neighbour.
    """

    frame: Frame
    radius: float
    pixels_per_mm: float
    x: Array
    y: Array
    h: Array
    sigma: Array
    u: NDArray[np.int64]
    v: NDArray[np.int64]
    usable: Mask

    @property
    def distance(self) -> Array:
        """(n,) distance from the centre along the skin, mm."""
        return np.hypot(self.x, self.y)


@dataclass(frozen=True)
class PointSets:
    """Inner and outer points of a head (paper Fig. 4)."""

    inner: Mask
    outer: Mask


@dataclass(frozen=True)
class Fits:
    """The head's and the skin's surfaces in the patch's frame."""

    patch: Patch
    sets: PointSets
    head: Polynomial
    skin: Polynomial


def measure_rivets(
    detections: Sequence[RivetDetection],
    reconstruction: Reconstruction,
    seams: Sequence[SeamLine] = (),
    settings: RivetSettings | None = None,
    generator: np.random.Generator | None = None,
) -> list[Rivet]:
    """Measure every detected rivet.

    Parameters
    ----------
    detections : sequence of RivetDetection
    reconstruction : Reconstruction
    seams : sequence of SeamLine
        Cut out of the skin round a head.
    settings : RivetSettings
    generator : numpy.random.Generator
        Draws the RANSAC samples; the same seed each time without it.

    Returns
    -------
    list of Rivet
        In the order of the detections, numbered R01 …; what could not be measured is None, with the reason.
    """
    settings = settings or RivetSettings()
    generator = generator or np.random.default_rng(0)
    blocked = _blocked(reconstruction, seams, settings)
    ellipses = [_ellipse(d) for d in detections]
    outcomes: list[Fits | str] = []
    for k, detection in enumerate(detections):
        neighbours = ellipses[:k] + ellipses[k + 1 :]
        outcomes.append(_fit(detection, neighbours, reconstruction, blocked, settings, generator))
    inflation = _correlation([f for f in outcomes if isinstance(f, Fits)])
    return [
        _row(f"R{k + 1:02d}", detection, outcome, reconstruction, inflation, settings)
        for k, (detection, outcome) in enumerate(zip(detections, outcomes, strict=True))
    ]


def _ellipse(d: RivetDetection) -> Ellipse:
    return Ellipse.of([d.u_px, d.v_px, d.major_px / 2, d.minor_px / 2, np.radians(d.angle_deg)])


def _blocked(reconstruction: Reconstruction, seams: Sequence[SeamLine], settings: RivetSettings) -> Mask:
    """(h, w) pixels without a trustworthy point, or on a seam and its margin."""
    import cv2

    doubtful = np.uint16(PixelFlag.EDGE | PixelFlag.SLOPE)
    blocked = ~reconstruction.valid | ((reconstruction.flags & doubtful) != 0)
    band = np.zeros(blocked.shape, np.uint8)
    for seam in seams:
        widths = np.where(
            np.isfinite(seam.width_px),
            seam.width_px,
            np.nanmedian(seam.width_px) if np.isfinite(seam.width_px).any() else 4.0,
        )
        for (u, v), width in zip(seam.centre_px, widths, strict=True):
            cv2.circle(
                band, (round(float(u)), round(float(v))), int(np.ceil(width / 2 + settings.seam_margin_px)), 1, -1
            )
    return blocked | (band > 0)


def _fit(
    detection: RivetDetection,
    neighbours: list[Ellipse],
    reconstruction: Reconstruction,
    blocked: Mask,
    settings: RivetSettings,
    generator: np.random.Generator,
) -> Fits | str:
    """Head and skin of one rivet, or why they cannot be had."""
    patch = _patch(detection, neighbours, reconstruction, blocked, settings)
    if isinstance(patch, str):
        return patch
    sets = _point_sets(patch, detection, settings)
    for name, members, least in (("head", sets.inner, settings.min_inner), ("skin", sets.outer, settings.min_outer)):
        if members.sum() < least:
            return f"{name}: {int(members.sum())} usable points, at least {least} needed"
    if _sectors(patch, sets.outer) < settings.min_sectors:
        return f"skin: points in {_sectors(patch, sets.outer)} of 12 directions, at least {settings.min_sectors} needed"
    order = 2 if settings.reference == "quadric" else 1
    skin = _surface(patch, sets.outer, order, generator)
    head = _surface(patch, sets.inner, 1, generator)
    if skin is None or head is None:
        return "points lie too unevenly for a surface"
    return Fits(patch, sets, head, skin)


def _surface(patch: Patch, members: Mask, order: int, generator: np.random.Generator) -> Polynomial | None:
    return fit_surface(patch.x[members], patch.y[members], patch.h[members], patch.sigma[members], order, generator)


def _sectors(patch: Patch, members: Mask) -> int:
    """Directions, of twelve, in which there are points."""
    sector = ((np.arctan2(patch.y[members], patch.x[members]) + np.pi) / (2 * np.pi) * 12).astype(int) % 12
    return int((np.bincount(sector, minlength=12) > 5).sum())


def _patch(
    detection: RivetDetection,
    neighbours: list[Ellipse],
    reconstruction: Reconstruction,
    blocked: Mask,
    settings: RivetSettings,
) -> Patch | str:
    """The cloud round a head in the head's own frame."""
    ellipse = _ellipse(detection)
    height, width = blocked.shape
    points = reconstruction.points
    scale = _pixels_per_mm(reconstruction, ellipse)
    if scale is None:
        return "no points at the head"
    reach = _outer_radius(ellipse.radius / scale, settings) * scale * ellipse.a / ellipse.radius + 4
    u0, u1 = max(0, int(ellipse.u - reach)), min(width, int(ellipse.u + reach) + 2)
    v0, v1 = max(0, int(ellipse.v - reach)), min(height, int(ellipse.v + reach) + 2)
    v, u = np.mgrid[v0:v1, u0:u1]
    window = np.s_[v0:v1, u0:u1]
    valid = reconstruction.valid[window]
    if valid.sum() < 50:
        return f"{int(valid.sum())} points at the head, at least 50 needed"
    u, v = u[valid], v[valid]
    cloud = points[window][valid].astype(float)
    usable = ~blocked[window][valid]
    level = ellipse.level(u, v)
    skin = usable & (level > 1.15) if (usable & (level > 1.15)).sum() > 50 else usable
    if skin.sum() < 50:
        return f"{int(skin.sum())} usable points round the head, at least 50 needed"
    frame = _skin_frame(cloud[skin])
    x, y, radius = lay_on_plane(reconstruction.rig.left, ellipse, frame)
    frame = Frame(frame.rig([x, y, 0.0]), frame.axes)
    for other in neighbours:
        if np.hypot(other.u - ellipse.u, other.v - ellipse.v) < reach + other.a:
            margin = settings.guard_px + _ring_sigma(detection) * settings.guard_sigmas
            usable &= (other.level(u, v) - 1) * other.b > margin
    local = frame.local(cloud)
    sigma = frame.height_sigma(cloud, reconstruction.sigma_z[window][valid])
    usable &= np.isfinite(sigma) & (sigma > 0)
    return Patch(frame, radius, scale, local[:, 0], local[:, 1], local[:, 2], sigma, u, v, usable)


def _ring_sigma(detection: RivetDetection) -> float:
    """Half-width of the rim's image, px; a pixel where the detection does not tell."""
    return detection.rim_sigma_px if detection.rim_sigma_px is not None else 1.0


def _pixels_per_mm(reconstruction: Reconstruction, ellipse: Ellipse) -> float | None:
    """Scale at a head from the distance of the points there: focal length over depth."""
    reach = 1.3 * ellipse.a
    height, width = reconstruction.valid.shape
    u0, u1 = max(0, int(ellipse.u - reach)), min(width, int(ellipse.u + reach) + 1)
    v0, v1 = max(0, int(ellipse.v - reach)), min(height, int(ellipse.v + reach) + 1)
    z = reconstruction.points[v0:v1, u0:u1, 2]
    z = z[np.isfinite(z)]
    if len(z) == 0:
        return None
    K = reconstruction.rig.left.K
    return float(np.sqrt(K[0, 0] * K[1, 1]) / np.median(z))


def _outer_radius(radius_mm: float, settings: RivetSettings) -> float:
    return max(settings.outer_radii[1] * radius_mm, radius_mm + settings.min_outer_width_mm)


def _skin_frame(points: Array) -> Frame:
    """Frame on the plane that most points share."""
    keep = np.ones(len(points), bool)
    frame = Frame(points.mean(axis=0), np.eye(3))
    for _ in range(3):
        centre = points[keep].mean(axis=0)
        _, _, axes = np.linalg.svd(points[keep] - centre, full_matrices=False)
        frame = Frame.on_plane(centre, axes[2])
        h = np.abs(frame.local(points)[:, 2])
        keep = h < 3 * 1.4826 * np.median(h) + 1e-9
    return frame


def _point_sets(patch: Patch, detection: RivetDetection, settings: RivetSettings) -> PointSets:
    """Points of head and skin, clear of the rim by the guard where the head is large enough for it."""
    guard = (settings.guard_px + settings.guard_sigmas * _ring_sigma(detection)) / patch.pixels_per_mm
    r = patch.distance
    inner_radius = max(min(settings.inner_radius * patch.radius, patch.radius - guard), 0.5 * patch.radius)
    inner = patch.usable & (r < inner_radius)
    start = max(settings.outer_radii[0] * patch.radius, patch.radius + guard)
    outer = patch.usable & (r > start) & (r < _outer_radius(patch.radius, settings))
    return PointSets(inner, outer)


def _correlation(fits: list[Fits], block: int = 8) -> float:
    """Variance of means over blocks of pixels against that of independent residuals, pooled over all heads.

    Matching averages neighbouring pixels, so their errors are alike; a mean over n points then errs more than σ/√n.
    """
    observed = expected = 0.0
    for fit in fits:
        p = fit.patch
        for members, surface in ((fit.sets.inner, fit.head), (fit.sets.outer, fit.skin)):
            keep = surface.weights > 0
            x, y, h, sigma = (a[members][keep] for a in (p.x, p.y, p.h, p.sigma))
            residual = (h - surface.height(x, y)) / sigma
            cell = (p.v[members][keep] // block) * 10000 + p.u[members][keep] // block
            _, where, count = np.unique(cell, return_inverse=True, return_counts=True)
            sums = np.bincount(where, residual)
            full = count > 0.6 * block**2
            observed += float((sums[full] ** 2).sum())
            expected += float((count[full]).sum()) * float(np.mean(residual**2))
    return max(1.0, observed / expected) if expected > 0 else 1.0


def _row(
    rivet_id: str,
    detection: RivetDetection,
    outcome: Fits | str,
    reconstruction: Reconstruction,
    inflation: float,
    settings: RivetSettings,
) -> Rivet:
    found = {
        "rivet_id": rivet_id,
        "major_px": detection.major_px,
        "minor_px": detection.minor_px,
        "angle_deg": detection.angle_deg,
        "confidence": detection.confidence,
    }
    if isinstance(outcome, str):
        return Rivet(
            **found,
            u_px=detection.u_px,
            v_px=detection.v_px,
            u_right_px=detection.u_right_px,
            v_right_px=detection.v_right_px,
            x_mm=None,
            y_mm=None,
            z_mm=None,
            diameter_mm=None,
            decision="not measured",
            reason=outcome,
        )
    p, rig = outcome.patch, reconstruction.rig
    head, skin = outcome.head.tangent(0.0, 0.0), outcome.skin.tangent(0.0, 0.0)
    # The rim's image is that of the gap, half-way between head and skin.
    middle = 0.5 * (head[0][0] + skin[0][0])
    x, y, radius = lay_on_plane(rig.left, _ellipse(detection), p.frame, middle)
    (h1, a1, b1), head_cov = outcome.head.tangent(x, y)
    (h0, a0, b0), skin_cov = outcome.skin.tangent(x, y)
    centre = p.frame.rig([x, y, h1])
    left, right = rig.left.project(centre), rig.right.project(centre)
    height = (h1 - h0) / np.sqrt(1 + a0**2 + b0**2)
    n1, n0 = np.array([-a1, -b1, 1.0]), np.array([-a0, -b0, 1.0])
    cosine = n1 @ n0 / np.linalg.norm(n1) / np.linalg.norm(n0)
    tilt = float(np.arccos(np.clip(cosine, -1, 1)))
    covariance = (head_cov + skin_cov) * inflation
    slope = np.array([a1 - a0, b1 - b0])
    norm = float(np.linalg.norm(slope))
    direction = slope / norm if norm > 0 else np.array([1.0, 0.0])
    tilt_sd = float(np.sqrt(direction @ covariance[1:, 1:] @ direction))
    rise = radius * np.tan(tilt)
    return Rivet(
        **found,
        u_px=float(left[0]),
        v_px=float(left[1]),
        u_right_px=float(right[0]),
        v_right_px=float(right[1]),
        x_mm=float(centre[0]),
        y_mm=float(centre[1]),
        z_mm=float(centre[2]),
        diameter_mm=2 * radius,
        height_mean_mm=float(height),
        height_min_mm=float(height - rise),
        height_max_mm=float(height + rise),
        height_u95_mm=float(1.96 * np.sqrt(covariance[0, 0])),
        tilt_deg=float(np.degrees(tilt)),
        tilt_u95_deg=float(np.degrees(1.96 * tilt_sd)),
        n_inner=int((outcome.head.weights > 0).sum()),
        n_outer=int((outcome.skin.weights > 0).sum()),
        rms_inner_mm=outcome.head.rms_mm,
        rms_outer_mm=outcome.skin.rms_mm,
    )

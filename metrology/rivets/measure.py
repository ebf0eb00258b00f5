"""Flushness of rivet heads from the cloud (paper §4.1): height, tilt and crown against the skin, with uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import count

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.fits import FittedRivet, HeadFit
from metrology.plausibility import plausible_rivet
from metrology.results import COVERAGE_95, Rivet, RivetDetection, SeamLine
from metrology.rivets.controls import control_places
from metrology.rivets.creases import creased_skin
from metrology.rivets.fits import Fits
from metrology.rivets.flushness import Flushness, flushness
from metrology.rivets.geometry import lay_on_plane
from metrology.rivets.head import head_surface
from metrology.rivets.inflation import Inflation, noise_inflation
from metrology.rivets.one_sided import head_from_one_side
from metrology.rivets.patch import (
    Patch,
    blocked_pixels,
    cut_patch,
    ellipse_of,
    point_sets,
    saturated_share,
    seam_pixels,
    set_radii,
)
from metrology.rivets.rim import Circle, head_circle
from metrology.rivets.settings import RivetSettings
from metrology.surfaces import Polynomial

_DIRECTIONS = 12
# Of a head that is too bright, points are left where it is darkest: in its recess. From this share of it on they are
# not taken for the head.
_MOST_SATURATED = 0.5


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
    seams : sequence of SeamLine
        Cut out of the skin round a head.
    generator : numpy.random.Generator
        Draws the RANSAC samples and the control places; the same seed each time without it.

    Returns
    -------
    list of Rivet
        In the order of the detections, numbered R01 …, and X01 … what is in doubt; what could not be measured is None,
        with the reason.
    """
    settings = settings or RivetSettings()
    generator = generator or np.random.default_rng(0)
    blocked = blocked_pixels(reconstruction)
    on_seam = seam_pixels(seams, blocked.shape, settings.seam_margin_px)

    def fit(detection: RivetDetection, others: Sequence[RivetDetection], bare: bool = False) -> Fits | str:
        if not bare and (share := saturated_share(detection, reconstruction)) > _MOST_SATURATED:
            return f"head: {share:.0%} of it is saturated; take a shorter exposure as well"
        patch = cut_patch(detection, others, reconstruction, blocked, on_seam, settings)
        return patch if isinstance(patch, str) else _fit(patch, bare, settings, generator)

    outcomes = [fit(d, [o for o in detections if o is not d]) for d in detections]
    places = control_places(detections, blocked | on_seam, settings.controls, generator)
    controls = [c for c in (fit(p, detections, bare=True) for p in places) if isinstance(c, Fits)]
    fits = [f for f in outcomes if isinstance(f, Fits)]
    inflation = noise_inflation(fits, controls)
    return [
        plausible_rivet(_row(name, detection, outcome, reconstruction, inflation, settings, generator))
        for name, detection, outcome in zip(_names(detections), detections, outcomes, strict=True)
    ]


def _names(detections: Sequence[RivetDetection]) -> list[str]:
    """R01, R02 … for fasteners; X01, X02 … for what a person must confirm first."""
    counts = {"R": count(1), "X": count(1)}
    letters = ["X" if detection.doubt else "R" for detection in detections]
    return [f"{letter}{next(counts[letter]):02d}" for letter in letters]


def _fit(patch: Patch, bare: bool, settings: RivetSettings, generator: np.random.Generator) -> Fits | str:
    """Head and skin of one patch, or why they cannot be had; a bare patch has skin where the head would be."""
    inner, outer = point_sets(patch, settings)
    for name, members, least in (("head", inner, settings.min_inner), ("skin", outer, settings.min_outer)):
        if members.sum() < least:
            return f"{name}: {int(members.sum())} usable points, at least {least} needed"
    directions = _directions(patch, outer)
    if directions < settings.min_sectors:
        return f"skin: points in {directions} of {_DIRECTIONS} directions, at least {settings.min_sectors} needed"
    skin = patch.surface(outer, 2 if settings.reference == "quadric" else 1, generator)
    if skin is None:
        return "points lie too unevenly for a surface"
    if not bare:
        found = head_surface(patch, inner, skin, settings, generator)
        return found if isinstance(found, str) else Fits(patch, found[1], outer, found[0], skin)
    # Bare skin goes on bending where a head would be flat.
    h, by_x, by_y = skin.tangent(0.0, 0.0)[0]
    bend = skin.height(patch.x, patch.y) - (h + by_x * patch.x + by_y * patch.y)
    patch = replace(patch, h=np.where(inner, patch.h - bend, patch.h))
    plane = patch.surface(inner, 1, generator)
    return "points lie too unevenly for a surface" if plane is None else Fits(patch, inner, outer, plane, skin)


def _directions(patch: Patch, members: NDArray[np.bool_]) -> int:
    """Directions, of twelve, in which there are points."""
    turn = (np.arctan2(patch.y[members], patch.x[members]) + np.pi) / (2 * np.pi)
    return int((np.bincount((turn * _DIRECTIONS).astype(int) % _DIRECTIONS, minlength=_DIRECTIONS) > 5).sum())


def _row(
    rivet_id: str,
    detection: RivetDetection,
    outcome: Fits | str,
    reconstruction: Reconstruction,
    inflation: Inflation,
    settings: RivetSettings,
    generator: np.random.Generator,
) -> Rivet:
    """The table's row of a rivet."""
    empty = FittedRivet(
        rivet_id=rivet_id,
        x_mm=None,
        y_mm=None,
        z_mm=None,
        u_px=detection.u_px,
        v_px=detection.v_px,
        u_right_px=detection.u_right_px,
        v_right_px=detection.v_right_px,
        diameter_mm=None,
        major_px=detection.major_px,
        minor_px=detection.minor_px,
        angle_deg=detection.angle_deg,
        confidence=detection.confidence,
        decision="unconfirmed" if detection.doubt else "not measured",
        reason=detection.doubt,
        found_by=detection.found_by,
    )
    if isinstance(outcome, str):
        return replace(empty, reason="; ".join(part for part in (detection.doubt, outcome) if part))
    p, rig = outcome.patch, reconstruction.rig
    head = head_from_one_side(outcome, inflation)
    skin = creased_skin(outcome, inflation) if settings.reference == "quadric" else outcome.skin
    circle = _circle(detection, outcome, head, reconstruction)
    x, y = circle.x, circle.y
    f: Flushness = flushness(head, skin, x, y, circle.radius, inflation.height, inflation.slope)
    centre = p.frame.rig([x, y, float(head.height(x, y))])
    left = rig.left.project(centre)
    u_right, v_right = (None, None) if rig.right is None else map(float, rig.right.project(centre))
    return replace(
        empty,
        u_px=float(left[0]),
        v_px=float(left[1]),
        u_right_px=u_right,
        v_right_px=v_right,
        x_mm=float(centre[0]),
        y_mm=float(centre[1]),
        z_mm=float(centre[2]),
        diameter_mm=2 * circle.radius,
        diameter_u95_mm=_diameter_u95(detection, p.guard / p.guard_px),
        height_mean_mm=f.mean,
        height_min_mm=f.low,
        height_max_mm=f.high,
        height_u95_mm=COVERAGE_95 * f.mean_sd,
        tilt_deg=float(np.degrees(f.tilt)),
        tilt_u95_deg=float(np.degrees(COVERAGE_95 * f.tilt_sd)),
        crown_mm=f.crown if head.order == 2 else None,
        n_inner=int((head.weights > 0).sum()),
        n_outer=int((skin.weights > 0).sum()),
        rms_inner_mm=head.rms_mm,
        rms_outer_mm=skin.rms_mm,
        decision="unconfirmed" if detection.doubt else "no limit",
        fit=HeadFit(p.frame, skin.coefficients, head.coefficients, x, y, circle.radius, *set_radii(p, settings)),
    )


def _diameter_u95(detection: RivetDetection, pixel_mm: float) -> float | None:
    """Expanded uncertainty of a head's diameter, mm: of the ring's fit, and that its edge lies somewhere in the ring.

    Dirt, paint and wear widen the dark line or move its middle, at most to its border.
    """
    of_axes = 0.5 * float(np.sqrt(detection.covariance[2, 2] + detection.covariance[3, 3]))
    line = detection.rim_sigma_px if detection.rim_sigma_px is not None else 0.0
    return pixel_mm * float(np.hypot(COVERAGE_95 * of_axes, line)) if np.isfinite(of_axes) else None


def _circle(detection: RivetDetection, fits: Fits, head: Polynomial, reconstruction: Reconstruction) -> Circle:
    """The head's circle: from its rim in both images where that can be followed, else from the ring in the left one.

    The ring's image is that of the gap, half-way between head and skin.
    """
    frame = fits.patch.frame
    top, skin = float(head.height(0.0, 0.0)), float(fits.skin.height(0.0, 0.0))
    ring = Circle(*lay_on_plane(reconstruction.rig.left, ellipse_of(detection), frame, 0.5 * (top + skin)))
    if detection.rim_sigma_px is None:
        return ring
    return head_circle(reconstruction, frame, ring, top, skin, detection.rim_sigma_px) or ring

"""Cross-sections of a seam: a plane across it at each station, and the two skin lines in that plane (paper §4.2,
Fig. 7).

The points within ε_d of the plane are projected onto it, and each side gets its line (`skin_lines`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from metrology.arrays import Array, Mask
from metrology.cloud import MISSING, PixelFlag, Reconstruction
from metrology.fits import SkinLine
from metrology.jit import kernel
from metrology.seams.skins.other_seams import beyond
from metrology.seams.skins.skin_lines import SkinFit, fit_skin_lines
from metrology.surfaces import Frame

# The frame is turned into the skin on every so many points.
_SPARSE = 4
# Skin lies this near to the frame's plane, and while the frame is being turned into it.
_SKIN_BAND_MM = 3.0
_TURNING_BANDS_MM = (6.0, 3.0)
_BY_CHANCE = 2.0  # standard deviations that slopes differ by chance


@dataclass(frozen=True)
class Section:
    """A section plane with both skin lines."""

    frame: Frame
    """x across the seam from side A to side B, y along it, h along the skins' normal towards the rig."""
    a: SkinLine
    b: SkinLine
    covariance: Array
    """(5, 5): of a's c_0, c_1, b's c_0, c_1 and the common c_2."""
    clumping: float
    """By how much sums of neighbouring points' errors vary more than independent points' would."""
    stretches: Array = field(default_factory=lambda: np.zeros(8))
    """(8,): those sums, see `SkinFit`."""
    misfit: Array = field(default_factory=lambda: np.zeros((3, 8)))
    """(3, 8): how the points lie beside the lines, see `SkinFit`."""
    own_curvatures_step: float = 0.0
    """By how much the step would be another if each side had a curvature of its own, mm."""
    twist_step: float = 0.0
    """By how much it would be another if the sides' slopes along the seam differed by a twist of the skin, mm."""

    def point(self, x: float, h: float, y: float = 0.0) -> Array:
        """(3,) rig-frame point of section coordinates."""
        return self.frame.rig(np.array([x, y, h]))

    def midpoint(self, a: float, b: float) -> Array:
        """(3,) rig-frame midpoint of the ideal edges at x = a and x = b."""
        return np.asarray(0.5 * (self.point(a, self.a.height(a)) + self.point(b, self.b.height(b))))


def usable_points(reconstruction: Reconstruction) -> Mask:
    """(h, w) pixels whose points may carry a skin line: present, and not mixed across an edge."""
    doubtful = reconstruction.flags & np.uint16(MISSING | PixelFlag.EDGE)
    return reconstruction.valid & (doubtful == 0)


def strip(
    reconstruction: Reconstruction, usable: Mask, centre_px: Array, frame: Frame, half_length: float, extent: float,
    every: int = 1,
) -> Array:  # fmt: skip
    """Points near a section plane.

    Parameters
    ----------
    usable : (h, w) ndarray of bool
    centre_px : (2,) ndarray
        Where the left image shows the frame's origin.
    half_length : float
        ε_d, mm.
    extent : float
        Largest |x|, mm.
    every : int
        Only pixels on every so many diagonals (u + v) are taken.

    Returns
    -------
    (n, 5) ndarray
        x, y, h, σ_h and the pixel's index into the flattened image.
    """
    rig = reconstruction.rig
    reach = np.array([[extent, half_length, 0], [-extent, half_length, 0], [extent, -half_length, 0]])
    corners = rig.left.project(frame.rig(np.concatenate([reach, -reach]))) - centre_px
    radius = np.ceil(np.abs(corners).max(axis=0)).astype(np.int64) + 2
    found: Array = _strip(
        reconstruction.points,
        reconstruction.sigma_z,
        usable,
        centre_px,
        radius,
        frame.origin,
        np.ascontiguousarray(frame.axes),
        half_length,
        extent,
        every,
    )
    return found.T


@kernel
def _strip(points, sigma_z, usable, centre, radius, origin, axes, half_length, extent, every):  # type: ignore[no-untyped-def]
    """Collect points with |x| ≤ extent and |y| ≤ half_length from the pixels around the station."""
    height, width = usable.shape
    u0, u1 = max(0, int(centre[0]) - radius[0]), min(width, int(centre[0]) + radius[0] + 1)
    v0, v1 = max(0, int(centre[1]) - radius[1]), min(height, int(centre[1]) + radius[1] + 1)
    out = np.empty((5, max(0, u1 - u0) * max(0, v1 - v0)))
    count = 0
    for v in range(v0, v1):
        for u in range(u0 + (-(u0 + v)) % every, u1, every):
            if not usable[v, u]:
                continue
            px, py, pz = points[v, u, 0], points[v, u, 1], points[v, u, 2]
            dx, dy, dz = px - origin[0], py - origin[1], pz - origin[2]
            x = dx * axes[0, 0] + dy * axes[0, 1] + dz * axes[0, 2]
            y = dx * axes[1, 0] + dy * axes[1, 1] + dz * axes[1, 2]
            if abs(x) > extent or abs(y) > half_length:
                continue
            along_ray = abs((px * axes[2, 0] + py * axes[2, 1]) / pz + axes[2, 2])
            out[0, count] = x
            out[1, count] = y
            out[2, count] = dx * axes[2, 0] + dy * axes[2, 1] + dz * axes[2, 2]
            out[3, count] = sigma_z[v, u] * along_ray
            out[4, count] = v * width + u
            count += 1
    return out[:, :count]


def section_at(
    reconstruction: Reconstruction,
    usable: Mask,
    origin: Array,
    direction: Array,
    towards_b: Array,
    centre_px: Array,
    inner: float,
    outer: float,
    half_length: float,
    min_points: int,
    other_courses: Sequence[Array] = (),
) -> Section | str:
    """The section of a station, or the reason why there is none.

    Parameters
    ----------
    usable : (h, w) ndarray of bool
    origin, direction : (3,) ndarray
        Point of the centre line on the skin, and the line's unit tangent.
    towards_b : (3,) ndarray
        Roughly from side A to side B.
    centre_px : (2,) ndarray
        The origin in the left image.
    inner, outer : float
        Where the skin lines begin and end, as distances from the centre line, mm.
    half_length : float
        ε_d, mm.
    min_points : int
        Fewest points of a skin line.
    other_courses : sequence of (m, 2) ndarray
        Other seams' courses in the left image: what lies beyond them is another plate.
    """

    def fitted(frame: Frame, band: float, every: int) -> tuple[SkinFit, Array] | None:
        points = strip(reconstruction, usable, centre_px, frame, half_length, outer, every)
        if other_courses:
            v, u = np.divmod(points[:, 4], usable.shape[1])
            points = points[~beyond(np.stack([u, v], axis=1), centre_px, other_courses)]
        fit = fit_skin_lines(points, -inner, inner, band)
        return None if fit is None else (fit, points)

    frame = _frame(origin, direction, towards_b, -origin / np.linalg.norm(origin))
    for band in _TURNING_BANDS_MM:
        found = fitted(frame, band, _SPARSE)
        if found is None:
            return "too few points of skin beside the seam"
        fit = found[0]
        slope, along = 0.5 * (fit.solution[1] + fit.solution[3]), 0.5 * (fit.solution[5] + fit.solution[6])
        across, ahead, up = frame.axes
        # The line's course is less sure than the skin is where it ends: a seam runs in the skin.
        direction = (ahead + along * up) / np.hypot(1.0, along)
        frame = _frame(origin, direction, towards_b, up - slope * across - along * ahead)
    found = fitted(frame, _SKIN_BAND_MM, 1)
    if found is None:
        return "too few points of skin beside the seam"
    fit, points = found
    if min(fit.n_a, fit.n_b) < min_points:
        side, n = ("A", fit.n_a) if fit.n_a <= fit.n_b else ("B", fit.n_b)
        return f"{n} points of skin on side {side}, {min_points} needed"
    a = SkinLine(np.array([fit.solution[0], fit.solution[1], fit.solution[4]]), fit.n_a)
    b = SkinLine(np.array([fit.solution[2], fit.solution[3], fit.solution[4]]), fit.n_b)
    covariance = fit.covariance
    rivals = fit.own_curvatures_step, _twist_step(fit, covariance, points[np.abs(points[:, 0]) > inner, 1])
    return Section(frame, a, b, covariance[:5, :5], fit.clumping, fit.stretches, fit.misfit, *rivals)


def _twist_step(fit: SkinFit, covariance: Array, y: Array) -> float:
    """By how much the step is another if the skin is twisted, so that its slope along the seam changes across it.

    The slopes of both sides carry the step from where the points lie to the plane. Where they lie about it, that is
    nothing; where a border cuts the strip, a step that changes along the seam and a twisted skin look alike.
    """
    across = np.zeros(7)
    across[5], across[6] = -1.0, 1.0
    beyond_noise = abs(across @ fit.solution) - _BY_CHANCE * np.sqrt(across @ covariance @ across)
    return float(abs(y.mean()) * max(beyond_noise, 0.0))


def _frame(origin: Array, direction: Array, towards_b: Array, normal: Array) -> Frame:
    """x across from A to B, h along the normal, y along the seam (right-handed: either way along it)."""
    across = _cross(direction, normal)
    across /= np.sqrt(across @ across)
    if across @ towards_b < 0:
        across = -across
    # The section plane is normal to the seam, so the frame's y is the seam's direction and h follows from it.
    along = direction if _cross(across, direction) @ normal > 0 else -direction
    return Frame(origin, np.stack([across, along, _cross(across, along)]))


def _cross(a: Array, b: Array) -> Array:
    """a × b of two vectors; numpy's own takes most of a section's time."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])

"""A countersink: the cone between the skin and a hole, seen in the cloud."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array

_BINS_PX = 0.5
_LEAST_WIDTH_PX = 3.0
_LEAST_FALL_MM = 0.15  # below the skin: beyond noise and a broken edge
# Slopes of cones of 140° to 60°: none that is usual is sharper, and matching bends a bore's wall to less than that.
_FLATTEST, _STEEPEST = np.tan(np.radians(20)), np.tan(np.radians(60))
_SHARED = 8.0  # neighbouring bins that are worth one: matching correlates four pixels
_SCATTER = 0.12  # of its depth by which a cone's profile may depart from a line


@dataclass(frozen=True)
class Countersink:
    """A cone."""

    diameter_mm: float
    diameter_sd_mm: float
    """diameter_mm, diameter_sd_mm: where it meets the skin."""
    depth_mm: float
    """From the skin to the lowest place of it that was measured."""
    angle_deg: float
    """Whole angle of the cone."""

    @property
    def lower_diameter_mm(self) -> float:
        """Where the cone ends and the hole's own wall begins."""
        return float(self.diameter_mm - 2 * self.depth_mm * np.tan(np.radians(0.5 * self.angle_deg)))

    def depth_at(self, radius: float) -> float:
        """How deep the cone is where it has a radius, mm."""
        return float((0.5 * self.diameter_mm - radius) / np.tan(np.radians(0.5 * self.angle_deg)))


def countersink(r: Array, height: Array, pixel_mm: float, within: float) -> Countersink | None:
    """The cone that heights over the skin show against the distance from a hole's axis; None without one.

    Parameters
    ----------
    r, height : (n,) array
        mm.
    within : float
        Largest radius at which the cone may begin, mm.
    """
    width = _BINS_PX * pixel_mm
    near = np.isfinite(height) & (r < within + 4 * pixel_mm)
    bins = (r[near] / width).astype(int)
    count = np.bincount(bins)
    known = np.flatnonzero(count >= 6)
    middle = np.array([np.median(height[near][bins == k]) for k in known])
    radii = (known + 0.5) * width
    on_cone = (middle < -_LEAST_FALL_MM) & (radii > 0.2 * within)
    # From the skin inwards: the cone goes on while the profile falls no steeper than a cone.
    order = np.flatnonzero(on_cone)[::-1]
    cone: list[int] = []
    for k in order:
        if cone:
            run = radii[cone[-1]] - radii[k]
            fall = middle[cone[-1]] - middle[k]
            if run > 3 * width or not 0.5 * _FLATTEST * run < fall < 1.5 * _STEEPEST * run:
                break
        cone.append(int(k))
    if len(cone) < _LEAST_WIDTH_PX / _BINS_PX:
        return None
    at, depth = radii[cone], middle[cone]
    (slope, level), covariance = np.polyfit(at, depth, 1, cov=True)
    residual = depth - (slope * at + level)
    if not _FLATTEST < slope < _STEEPEST or residual.std() > _SCATTER * (depth.max() - depth.min() + 1e-9):
        return None
    outer = -level / slope
    by = np.array([level / slope**2, -1 / slope])
    sd = float(np.hypot(np.sqrt(max(_SHARED * by @ covariance @ by, 0.0)), 0.1 * pixel_mm))
    return Countersink(2 * float(outer), 2 * sd, float(-depth.min()), float(2 * np.degrees(np.arctan(1 / slope))))

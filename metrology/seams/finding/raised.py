"""What lies on the skin, long and narrow (a cable, a bead, a strip of tape), and has no step: both its flanks look like
the edge of a sheet from near, but beyond them the skin goes on at the same height.
"""

from __future__ import annotations

import numpy as np

from metrology.arrays import Array, Mask
from metrology.cloud import Reconstruction
from metrology.results import SeamLine
from metrology.seams.finding.relief import skin_profile
from metrology.seams.finding.step_edges import LEAST_STEP_MM
from metrology.seams.polyline import interpolated, normals, resample

# What lies on the skin is taken to be no wider than this: cables, hoses, tape. Its flank may be on either side.
_WIDEST_MM = 8.0
_NODE_PX = 12.0
_LASTING = 0.5  # of a step between two sheets that is there beyond as well
NO_SEAM = 0.2
"""Confidence of a line that is shown and is no seam."""


def is_level_beyond(points: Array, step_mm: float, reconstruction: Reconstruction, usable: Mask) -> bool:
    """Whether the skin beyond what may lie or be painted along a line is level, though it steps near the line.

    Thick letters stand on one side of a line that runs through them at a slant.

    Parameters
    ----------
    points : (n, 2) ndarray
        u, v along the line.
    step_mm : float
        Near the line.
    usable : (h, w) ndarray of bool
        Pixels with a point, off the rivets.
    """
    widest = _widest_px(points, reconstruction)
    profile = None if widest is None else skin_profile(points, widest, reconstruction, usable)
    return profile is not None and profile.step_mm * np.sign(step_mm) < _LASTING * abs(step_mm)


def _widest_px(points: Array, reconstruction: Reconstruction) -> float | None:
    """How far what lies along a line may reach in the image; None where no point is on it."""
    z = reconstruction.points[..., 2]
    u, v = np.clip(np.round(points).astype(int), 0, np.array(z.shape[::-1]) - 1).T
    depth = z[v, u]
    if not np.isfinite(depth).any():
        return None
    return _WIDEST_MM / float(np.nanmedian(depth)) * float(reconstruction.rig.left.K[0, 0])


def raised_line(course: Array, reconstruction: Reconstruction, usable: Mask) -> SeamLine | None:
    """What lies on the skin along one of its flanks, a line without relief; None if the skin steps there, or cannot be
    seen beyond it.

    Parameters
    ----------
    course : (n, 2) ndarray
        u, v along the flank.
    usable : (h, w) ndarray of bool
        Pixels with a point, off the rivets.
    """
    widest = _widest_px(course, reconstruction)
    profile = None if widest is None else skin_profile(course, widest, reconstruction, usable)
    if profile is None or abs(profile.step_mm) >= LEAST_STEP_MM:
        return None
    raised = profile.height_mm > LEAST_STEP_MM / 2
    if not raised.any():
        return None
    first, last = profile.x[raised][[0, -1]]
    nodes = resample(course, _NODE_PX)
    middle = interpolated(nodes + 0.5 * (first + last) * normals(nodes), 1.0)
    return SeamLine("", middle, np.full(len(middle), float(last - first) + 1.0), NO_SEAM, False)

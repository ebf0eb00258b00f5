"""How deep a gap's floor lies, from the points between its edges where the gap is wide enough to show some."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.seams.gap.views import reference_height
from metrology.seams.skins.sections import Section, strip

# This part of the gap about its middle shows floor, not walls or chamfers; points nearer to an edge than this are mixed
# with it, px.
_CORE = 0.4
_MIXED_PX = 2.0
# On less floor than this nothing tells it from the deepest place between two mixed flanks, px.
_LEVEL_PX = 3.0
_MIN_POINTS = 10
_MIN_STATIONS = 4
# A floor's points scatter by less than this, and its depth varies by less along the seam.
_LEVEL_MM = 0.1
_FLOOR_SIGMA_MM = 0.2
# Sealant is no deeper than this: a gap's floor is substructure, a sheet's thickness down at least.
_SEALANT_MM = 0.2


@dataclass(frozen=True)
class Floor:
    """What closes the gap below: sealant up to the edges, or a floor whose depth may be known, mm."""

    sealed: bool
    depth_mm: float | None = None


def floor_depth(
    sections: Sequence[Section | None], half_widths: Sequence[float], reconstruction: Reconstruction, half_length: float
) -> float | None:
    """Median depth of what lies between the edges below the mean of both skin lines, mm; None where too few show it.

    Parameters
    ----------
    half_widths : sequence of float
        Half the width of the line as detected, mm.
    half_length : float
        ε_d, mm.
    """
    rig, valid = reconstruction.rig, reconstruction.valid
    left, centres = rig.left, np.stack([device.centre for device in rig.devices.values()])
    depths = []
    for section, half in zip(sections, half_widths, strict=True):
        if section is None:
            continue
        px = section.frame.origin[2] / left.K[0, 0]
        inner, mixed = _CORE * half, _MIXED_PX * px
        if half - inner < mixed:
            continue
        pixel = left.project(section.frame.origin)
        points = strip(reconstruction, valid, pixel, section.frame, half_length, inner)
        if len(points) >= _MIN_POINTS:
            depth = reference_height(section, points[:, 0]) - points[:, 2]
            low, high = _in_full_view(section, half - mixed, float(np.median(depth)), centres)
            if high - low < _LEVEL_PX * px:
                continue
            depth = depth[(low < points[:, 0]) & (points[:, 0] < high)]
        if len(points) >= _MIN_POINTS and len(depth) >= _MIN_POINTS:
            low, middle, high = _percentiles(depth)
            # Points that scatter more than their noise and a floor's evenness explain are of walls, or mixed.
            if high - low < 2 * np.hypot(_LEVEL_MM, 2 * np.median(points[:, 3])):
                depths.append(float(middle))
    if len(depths) < max(_MIN_STATIONS, 0.5 * sum(section is not None for section in sections)):
        return None
    low, middle, high = _percentiles(np.array(depths))
    return float(middle) if high - low < 2 * _FLOOR_SIGMA_MM else None


def _in_full_view(section: Section, half: float, depth: float, centres: Array) -> tuple[float, float]:
    """From which x to which a floor is seen past both edges from all of the rig-frame `centres` (n, 3).

    What lies beyond is wall to one of them, and its points there are mixed of wall and floor.
    """
    places = section.frame.local(centres)
    shifts = depth * places[:, 0] / places[:, 2]
    return -half - min(float(shifts.min()), 0.0), half - max(float(shifts.max()), 0.0)


def _percentiles(values: Array) -> Array:
    """The middle value, and those below and above which 16 % lie: numpy's own take ten times as long."""
    return np.interp(np.array([0.16, 0.5, 0.84]) * (len(values) - 1), np.arange(len(values)), np.sort(values))


def possible_floors(depth_mm: float | None) -> list[Floor]:
    """What the points' depth leaves open."""
    if depth_mm is None:
        return [Floor(sealed=True), Floor(sealed=False)]
    return [Floor(depth_mm < _SEALANT_MM, depth_mm)]

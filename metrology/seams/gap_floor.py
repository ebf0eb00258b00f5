"""How deep a gap's floor lies, from the points between its edges where the gap is wide enough to show some."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrology.cloud import Reconstruction
from metrology.seams.sections import Section, strip
from metrology.seams.views import reference_height

# Points nearer to an edge than this are mixed with it, px.
_MIXED_PX = 3.0
_MIN_POINTS = 10
_MIN_STATIONS = 4
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
    sections : sequence of Section or None
    half_widths : sequence of float
        Half the width of the line as detected, mm.
    reconstruction : Reconstruction
    half_length : float
        ε_d, mm.
    """
    left, valid = reconstruction.rig.left, reconstruction.valid
    depths = []
    for section, half in zip(sections, half_widths, strict=True):
        if section is None:
            continue
        inner = half - _MIXED_PX * section.frame.origin[2] / left.K[0, 0]
        if inner <= 0:
            continue
        pixel = left.project(section.frame.origin)
        points = strip(reconstruction, valid, pixel, section.frame, half_length, inner)
        if len(points) >= _MIN_POINTS:
            depths.append(float(np.median(reference_height(section, points[:, 0]) - points[:, 2])))
    return float(np.median(depths)) if len(depths) >= _MIN_STATIONS else None


def possible_floors(depth_mm: float | None) -> list[Floor]:
    """What the points' depth leaves open."""
    if depth_mm is None:
        return [Floor(sealed=True), Floor(sealed=False)]
    return [Floor(depth_mm < _SEALANT_MM, depth_mm)]

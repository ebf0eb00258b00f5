"""Lap joints: the edge of one sheet on another, which the picture shows faintly or not at all and the relief plainly.

The edge has a step and no gap. A line of the picture that shows a groove goes before an edge of the relief; one that
shows a step alone is the same joint, and the relief knows its course as well and all of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrology.arrays import Array, Mask
from metrology.cloud import Reconstruction
from metrology.results import SeamLine
from metrology.seams.finding.raised import raised_line
from metrology.seams.finding.relief import Relief, examine_relief
from metrology.seams.finding.step_edges import LEAST_STEP_MM, find_step_edges, step_course
from metrology.seams.polyline import Course, polyline_length
from metrology.seams.settings import SeamSettings

# The wide mean of the points makes weaker edges of its own this near to an edge, px.
_ECHO_PX = 40.0
# Of an edge this share must be new.
_NEW_SHARE = 0.8
# The blur of an edge in the points, px.
_BLUR_PX = 4.0


def with_laps(
    seams: Sequence[tuple[SeamLine, Relief]], reconstruction: Reconstruction, usable: Mask, settings: SeamSettings
) -> list[SeamLine]:
    """Seams found in the picture with their relief, those that the relief alone shows, and what lies on the skin.

    Parameters
    ----------
    seams : sequence of (SeamLine, Relief)
    usable : (h, w) ndarray of bool
        Pixels with a point, off the rivets.
    """
    kept = [line for line, _ in seams]
    beside = [band_of(line) for line in kept]
    for edge in find_step_edges(reconstruction, usable, settings.lines):
        if is_beside(edge.points, beside):
            continue
        course = step_course(edge.points, reconstruction, usable)
        if course is None or polyline_length(course) < settings.lines.min_length_px or is_beside(course, beside):
            continue
        relief = examine_relief(course, _BLUR_PX, reconstruction, usable, settings)
        if not relief.is_seam or relief.step_share < relief.share or abs(relief.step_mm) < LEAST_STEP_MM:
            continue
        line = raised_line(course, reconstruction, usable) or SeamLine(
            "", course, np.full(len(course), _BLUR_PX), relief.step_share, True, "lap"
        )
        kept.append(line)
        beside.append(band_of(line))
    return kept


def band_of(line: SeamLine) -> tuple[Course, float]:
    """A line's course and half its width, px."""
    return Course(line.centre_px[::4]), 0.5 * float(np.median(line.width_px))


def is_beside(points: Array, bands: Sequence[tuple[Course, float]]) -> bool:
    """Whether too little of a line is far from all others."""
    near = np.zeros(len(points), bool)
    for course, half in bands:
        near |= course.beside(points, half + _ECHO_PX)
    return bool(near.mean() > 1.0 - _NEW_SHARE)

"""T joints: a line that runs into another one ends at that one's border.

There the contrast of both fades into each other; where the two fitted lines meet says it better than brightness does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrology.arrays import Array
from metrology.seams.finding.image_line import ImageLine
from metrology.seams.polyline import Course, arc_length, resample

# An end this near to another line's border is at it, px: met at 40°, what lies 16 px beside a line (`ends`) reaches
# that border 19 px before or after the line itself does.
_REACH_PX = 20.0
# Lines that meet at a smaller angle than about 20° run along each other.
_LEAST_SINE = 0.35
# The last so many points tell the direction in which a line leaves.
_END_POINTS = 40


def ended_at_joints(lines: Sequence[ImageLine]) -> list[ImageLine]:
    """The lines, those that run into another one cut or continued to its border."""
    courses = [Course(line.centre_px) for line in lines]
    ended = []
    for i, line in enumerate(lines):
        for _ in range(2):
            for j, other in enumerate(lines):
                if j != i:
                    line = _ended(line, other, courses[j])
            line = replace(line, centre_px=line.centre_px[::-1], width_px=line.width_px[::-1])
        ended.append(line)
    return ended


def _ended(line: ImageLine, other: ImageLine, course: Course) -> ImageLine:
    """The line with its last point on the other one's border, if that is where it ends."""
    points = line.centre_px
    inside = points[max(0, len(points) - 1 - _END_POINTS)]
    outward = (points[-1] - inside) / np.linalg.norm(points[-1] - inside)
    beyond = _way_to_border(points[-1], inside, outward, other, course)
    if beyond is None:
        return line
    end = points[-1] + beyond * outward
    kept = (points - end) @ outward < -0.5
    # Only the last points can lie beyond the end.
    kept[: -2 * _END_POINTS] = True
    joined = resample(np.concatenate([points[kept], end[None]]), 1.0)
    width = np.interp(arc_length(joined), arc_length(points), line.width_px)
    return replace(line, centre_px=joined, width_px=width)


def _way_to_border(end: Array, inside: Array, outward: Array, other: ImageLine, course: Course) -> float | None:
    """How far from a line's end the other one's near border lies along the line, px; None if that is no joint."""
    # Where this line meets the other's centre line, from the nearest place on: two steps of Newton's method.
    place = end
    for _ in range(2):
        k = course.nearest(place)
        normal = course.normal(k)
        rate = float(outward @ normal)
        if abs(rate) < _LEAST_SINE:
            return None
        place = place - ((place - other.centre_px[k]) @ normal) / rate * outward
    k = course.nearest(place)
    if k in (0, len(other.centre_px) - 1) or np.linalg.norm(place - other.centre_px[k]) > 2.0:
        return None
    side = np.sign((inside - place) @ course.normal(k))
    # Right at the joint the other line's width cannot be told.
    width = float(np.median(other.width_px[max(0, k - _END_POINTS) : k + _END_POINTS + 1]))
    border = place + side * 0.5 * width / rate * outward
    beyond = float((border - end) @ outward)
    # A line that crosses the other one has its end far on the other side.
    return beyond if abs(beyond) < _REACH_PX else None

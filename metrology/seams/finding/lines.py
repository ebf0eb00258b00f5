"""Lines in one image: candidates at several scales, each one's borders fitted in the full image (paper §3.2)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from metrology.arrays import Array, Float32, Mask
from metrology.seams.finding.candidates import Candidate, find_candidates, relative_brightness
from metrology.seams.finding.ends import end_of_band
from metrology.seams.finding.image_line import ImageLine
from metrology.seams.finding.joints import ended_at_joints
from metrology.seams.finding.refine import Nodes, fit_nodes
from metrology.seams.finding.rough import RoughLine, look_at
from metrology.seams.polyline import Course, arc_length, interpolated, polyline_length, resample
from metrology.seams.settings import LineSettings

# Bands nearer to each other than this share a border, px.
_TOUCH_PX = 4.0
# A rough line is taken for one that is there already within its width and so much, px.
_SAME_PX = 3.0
# A first look sees some of the contrast that the fit will find.
_ROUGH_CONTRAST = 0.5
_STEP_PX = 1.0
# Nodes this near to an end tell the direction in which the line leaves.
_END_NODES = 5


def detect_lines(
    texture: ArrayLike,
    settings: LineSettings | None = None,
    hidden: Mask | None = None,
    worth: Callable[[RoughLine], bool] | None = None,
) -> list[ImageLine]:
    """Dark and bright lines of an image, longest first.

    Parameters
    ----------
    texture : (h, w) array
        Grey levels.
    hidden : (h, w) ndarray of bool, optional
        Places to leave out of the search (rivets); lines run on across them.
    worth : callable, optional
        Says of a line known to about a pixel whether it is worth measuring; by default all are.
    """
    settings = settings or LineSettings()
    relative = relative_brightness(texture)
    lines: list[ImageLine] = []
    courses: list[tuple[Course, float]] = []
    for candidate in find_candidates(relative, settings, hidden):
        rest = _uncovered(candidate, courses, settings.min_length_px)
        rough = look_at(relative, rest) if rest is not None else None
        if rough is None or abs(rough.contrast) < _ROUGH_CONTRAST * settings.min_contrast:
            continue
        if _shares_border(rough.points, rough.width_px, courses) or (worth is not None and not worth(rough)):
            continue
        line = _measured(relative, rough, settings)
        if line is None or _shares_border(line.centre_px[::8], float(np.median(line.width_px)), courses):
            continue
        lines.append(line)
        courses.append((Course(line.centre_px[::4]), float(np.median(line.width_px))))
    return sorted(ended_at_joints(lines), key=lambda line: -line.length_px)


def _uncovered(candidate: Candidate, courses: list[tuple[Course, float]], min_length: float) -> Candidate | None:
    """The candidate's longest part that no line found so far accounts for, if it is long enough."""
    points = resample(candidate.points, 4.0)
    free = np.ones(len(points), bool)
    for course, width in courses:
        free &= ~course.beside(points, 0.5 * width + candidate.width_px + _SAME_PX)
    if free.mean() > 0.9:
        return candidate
    borders = np.flatnonzero(np.concatenate([[True], ~free, [True]]))
    k = int(np.diff(borders).argmax())
    part = points[borders[k] : borders[k + 1] - 1]
    if len(part) < 3 or polyline_length(part) < min_length:
        return None
    return Candidate(part, candidate.width_px, candidate.response, candidate.dark)


def _shares_border(points: Array, width_px: float, courses: list[tuple[Course, float]]) -> bool:
    """Whether a line is only the strip beside another one, which ends where that one begins."""
    return any(course.beside(points, 0.5 * (width_px + width) + _TOUCH_PX).mean() > 0.5 for course, width in courses)


def _measured(relative: Float32, rough: RoughLine, settings: LineSettings) -> ImageLine | None:
    """The line with its borders fitted and its ends found, if it is one."""
    nodes = fit_nodes(relative, rough.points, rough.width_px)
    # A line may fade: it goes on as far as its borders can be followed.
    if nodes is None or nodes.length_px(settings.min_contrast) < settings.min_length_px:
        return None
    centre = _with_ends(relative, nodes)
    if polyline_length(centre) < settings.min_length_px:
        return None
    dense = interpolated(centre, _STEP_PX)
    known = np.isfinite(nodes.width_px)
    # Along the line from the first node; the ends moved it by little.
    at = np.linspace(0, 1, len(dense))
    width = np.interp(at, (arc_length(nodes.centre) / polyline_length(nodes.centre))[known], nodes.width_px[known])
    return ImageLine(dense, width, nodes.contrast, float(nodes.good.mean()))


def _with_ends(relative: Float32, nodes: Nodes) -> Array:
    """The nodes' centre line, cut or continued to where the band ends."""
    centre = nodes.centre
    width = float(np.nanmedian(nodes.width_px))
    for _ in range(2):
        centre = _to_end(relative, centre, width)[::-1]
    return centre


def _to_end(relative: Float32, centre: Array, width: float) -> Array:
    """The same with its last point where the band ends, if that can be told."""
    # Where the parabola through the last nodes points to at the last one.
    last, middle, first = centre[-1], centre[-1 - _END_NODES // 2], centre[-1 - _END_NODES // 2 * 2]
    outward = 3 * last - 4 * middle + first
    outward = outward / np.linalg.norm(outward)
    beyond = end_of_band(relative, centre[-1], outward, width)
    if beyond is None:
        return centre
    end = centre[-1] + beyond * outward
    before = (centre - end) @ outward < -_STEP_PX
    # Only the last points can lie beyond the end.
    before[: -2 * _END_NODES] = True
    return np.concatenate([centre[before], end[None]])

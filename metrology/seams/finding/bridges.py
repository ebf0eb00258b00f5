"""Pieces of one joint between which the picture shows nothing: the step in the points tells that it runs on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from metrology.arrays import Array, Mask
from metrology.cloud import Reconstruction
from metrology.results import SeamLine
from metrology.seams.finding.relief import Relief, examine_relief
from metrology.seams.finding.step_edges import LEAST_STEP_MM, step_course
from metrology.seams.polyline import resample
from metrology.seams.settings import SeamSettings

# The direction of an end is that of so much of the line; a gap is as long as this and half the shorter piece at most.
_END_PX, _LONGEST_PX = 40, 120.0
# Such a share of the gap must have the step, as high as that of both pieces but for this share of it.
_SHARE, _UNLIKE = 0.8, 0.3
_BLUR_PX = 4.0


def bridged(
    seams: Sequence[tuple[SeamLine, Relief]], reconstruction: Reconstruction, usable: Mask, settings: SeamSettings
) -> list[tuple[SeamLine, Relief]]:
    """Lines of the picture, pieces of one joint made one line.

    Parameters
    ----------
    seams : sequence of (SeamLine, Relief)
    usable : (h, w) ndarray of bool
        Pixels with a point, off the rivets.
    """
    pieces = list(seams)
    while True:
        for a, b in combinations(range(len(pieces)), 2):
            joined = _one_line(pieces[a], pieces[b], reconstruction, usable, settings)
            if joined is not None:
                pieces = [piece for k, piece in enumerate(pieces) if k not in (a, b)] + [joined]
                break
        else:
            return pieces


def _one_line(
    one: tuple[SeamLine, Relief],
    other: tuple[SeamLine, Relief],
    reconstruction: Reconstruction,
    usable: Mask,
    settings: SeamSettings,
) -> tuple[SeamLine, Relief] | None:
    """Both pieces with what lies between them, where that is the same step."""
    (first, before), (second, behind) = _facing(one, other)
    if min(abs(before), abs(behind)) < LEAST_STEP_MM:
        return None
    if abs(before - behind) > _UNLIKE * max(abs(before), abs(behind)):  # of other sign: the other skin is on top
        return None
    gap = second.centre_px[0] - first.centre_px[-1]
    longest = _LONGEST_PX + 0.5 * min(len(first.centre_px), len(second.centre_px))
    across = np.cos(np.deg2rad(settings.lines.max_bend_deg))
    if not 0 < np.hypot(*gap) <= longest or min(_cosine(gap, first), _cosine(gap, second)) < across:
        return None
    course = step_course(np.stack([first.centre_px[-1], second.centre_px[0]]), reconstruction, usable)
    if course is None:
        return None
    relief = examine_relief(course, _BLUR_PX, reconstruction, usable, settings)
    unlike = max(abs(relief.step_mm - step) for step in (before, behind))
    if relief.step_share < _SHARE or unlike > _UNLIKE * max(abs(before), abs(behind)):
        return None
    forward = course[(course - first.centre_px[-1]) @ gap > 0]
    inner = forward[(second.centre_px[0] - forward) @ gap > 0]
    between = resample(np.concatenate([first.centre_px[-1:], inner, second.centre_px[:1]]), 1.0)[1:-1]
    width = np.full(len(between), 0.5 * (np.nanmedian(first.width_px) + np.nanmedian(second.width_px)))
    line = replace(
        first,
        centre_px=np.concatenate([first.centre_px, between, second.centre_px]),
        width_px=np.concatenate([first.width_px, width, second.width_px]),
        confidence=min(first.confidence, second.confidence),
    )
    return line, replace(max(one[1], other[1], key=lambda found: found.share), step_mm=before)


def _facing(
    one: tuple[SeamLine, Relief], other: tuple[SeamLine, Relief]
) -> tuple[tuple[SeamLine, float], tuple[SeamLine, float]]:
    """Both lines and their steps, mm, turned so that the second one begins nearest to where the first one ends."""
    turned = [(a, b) for a in _both_ways(*one) for b in _both_ways(*other)]
    return min(turned, key=lambda pair: float(np.hypot(*(pair[1][0].centre_px[0] - pair[0][0].centre_px[-1]))))


def _both_ways(line: SeamLine, relief: Relief) -> tuple[tuple[SeamLine, float], tuple[SeamLine, float]]:
    """As it is, and from its other end, from where the sides are exchanged."""
    back = replace(line, centre_px=line.centre_px[::-1], width_px=line.width_px[::-1])
    return (line, relief.step_mm), (back, -relief.step_mm)


def _cosine(gap: Array, line: SeamLine) -> float:
    """Of the smaller of the angles between a gap and a line's two ends: bows are small over one joint."""
    back = min(_END_PX, len(line.centre_px) - 1)
    ends = line.centre_px[back] - line.centre_px[0], line.centre_px[-1] - line.centre_px[-1 - back]
    return float(max(way @ gap / (np.hypot(*way) * np.hypot(*gap)) for way in ends))

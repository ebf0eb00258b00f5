"""Which points belong to the plates beside a station: none that lie beyond another seam, or in its gap."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import cv2
import numpy as np

from metrology.arrays import Array, Mask
from metrology.results import SeamLine

# Courses are told apart well enough by straight pieces of this length, px.
_PIECE_PX = 40


def coarse_course(line: SeamLine) -> Array:
    """(m, 2) a seam's centre line in straight pieces."""
    centre = line.centre_px
    return centre[np.unique(np.append(np.arange(0, len(centre), _PIECE_PX), len(centre) - 1))]


def gap_mask(line: SeamLine, guard_px: float, shape: tuple[int, ...]) -> Mask:
    """(h, w) pixels in a seam's gap, or nearer to it than the guard."""
    mask = np.zeros(shape, np.uint8)
    width = float(np.nanmedian(line.width_px)) + 2 * guard_px
    cv2.polylines(mask, [np.round(line.centre_px).astype(np.int32)], False, 1, max(1, round(width)))
    return mask.astype(bool)


def beyond(pixels: Array, origin: Array, courses: Sequence[Array]) -> Mask:
    """(n,) whether the way from `origin` to each pixel (n, 2) crosses a course: then it lies on another plate."""
    across = np.zeros(len(pixels), bool)
    if not len(pixels):
        return across
    reach = np.abs(pixels - origin).max(axis=0)
    for course in courses:
        for start, end in itertools.pairwise(course):
            near = (np.minimum(start, end) <= origin + reach) & (np.maximum(start, end) >= origin - reach)
            if not near.all():
                continue
            along = end - start
            # The way crosses the piece where each one's ends lie on different sides of the other.
            side = _turn(along, pixels - start) * _turn(along, origin - start) < 0
            ways = pixels - origin
            side &= _turn(ways, start - origin) * _turn(ways, end - origin) <= 0
            across |= side
    return across


def _turn(a: Array, b: Array) -> Array:
    """z component of a × b."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])

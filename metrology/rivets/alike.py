"""Rings of the sizes of those that have been found, where no arc can be followed through the grain.

A small or partial faint ring shows in the sum along all of it where it shows nowhere along the way.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.ridges import gaussian_derivatives
from metrology.rivets.arcs import curvature_noise
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.shapes import CircleShapes
from metrology.robust import MAD

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]

_SCALE_PX = 1.4  # of the ridges
_SMALLEST_PX = 7.0  # radius below which a ring is hardly more than its line's width
_STEP = 1.07  # from one radius to the next: a ring's line is no narrower
_LONG_ARCS_PX = 20.0  # radius above which a ring's arcs are long enough to be followed
_MOST_PLACES = 60  # of a radius
_TILES = 3  # along either side of the image: what circles look like changes over it
_CLIP = 2.0  # standard deviations of a pixel: a scratch or a letter is no ring however clear
_LEAST = 4.0  # standard deviations of the sum over a ring


def rings_alike(image: Float32, found: Sequence[Ellipse], dark: bool, shapes: CircleShapes) -> list[Ellipse]:
    """Where rings as large as `found` may be, or between them in size, the clearest first.

    Parameters
    ----------
    image : (h, w) float32
    found : sequence of Ellipse
    dark : bool
        Whether the rings are darker than what surrounds them.
    shapes : CircleShapes
        What a circle looks like in each part of the image.
    """
    d = gaussian_derivatives(np.nan_to_num(image), _SCALE_PX)
    bend = (d.uu + d.vv) / curvature_noise(d.uu, d.vv)
    bend = np.clip(bend if dark else -bend, -_CLIP, _CLIP).astype(np.float32)
    starts = []
    for radius in _sizes([e.radius for e in found]):
        places = _peaks(_ring_sums(bend, radius, shapes), radius)
        starts += [(stands_out, shapes.ellipse(u, v, radius)) for stands_out, u, v in places]
    starts.sort(key=lambda start: -start[0])
    return [ellipse for _, ellipse in starts]


def _ring_sums(bend: Float32, radius: float, shapes: CircleShapes) -> Float32:
    """(h, w) mean over the ring of that radius about every pixel."""
    height, width = bend.shape
    sums = np.empty_like(bend)
    rows, columns = (np.linspace(0, side, _TILES + 1).astype(int) for side in (height, width))
    for top, bottom in itertools.pairwise(rows):
        for left, right in itertools.pairwise(columns):
            ring = _template(shapes.ellipse(0.5 * (left + right), 0.5 * (top + bottom), radius))
            reach = len(ring) // 2
            above, before = min(top, reach), min(left, reach)
            part = bend[top - above : bottom + reach, left - before : right + reach]
            total = cv2.filter2D(part, cv2.CV_32F, ring, borderType=cv2.BORDER_REFLECT)
            sums[top:bottom, left:right] = total[above:, before:][: bottom - top, : right - left]
    return sums


def _sizes(radii: Sequence[float]) -> list[float]:
    """Radii to try, px: from the smallest to the largest, of those whose arcs are short."""
    least, most = max(min(radii) / _STEP, _SMALLEST_PX), min(max(radii), _LONG_ARCS_PX)
    return [least * _STEP**k for k in range(int(np.floor(np.log(most / least) / np.log(_STEP))) + 1)]


def _template(ellipse: Ellipse) -> Float32:
    """A ring one pixel wide, of sum 1."""
    reach = int(ellipse.a) + 4
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    centred = Ellipse.of([0.0, 0.0, ellipse.a, ellipse.b, ellipse.angle])
    ring = np.exp(-0.5 * ((centred.level(u, v) - 1) * ellipse.radius) ** 2)
    return np.asarray(ring / ring.sum(), np.float32)


def _peaks(sums: Float32, radius: float) -> list[tuple[float, float, float]]:
    """Places that stand out of the sums most: by how much, in standard deviations, u, v."""
    middle = float(np.median(sums[::2, ::2]))
    deviation = MAD * float(np.median(np.abs(sums[::2, ::2] - middle))) + 1e-9
    size = int(radius) | 1
    highest = (sums > middle + _LEAST * deviation) & (sums == cv2.dilate(sums, np.ones((size, size), np.uint8)))
    places = [(float(sums[v, u] - middle) / deviation, float(u), float(v)) for v, u in np.argwhere(highest)]
    return sorted(places, reverse=True)[:_MOST_PLACES]

"""Rings of the sizes of those that have been found, where no arc can be followed through the grain.

A small or partial faint ring shows in the sum along all of it where it shows nowhere along the way. Centres are tried
two pixels apart: no place is farther than 1.4 px from one, and a ring's line and its blur are as wide.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Float32
from metrology.jit import kernel
from metrology.ridges import gaussian_derivatives
from metrology.rivets.arcs import curvature_noise
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.shapes import CircleShapes
from metrology.robust import MAD

_SCALE_PX = 1.7  # of the ridges: the line's blur, and what a centre and a radius may be off
_SMALLEST_PX = 7.0  # radius below which a ring is hardly more than its line's width
_STEP = 1.07  # from one radius to the next: a ring's line is no narrower
_LONG_ARCS_PX = 20.0  # radius above which a ring's arcs are long enough to be followed
_MOST_PLACES = 60  # of a radius
_TILES = 3  # along either side of the image: what circles look like changes over it
_CLIP = 2.0  # standard deviations of a pixel: a scratch or a letter is no ring however clear
_COUNTS = 30.0  # of a standard deviation: the sum over the longest ring stays below 2¹⁵
_APART_PX = 1.5  # between neighbouring places of a ring, which the blur makes alike
_LEAST = 4.0  # standard deviations of the sum over a ring
_SAME_PLACE, _SAME_SIZE = 0.4, 0.2  # of a radius, by which one ring shows at neighbouring places and sizes


def rings_alike(image: Float32, found: Sequence[Ellipse], dark: bool, shapes: CircleShapes) -> list[Ellipse]:
    """Where rings as large as `found` may be, or between them in size, the clearest first.

    Parameters
    ----------
    image : (h, w) float32
    dark : bool
        Whether the rings are darker than what surrounds them.
    shapes : CircleShapes
        What a circle looks like in each part of the image.
    """
    d = gaussian_derivatives(np.nan_to_num(image), _SCALE_PX)
    bend = (d.uu + d.vv) * (_COUNTS if dark else -_COUNTS) / curvature_noise(d.uu, d.vv)
    counts = np.clip(bend, -_CLIP * _COUNTS, _CLIP * _COUNTS).astype(np.int8)
    sizes = _sizes([e.radius for e in found])
    if not sizes:
        return []
    longest = float(np.sqrt((shapes.matrices[..., 0] + shapes.matrices[..., 1]).max()))  # semi-axis of a radius of 1
    margin = int(0.5 * max(sizes) * longest) + 2
    quarters = _quarters(counts, margin)
    places = [place for radius in sizes for place in _peaks(_ring_sums(quarters, margin, radius, shapes), radius)]
    return [shapes.ellipse(u, v, radius) for _, u, v, radius in _distinct(places)]


def _sizes(radii: Sequence[float]) -> list[float]:
    """Radii to try, px: from the smallest to the largest, of those whose arcs are short."""
    least, most = max(min(radii) / _STEP, _SMALLEST_PX), min(max(radii), _LONG_ARCS_PX)
    return [least * _STEP**k for k in range(int(np.floor(np.log(most / least) / np.log(_STEP))) + 1)]


def _quarters(counts: NDArray[np.int8], margin: int) -> NDArray[np.int8]:
    """(2, 2, h/2 + 2 margin, w/2 + 2 margin) pixels by odd and even row and column, with nothing around them."""
    height, width = (side + side % 2 for side in counts.shape)
    whole = np.zeros((height + 4 * margin, width + 4 * margin), np.int8)
    whole[2 * margin :, 2 * margin :][: counts.shape[0], : counts.shape[1]] = counts
    return np.ascontiguousarray(whole.reshape(len(whole) // 2, 2, -1, 2).transpose(1, 3, 0, 2))


def _ring_sums(quarters: NDArray[np.int8], margin: int, radius: float, shapes: CircleShapes) -> Float32:
    """(h/2, w/2) mean over the ring of that radius about every second pixel of every second row."""
    rows, columns = (side - 2 * margin for side in quarters.shape[2:])
    sums = np.zeros((rows, columns), np.int16)
    steps = round(2 * np.pi * radius / _APART_PX)
    downs, acrosses = (np.linspace(0, side, _TILES + 1).astype(int) for side in (rows, columns))
    for top, bottom in itertools.pairwise(downs):
        for left, right in itertools.pairwise(acrosses):
            ring = shapes.ellipse(left + right, top + bottom, radius)
            places = np.round(ring.points(steps) - [ring.u, ring.v]).astype(np.int64)
            _add_ring(quarters, margin, places, (top, bottom, left, right), sums)
    return np.asarray(sums / np.float32(steps), np.float32)


@kernel
def _add_ring(quarters, margin, places, tile, sums):  # type: ignore[no-untyped-def]
    """Add the pixels at (n, 2) `places` relative to every centre of a tile, in rows that lie one behind the other."""
    top, bottom, left, right = tile
    for i in range(top, bottom):
        total = sums[i, left:right]
        for k in range(len(places)):
            du, dv = places[k]
            start = left + margin + (du >> 1)
            row = quarters[dv & 1, du & 1, i + margin + (dv >> 1), start : start + right - left]
            for j in range(len(total)):
                total[j] += row[j]


def _peaks(sums: Float32, radius: float) -> list[tuple[float, float, float, float]]:
    """Places that stand out of the sums most: by how much, in standard deviations, u, v, and the radius."""
    some = sums[::2, ::2]
    middle = float(np.median(some))
    deviation = MAD * float(np.median(np.abs(some - middle))) + 1e-9
    size = int(radius / 2) | 1
    rows, columns = np.nonzero(sums > middle + _LEAST * deviation)
    highest = cv2.dilate(sums, np.ones((size, size), np.uint8))
    top = sums[rows, columns] == highest[rows, columns]
    places = [
        (float(sums[v, u] - middle) / deviation, 2.0 * u, 2.0 * v, radius)
        for v, u in zip(rows[top], columns[top], strict=True)
    ]
    return sorted(places, reverse=True)[:_MOST_PLACES]


def _distinct(places: Sequence[tuple[float, float, float, float]]) -> Array:
    """(n, 4) of the places, the clearest first, those that are no sides of a clearer ring."""
    ordered = np.array(sorted(places, reverse=True)).reshape(-1, 4)
    kept: list[int] = []
    for i, (_, u, v, radius) in enumerate(ordered):
        others = ordered[kept]
        same = np.hypot(others[:, 1] - u, others[:, 2] - v) < _SAME_PLACE * radius
        if not (same & (np.abs(np.log(others[:, 3] / radius)) < _SAME_SIZE)).any():
            kept.append(i)
    return ordered[kept]

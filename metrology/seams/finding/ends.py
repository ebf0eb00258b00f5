"""Where a line ends: where the band's contrast against the skin beside it ends.

Along the line, brightness beside the band less brightness in it falls from the band's contrast to nothing: where the
groove stops, where it opens into another one (a T joint: what lies beside it is as dark), and where the lit skin stops
(both are dark). The place is that of the blurred step that fits this difference best.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from metrology.arrays import Array, Float32, Mask
from metrology.seams.blur import EdgeResponse, PixelBlur
from metrology.seams.finding.bands import fit_bands
from metrology.seams.sampling import LocalMap, sample

# The step is sought this far both ways, px, and must leave so much on each side of it.
_REACH_PX = 24.0
_LEAST_PX = 4.0
# Beside the band: past the blur of its borders, and so wide on each side that the skin's noise counts for less than
# that of most bands, px.
_GUARD_PX = 1.5
_BESIDE_PX = 8.0
_BIN_PX = 0.5
_BLUR = PixelBlur(lens_px=0.6, spill=0.0)
# Of a border across the line: lens and pixel.
_BORDER_PX = float(np.hypot(_BLUR.lens_px, 12**-0.5))
# A bin that holds less of the band tells nothing.
_LEAST_COVER = 0.1
# What is left of the contrast beyond the end.
_MOST_LEFT = 0.35
_WORST_SIGMA_PX = 0.5


def end_of_band(relative: Float32, end: Array, outward: Array, width_px: float) -> float | None:
    """How far beyond (+) or before (−) a place near the end the band ends, px; None where that cannot be told.

    Parameters
    ----------
    relative : (h, w) float32
    end, outward : (2,) ndarray
        u, v of the place, and the unit vector in which the line leaves.
    width_px : float
        The band's.
    """
    local = LocalMap.in_image(end, outward)
    beside = width_px / 2 + _GUARD_PX
    along, across, grey = sample(relative, local, -_REACH_PX, _REACH_PX, beside + _BESIDE_PX)
    # How much of each pixel the band covers.
    cover = ndtr((across + width_px / 2) / _BORDER_PX) - ndtr((across - width_px / 2) / _BORDER_PX)
    response = EdgeResponse.along(local.gradient, _BLUR)
    # A line met at a slant is seen on one side as much too early as too late on the other.
    sides = [_last_place(along, grey, cover, side, response) for side in (across < -beside, across > beside)]
    found = [place for place in sides if place is not None]
    return float(np.mean(found)) if found else None


def _last_place(along: Array, grey: Array, cover: Array, outside: Mask, response: EdgeResponse) -> float | None:
    """Where along the line the contrast against what lies outside ends, px; None where that is not clear."""
    difference, position, counts = _difference(along, grey, cover, outside)
    if len(position) < 2 * _LEAST_PX / _BIN_PX:
        return None
    first = np.sign(difference[: len(difference) // 4].mean())
    guess = position[_best_split(difference * first)]
    fit = fit_bands(position, difference, [guess], response, slopes=(False, False), counts=counts)
    if fit is None:
        return None
    place, sigma = float(fit.edges[0]), float(np.sqrt(fit.covariance[0, 0]))
    before, after = fit.levels
    clear = abs(after) < _MOST_LEFT * abs(before) and sigma < _WORST_SIGMA_PX
    within = position[0] + _LEAST_PX < place < position[-1] - _LEAST_PX
    return place if clear and within else None


def _difference(along: Array, grey: Array, cover: Array, outside: Mask) -> tuple[Array, Array, Array]:
    """The band's contrast (least squares on the pixels it covers) per bin along the line, where the bins are, and their
    weights in pixels."""
    bins = np.floor((along + _REACH_PX) / _BIN_PX).astype(np.int64)
    size = int(bins.max()) + 1 if len(bins) else 0

    def total(values: Array) -> Array:
        return np.asarray(np.bincount(bins, values, size), float)

    n_out, first, second = total(outside.astype(float)), total(cover), total(cover**2)
    both = (n_out > 0) & (second > _LEAST_COVER)
    n_out, first, second = n_out[both], first[both], second[both]
    light = total(np.where(outside, grey, 0.0))[both] / n_out
    contrast = (first * light - total(cover * grey)[both]) / second
    place = total(cover**2 * along)[both] / second
    return contrast, place, 1.0 / (1.0 / second + (first / second) ** 2 / n_out)


def _best_split(values: Array) -> int:
    """Index that parts a falling series best into a high and a low part (least squares)."""
    n = np.arange(1, len(values))
    before = np.cumsum(values)[:-1]
    total = float(values.sum())
    return int(np.argmax(before**2 / n + (total - before) ** 2 / (len(values) - n))) + 1

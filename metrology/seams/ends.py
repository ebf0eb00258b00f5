"""Where a line ends: where the band's contrast against the skin beside it ends.

Along the line, brightness beside the band less brightness in it falls from the band's contrast to nothing: where the
groove stops, where it opens into another one (a T joint: what lies beside it is as dark), and where the lit skin stops
(both are dark). The place is that of the blurred step that fits this difference best.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.seams.bands import fit_bands
from metrology.seams.blur import EdgeResponse, PixelBlur
from metrology.seams.polyline import Array
from metrology.seams.sampling import LocalMap, sample

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

# The step is sought this far both ways, px, and must leave so much on each side of it.
_REACH_PX = 24.0
_LEAST_PX = 4.0
# Beside the band: past the blur of its borders, and so wide, px.
_GUARD_PX = 1.5
_BESIDE_PX = 4.0
_BIN_PX = 0.5
_BLUR = PixelBlur(lens_px=0.6, spill=0.0)
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
    inside = np.abs(across) < max(width_px / 2 - 1.0, 0.6)
    outside = np.abs(across) > beside
    difference, position, counts = _difference(along, grey, inside, outside)
    if len(position) < 2 * _LEAST_PX / _BIN_PX:
        return None
    first = np.sign(difference[: len(difference) // 4].mean())
    guess = position[_best_split(difference * first)]
    response = EdgeResponse.along(local.gradient, _BLUR)
    fit = fit_bands(position, difference, [guess], response, slopes=(False, False), counts=counts)
    if fit is None:
        return None
    place, sigma = float(fit.edges[0]), float(np.sqrt(fit.covariance[0, 0]))
    before, after = fit.levels
    clear = abs(after) < _MOST_LEFT * abs(before) and sigma < _WORST_SIGMA_PX
    within = position[0] + _LEAST_PX < place < position[-1] - _LEAST_PX
    return place if clear and within else None


def _difference(along: Array, grey: Array, inside: Mask, outside: Mask) -> tuple[Array, Array, Array]:
    """Brightness beside the band less that in it per bin along the line, where the bins are, and pixels' weight."""
    bins = np.floor((along + _REACH_PX) / _BIN_PX).astype(np.int64)
    size = int(bins.max()) + 1 if len(bins) else 0
    n_in, n_out = (np.bincount(bins[part], minlength=size) for part in (inside, outside))
    both = (n_in > 0) & (n_out > 0)
    with np.errstate(invalid="ignore"):
        dark = np.bincount(bins[inside], grey[inside], size) / n_in
        light = np.bincount(bins[outside], grey[outside], size) / n_out
        place = np.bincount(bins[inside], along[inside], size) / n_in
    weight = 1.0 / (1.0 / np.maximum(n_in, 1) + 1.0 / np.maximum(n_out, 1))
    return (light - dark)[both], place[both], weight[both]


def _best_split(values: Array) -> int:
    """Index that parts a falling series best into a high and a low part (least squares)."""
    n = np.arange(1, len(values))
    before = np.cumsum(values)[:-1]
    total = float(values.sum())
    return int(np.argmax(before**2 / n + (total - before) ** 2 / (len(values) - n))) + 1

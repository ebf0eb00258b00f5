"""Second pictures of the fringes: reflections within a lens, or from something beside the skin, that each frame holds.

A weak copy of the fringes, displaced, adds a phasor of its own to that of every count. Its phase differs from the
skin's by 2π f Δ/W, Δ the distance between both on the projector, and so differently for each count f: the counts then
miss a common position by an amount that hardly changes from pixel to pixel. Noise averages out over a block of pixels,
and harmonics over the fringes in it. What moves while it is scanned makes counts disagree, too, but little: steps of
one count share the movement, and 15 µm of it leave one to three milliradians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.robust import MAD

_BLOCKS = 8  # along each side of the picture
# Fringes over the projector, so that two and more lie in a block even where half of them are in view.
_LEAST_COUNT = 32
_LEAST_PIXELS = 40
_FEWEST_BLOCKS = 12
_OF_NOISE = 2.0  # the scatter of blocks that noise explains: seldom 1.5 times what is expected
_MEDIAN = np.pi / 2  # variance of a median, relative to a mean's


def disagreement(missed: Array, counts: tuple[int, ...], use: NDArray[np.bool_], rows: int) -> float | None:
    """What blocks of pixels miss a common position by in one count: the root mean square beyond noise.

    Parameters
    ----------
    missed : (counts, n) ndarray
        What each count's phase misses the common position by, in turns, on a grid of so many `rows`.
    counts : tuple of int
        Fringes over the projector.
    use : (n,) bool

    Returns
    -------
    float or None
        In rad; 0 where noise explains it, None where too little is seen, or a count has too few fringes for a block.
    """
    if len(counts) < 2 or min(counts) < _LEAST_COUNT:
        return None
    grid, good = missed.reshape(len(counts), rows, -1) * 2 * np.pi, use.reshape(rows, -1)
    columns = good.shape[1]
    middles, expected = [], []
    for top in np.array_split(np.arange(rows), _BLOCKS):
        for side in np.array_split(np.arange(columns), _BLOCKS):
            block = np.ix_(top, side)
            seen = good[block]
            if seen.sum() < max(_LEAST_PIXELS, seen.size / 2):
                continue
            values = grid[:, block[0], block[1]][:, seen]
            middle = np.median(values, axis=1)
            scatter = MAD * np.median(np.abs(values - middle[:, None]), axis=1)
            middles.append(middle)
            expected.append(_MEDIAN * scatter**2 / seen.sum())
    if len(middles) < _FEWEST_BLOCKS:
        return None
    found, noise = np.square(middles).mean(0), np.mean(expected, axis=0)
    return float(np.sqrt(np.where(found > _OF_NOISE**2 * noise, found - noise, 0.0).max()))

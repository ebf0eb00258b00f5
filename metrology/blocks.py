"""Pixels of an image in square blocks: medians of what they have, and what a smooth course over the field leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.robust import MAD

_ROUNDS, _OUTLIER_MADS = 5, 4.0


@dataclass(frozen=True)
class Blocks:
    """Which pixels lie in which block; blocks without any are left out."""

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    """row, column (n,): of the block."""
    group: NDArray[np.int64]
    """(pixels,) number of each pixel's block."""
    count: NDArray[np.int64]
    """(n,) pixels in the block."""

    def medians(self, values: Array) -> Array:
        """Median over each block of the pixels' (pixels,) values."""
        ordered = values[np.lexsort((values, self.group))]
        first = np.cumsum(self.count) - self.count
        return np.asarray((ordered[first + (self.count - 1) // 2] + ordered[first + self.count // 2]) / 2)


def in_blocks(v: NDArray[np.int64], u: NDArray[np.int64], width: int, side: int) -> Blocks:
    """Blocks of `side` pixels each way.

    Parameters
    ----------
    v, u : (pixels,) ndarray of int
        Row and column of each pixel.
    width : int
        Of the image, pixels.
    """
    across = width // side + 1
    block, group, count = np.unique((v // side) * across + u // side, return_inverse=True, return_counts=True)
    return Blocks(block // across, block % across, group, count)


def beyond_smooth(row: NDArray[np.int64], column: NDArray[np.int64], off: Array) -> tuple[Array, float]:
    """What a quadratic over the field leaves, and how far sound blocks scatter about it.

    Parameters
    ----------
    row, column : (n,) int
        Of each block.
    off : (n,) ndarray
        Value of each block.
    """
    x, y = column / max(1, column.max()) - 0.5, row / max(1, row.max()) - 0.5
    design = np.column_stack([np.ones_like(x), x, y, x * y, x * x, y * y])
    keep, scatter = np.ones(len(off), bool), 0.0
    local = off - np.median(off)
    for _ in range(_ROUNDS):
        scatter = MAD * float(np.median(np.abs(local[keep]))) + 1e-6
        keep = np.abs(local) < _OUTLIER_MADS * scatter
        local = off - design @ np.linalg.lstsq(design[keep], off[keep], rcond=None)[0]
    return np.asarray(local), MAD * float(np.median(np.abs(local)))

"""Medians of rows of which some values are left out."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from metrology.arrays import Array, Mask
from metrology.jit import kernel


def row_medians(values: ArrayLike, kept: Mask) -> Array:
    """(p,) median of each row's kept values (p, n); NaN where none is kept."""
    rows = np.ascontiguousarray(values, float)
    return np.asarray(_row_medians(rows, np.ascontiguousarray(np.broadcast_to(kept, rows.shape))))


@kernel
def _row_medians(values, kept):  # type: ignore[no-untyped-def]
    """Row by row."""
    medians = np.full(values.shape[0], np.nan)
    some = np.empty(values.shape[1])
    for i in range(values.shape[0]):
        n = 0
        for j in range(values.shape[1]):
            if kept[i, j]:
                some[n] = values[i, j]
                n += 1
        if n > 0:
            medians[i] = np.median(some[:n])
    return medians

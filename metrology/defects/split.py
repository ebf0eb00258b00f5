"""Defects whose feet run into each other: one region, several bottoms."""

from __future__ import annotations

import numpy as np

from metrology.arrays import Array, Mask
from metrology.jit import kernel

_APART = 0.7  # of its depth must a bottom rise to, on the way to any deeper one: less may be a rough bottom


def bottoms(depth: Array, member: Mask, sure: Array, least_cells: int) -> list[Mask]:
    """Parts of a region, one for each bottom.

    Parameters
    ----------
    depth : (rows, columns) ndarray
        Smoothed, positive to the region's side, mm.
    member : (rows, columns) bool
        The region's cells.
    sure : (rows, columns) ndarray
        By how much a bottom must be deeper than the ridge beside it to be one for certain, mm.
    least_cells : int
        Of a part above its ridge.
    """
    basins = np.zeros(member.shape, np.int64)
    order = np.flatnonzero(member)
    order = order[np.argsort(-depth.ravel()[order], kind="stable")]
    flood(np.ascontiguousarray(depth, float), order, np.ascontiguousarray(sure, float), _APART, least_cells, basins)
    return [basins == k for k in np.unique(basins[member])]


@kernel
def flood(depth, order, sure, apart, least_cells, basins):  # type: ignore[no-untyped-def]
    """Basins of a depth map, filled from the deepest cell up; of two that meet the shallower is one if it stands out.

    Parameters
    ----------
    depth, sure : (rows, columns) float64
    order : (n,) int64
        Places of the cells, the deepest first.
    apart : float
        Of its depth must a basin rise to.
    least_cells : int
        That it must have by then.
    basins : (rows, columns) int64, input and output
        0; at last 1 … of each cell.
    """
    rows, columns = basins.shape
    parent = np.zeros(order.shape[0] + 1, np.int64)
    peak, size, place = np.zeros(len(parent)), np.zeros(len(parent), np.int64), np.zeros(len(parent), np.int64)
    met = np.zeros(4, np.int64)
    count = 0
    for at in order:
        i, j = at // columns, at % columns
        level, beside, deepest = depth[i, j], 0, 0
        for k in range(4):
            m, n = i + (k == 0) - (k == 1), j + (k == 2) - (k == 3)
            if m < 0 or n < 0 or m >= rows or n >= columns or basins[m, n] == 0:
                continue
            root = basins[m, n]
            while parent[root] != root:
                root = parent[root]
            met[beside] = root
            beside += 1
            if deepest == 0 or peak[root] > peak[deepest]:
                deepest = root
        if deepest == 0:
            count += 1
            parent[count], peak[count], place[count] = count, level, at
            deepest = count
        own = deepest
        for k in range(beside):
            root = met[k]
            if root == deepest:
                continue
            stands_out = peak[root] - level > sure[place[root] // columns, place[root] % columns]
            if stands_out and level <= apart * peak[root] and size[root] >= least_cells:
                own = root
            else:
                parent[root] = deepest
                size[deepest] += size[root]
        basins[i, j] = own
        size[own] += 1
    for at in order:
        root = basins[at // columns, at % columns]
        while parent[root] != root:
            root = parent[root]
        basins[at // columns, at % columns] = root

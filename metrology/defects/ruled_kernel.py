"""Compiled means of heights over lines across a seam (see `ruled`)."""

from __future__ import annotations

import numpy as np

from metrology.jit import kernel
from metrology.robust import MAD, TUKEY

_ROUNDS = 4  # of which the first tells the weights of the start alone


@kernel
def bin_medians(low, values, count):  # type: ignore[no-untyped-def]
    """(count,) medians (upper of two) of values (n,) in bins low (n,); an empty bin lies between its neighbours."""
    first = np.zeros(count + 1, np.int64)
    for k in range(low.shape[0]):
        first[low[k] + 1] += 1
    for b in range(count):
        first[b + 1] += first[b]
    filled, sorted_in = first[:-1].copy(), np.empty(low.shape[0])
    for k in range(low.shape[0]):
        sorted_in[filled[low[k]]] = values[k]
        filled[low[k]] += 1
    known, middle, number = np.empty(count), np.empty(count), 0
    for b in range(count):
        here = sorted_in[first[b] : first[b + 1]]
        if here.shape[0]:
            here.sort()
            known[number], middle[number] = b, here[here.shape[0] // 2]
            number += 1
    return np.interp(np.arange(count), known[:number], middle[:number])


@kernel
def robust_polyline(low, share, values, sd, held, heights):  # type: ignore[no-untyped-def]
    """Polyline with nodes at every bin through values, by Tukey's weights.

    Parameters
    ----------
    low : (n,) int64
        Node before each value.
    share : (n,) float64
        Of the way from there to the next.
    values, sd : (n,) float64
    held : float
        Of a full bin, with which a node is held to its neighbours.
    heights : (count,) float64, input and output
        At the nodes; at first a start that is near.

    Returns
    -------
    variance : (count,) float64
        Of the heights.
    """
    size, count = low.shape[0], heights.shape[0]
    w, residual = np.empty(size), np.empty(size)
    own, shared, right = np.empty(count), np.empty(count), np.empty(count)
    scale = 0.0
    for turn in range(_ROUNDS):
        if turn:
            own[:], shared[:], right[:] = 0.0, 0.0, 0.0
            for k in range(size):
                i, s = low[k], share[k]
                near, far = w[k] * (1.0 - s), w[k] * s
                own[i] += near * (1.0 - s)
                own[i + 1] += far * s
                shared[i] += near * s
                right[i] += near * values[k]
                right[i + 1] += far * values[k]
            _solve(own, shared, right, held * own.max(), heights)
        for k in range(size):
            line = (1.0 - share[k]) * heights[low[k]] + share[k] * heights[low[k] + 1]
            residual[k] = abs(values[k] - line) / sd[k]
        scale = MAD * np.partition(residual, size // 2)[size // 2] + 1e-12
        for k in range(size):
            t = (residual[k] / (TUKEY * scale)) ** 2
            w[k] = (1.0 - t) ** 2 / sd[k] ** 2 if t < 1.0 else 0.0
    own[:] = 0.0
    for k in range(size):
        own[low[k]] += (1.0 - share[k]) * w[k]
        own[low[k] + 1] += share[k] * w[k]
    return scale**2 / np.maximum(own, held * own.max())


@kernel
def _solve(own, shared, right, held, x):  # type: ignore[no-untyped-def]
    """Three diagonals, each node held to its neighbours: Thomas's elimination; `own` and `right` are used up."""
    count = own.shape[0]
    for i in range(count):
        own[i] += held if i in (0, count - 1) else 2.0 * held
    for i in range(1, count):
        factor = (shared[i - 1] - held) / own[i - 1]
        own[i] -= factor * (shared[i - 1] - held)
        right[i] -= factor * right[i - 1]
    x[count - 1] = right[count - 1] / own[count - 1]
    for i in range(count - 2, -1, -1):
        x[i] = (right[i] - (shared[i] - held) * x[i + 1]) / own[i]

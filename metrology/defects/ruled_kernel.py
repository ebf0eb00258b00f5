"""Compiled parts of how heights along a seam are told (see `ruled`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.jit import kernel

_STIFFNESSES = 9  # of which each bends √10 times as much as the one before


def bin_medians(low: NDArray[np.int64], values: Array, count: int) -> Array:
    """(count,) medians (upper of two) of values (n,) in bins low (n,); an empty bin lies between its neighbours."""
    known, middle = _medians(low, values, count)
    return np.interp(np.arange(count), known, middle)


@kernel
def _medians(low, values, count):  # type: ignore[no-untyped-def]
    """Bins that hold values, in order, and each one's median."""
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
    return known[:number], middle[:number]


@kernel
def add_polylines(low, share, lever, design, weights, target, normal, right):  # type: ignore[no-untyped-def]
    """Add what polylines, as columns behind those of a design, contribute to normal equations.

    Parameters
    ----------
    low : (p, n) int64
        Column of the node before each of n values on each of p polylines.
    share : (p, n) float64
        Of the way from there to the next.
    lever : (n,) float64
        By which a height counts in a value.
    design : (n, k) float64
    weights, target : (n,) float64
    normal : (k + m, k + m) float64, input and output
        Above its diagonal.
    right : (k + m,) float64, input and output
    """
    for n in range(low.shape[1]):
        for p in range(low.shape[0]):
            for after in range(2):
                i = low[p, n] + after
                value = weights[n] * lever[n] * (share[p, n] if after else 1.0 - share[p, n])
                right[i] += value * target[n]
                for a in range(design.shape[1]):
                    normal[a, i] += value * design[n, a]
                for q in range(p, low.shape[0]):
                    for next_after in range(2):
                        j = low[q, n] + next_after
                        if j >= i:
                            normal[i, j] += value * lever[n] * (share[q, n] if next_after else 1.0 - share[q, n])


@kernel
def stiffest(own, shared, right, scale, least):  # type: ignore[no-untyped-def]
    """The weight of squared second differences of a polyline that its values make most probable (greatest evidence).

    Parameters
    ----------
    own, shared : (count,) float64
        Of its normal equations: the diagonal, and beside it.
    right : (count,) float64
    scale : float
        Standard deviation of the values over the one that their weights tell.
    least : float
        Standard deviation of second differences in the stiffest one.
    """
    count = own.shape[0]
    best, found = -np.inf, 1.0
    for turn in range(_STIFFNESSES):
        bend = least * 10.0 ** (0.5 * turn)
        stiffness = (scale / bend) ** 2
        diagonal, first, second = _factors(own, shared, stiffness)
        solution = _solved(diagonal, first, second, right)
        evidence = (count - 2) * np.log(stiffness) - np.log(diagonal).sum() + (right * solution).sum() / scale**2
        if evidence > best:
            best, found = evidence, stiffness
    return found


@kernel
def _factors(own, shared, stiffness):  # type: ignore[no-untyped-def]
    """L D Lᵀ of three diagonals and the squares of second differences: D, and the two diagonals below 1 of L."""
    count = own.shape[0]
    diagonal, first, second = own.copy(), shared.copy(), np.zeros(count)
    for k in range(count - 2):
        diagonal[k] += stiffness
        diagonal[k + 1] += 4.0 * stiffness
        diagonal[k + 2] += stiffness
        first[k] -= 2.0 * stiffness
        first[k + 1] -= 2.0 * stiffness
        second[k] += stiffness
    for i in range(count):
        below, beyond = first[i] / diagonal[i], second[i] / diagonal[i]
        if i + 1 < count:
            diagonal[i + 1] -= below * first[i]
            first[i + 1] -= below * second[i]
        if i + 2 < count:
            diagonal[i + 2] -= beyond * second[i]
        first[i], second[i] = below, beyond
    return diagonal, first, second


@kernel
def _solved(diagonal, first, second, right):  # type: ignore[no-untyped-def]
    """The solution by `_factors`."""
    count = right.shape[0]
    x = right.copy()
    for i in range(count):
        if i + 1 < count:
            x[i + 1] -= first[i] * x[i]
        if i + 2 < count:
            x[i + 2] -= second[i] * x[i]
    x /= diagonal
    for i in range(count - 2, -1, -1):
        x[i] -= first[i] * x[i + 1]
        if i + 2 < count:
            x[i] -= second[i] * x[i + 2]
    return x

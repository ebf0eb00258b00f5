"""Which dot is which: places on a square lattice for dots seen in perspective, some of them missing or false."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from metrology.arrays import Array

Labels = NDArray[np.int64]

_NEAR = 0.25  # a neighbour is taken where it lies within this part of a step from its predicted place
_STEPS: tuple[tuple[int, int], ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))
_SEEDS = 12


def label_lattice(points: Array) -> tuple[NDArray[np.intp], Labels]:
    """Grow a square lattice over points, from the seed that reaches the most of them.

    Each labelled point predicts its four neighbours from the local steps, which follow perspective and distortion as
    the lattice grows.

    Parameters
    ----------
    points : (n, 2) array
        Dot centres in pixels.

    Returns
    -------
    index : (m,) int array
        Points on the lattice.
    labels : (m, 2) int array
        Their places, up to a shift and a turn by a multiple of 90°; never mirrored (+x turns to +y as +u to +v).
    """
    if len(points) < 5:
        return np.empty(0, np.intp), np.empty((0, 2), np.int64)
    tree = cKDTree(points)
    middle = np.argsort(np.linalg.norm(points - np.median(points, axis=0), axis=1))
    best: dict[int, tuple[int, int]] = {}
    for seed in middle[:_SEEDS]:
        grown = _grow(points, tree, int(seed))
        if len(grown) > len(best):
            best = grown
        if len(best) > 0.9 * len(points):
            break
    index = np.array(list(best), np.intp)
    return index, np.array(list(best.values()), np.int64).reshape(-1, 2)


def _grow(points: Array, tree: cKDTree, seed: int) -> dict[int, tuple[int, int]]:
    basis = _seed_basis(points, tree, seed)
    if basis is None:
        return {}
    labels, taken, steps = {seed: (0, 0)}, {(0, 0)}, {seed: basis}
    queue = deque([seed])
    while queue:
        at = queue.popleft()
        for i, j in _STEPS:
            place = (labels[at][0] + i, labels[at][1] + j)
            if place in taken:
                continue
            step = np.array([i, j]) @ steps[at]
            distance, found = tree.query(points[at] + step)
            if found in labels or distance > _NEAR * np.linalg.norm(step):
                continue
            labels[found] = place
            taken.add(place)
            steps[found] = _updated(steps[at], (i, j), points[found] - points[at])
            queue.append(found)
    return labels


def _seed_basis(points: Array, tree: cKDTree, seed: int) -> Array | None:
    """(2, 2) rows: the steps to two neighbours that have opposite ones; None where the seed has no such four."""
    _, near = tree.query(points[seed], k=min(9, len(points)))
    offsets = points[near[1:]] - points[seed]
    opposed = [
        (offsets[a] - offsets[b]) / 2
        for a in range(len(offsets))
        for b in range(a + 1, len(offsets))
        if np.linalg.norm(offsets[a] + offsets[b]) < _NEAR * np.linalg.norm(offsets[a])
    ]
    opposed.sort(key=lambda step: float(np.linalg.norm(step)))
    if not opposed:
        return None
    first = opposed[0]
    for second in opposed[1:]:
        area = first[0] * second[1] - first[1] * second[0]
        if abs(area) > 0.5 * np.linalg.norm(first) * np.linalg.norm(second):
            # A diagonal, where the nearer neighbours are missing, spans the same lattice: take the squarest step.
            second = second - np.rint(second @ first / (first @ first)) * first
            return np.stack([first, second if area > 0 else -second])
    return None


def _updated(basis: Array, direction: tuple[int, int], step: Array) -> Array:
    """The basis with the step just seen; half of it is carried over, so that one bad dot does not mislead it."""
    axis = 0 if direction[0] else 1
    new = basis.copy()
    new[axis] = (basis[axis] + step * (direction[0] + direction[1])) / 2
    return new


def turned(labels: Labels, quarter_turns: int) -> Labels:
    """Labels after a number of quarter turns (x, y) → (−y, x)."""
    for _ in range(quarter_turns % 4):
        labels = np.column_stack([-labels[:, 1], labels[:, 0]])
    return labels


def diagonal_to_grid(labels: Labels) -> Labels:
    """Places of an asymmetric grid, whose nearest neighbours lie on the diagonals, as (x, y) in whole spacings."""
    return np.column_stack([labels[:, 0] - labels[:, 1], labels[:, 0] + labels[:, 1]])

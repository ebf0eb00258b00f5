"""Straight pieces of chains by RANSAC, and pieces joined into lines (paper §3.2, steps 2 and 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TRIALS = 12
# How long a piece of a line tells its direction at the end, px.
_END_PX = 60.0
# Two pieces may overlap so far, px.
_OVERLAP_PX = 12.0
# An end's direction is as good as its points: a lateral offset of this much per px of gap is within it.
_OFFSET_PER_GAP = 0.04


def straight_pieces(chain: Array, tolerance: float, min_length: float, generator: np.random.Generator) -> list[Array]:
    """Runs of a chain that lie within a tolerance of a straight line.

    Parameters
    ----------
    chain : (n, k) ndarray
        u, v first.
    tolerance, min_length : float
        px.
    generator : numpy.random.Generator
        Draws the samples.
    """
    pieces, waiting = [], [chain]
    while waiting:
        part = waiting.pop()
        if len(part) < 4 or np.linalg.norm(part[-1, :2] - part[0, :2]) < 0.6 * min_length:
            continue
        first, end = _longest_run(part[:, :2], tolerance, generator)
        if np.linalg.norm(part[end - 1, :2] - part[first, :2]) < min_length:
            continue
        pieces.append(part[first:end])
        waiting += [part[:first], part[end:]]
    return pieces


def _longest_run(points: Array, tolerance: float, generator: np.random.Generator) -> tuple[int, int]:
    """First and end index of the longest run of neighbours within the tolerance of a line through two of the points.

    The first sample is both ends, which settles the matter for what is straight already.
    """
    n = len(points)
    pairs = np.concatenate([[[0, n - 1]], generator.integers(0, n, (_TRIALS, 2))])
    best = (0, 0)
    for sampled in (pairs[:1], pairs[1:]):
        along = points[sampled[:, 1]] - points[sampled[:, 0]]
        length = np.linalg.norm(along, axis=1, keepdims=True)
        away = points[None] - points[sampled[:, 0], None]
        # Two samples in one place make no line: no point lies on it.
        outside = np.abs(away[..., 1] * along[:, None, 0] - away[..., 0] * along[:, None, 1]) > tolerance * length
        outside |= length == 0
        for row in outside:
            borders = np.flatnonzero(np.concatenate([[True], row, [True]]))
            runs = np.diff(borders) - 1
            k = int(runs.argmax())
            if runs[k] > best[1] - best[0]:
                best = (int(borders[k]), int(borders[k] + runs[k]))
        if best == (0, n):
            break
    return best


@dataclass(frozen=True)
class _End:
    """An end of a piece: where it is (smoothed), the direction in which the line leaves, and the piece's length."""

    place: Array
    outward: Array
    length: float


def join_pieces(pieces: Sequence[Array], max_gap: float, tolerance: float, max_bend: float) -> list[Array]:
    """Pieces joined end to end, nearest ends first, where they continue each other.

    Parameters
    ----------
    pieces : sequence of (n, k) ndarray
        u, v first.
    max_gap : float
        px; half the shorter piece's length is bridged besides, over which its direction still holds.
    tolerance : float
        Lateral offset of one end from the other's line, px, for touching ends.
    max_bend : float
        Angle between the ends, radians.
    """
    lines = [np.asarray(piece) for piece in pieces]
    ends = [(_end(line, 0), _end(line, 1)) for line in lines]
    while True:
        match = _best_joint(ends, max_gap, tolerance, max_bend)
        if match is None:
            return lines
        i, end_i, j, end_j = match
        head = lines[i] if end_i == 1 else lines[i][::-1]
        tail = lines[j] if end_j == 0 else lines[j][::-1]
        joined = _spliced(head, tail)
        kept = [k for k in range(len(lines)) if k not in (i, j)]
        lines = [lines[k] for k in kept] + [joined]
        ends = [ends[k] for k in kept] + [(_end(joined, 0), _end(joined, 1))]


def _best_joint(
    ends: Sequence[tuple[_End, _End]], max_gap: float, tolerance: float, max_bend: float
) -> tuple[int, int, int, int] | None:
    """(line, end, line, end) of the two ends that continue each other best; end 0 is the first point, 1 the last."""
    if len(ends) < 2:
        return None
    flat = [end for pair in ends for end in pair]
    owner = np.arange(len(flat)) // 2
    place = np.array([end.place for end in flat])
    outward = np.array([end.outward for end in flat])
    length = np.array([end.length for end in flat])
    gap_vector = place[None] - place[:, None]
    gap = np.einsum("ijk,ik->ij", gap_vector, outward)
    offset_here = np.abs(gap_vector[..., 0] * outward[:, None, 1] - gap_vector[..., 1] * outward[:, None, 0])
    offset_there = np.abs(gap_vector[..., 0] * outward[None, :, 1] - gap_vector[..., 1] * outward[None, :, 0])
    offset = np.maximum(offset_here, offset_there)
    facing = -(outward @ outward.T)
    allowed = (
        (owner[:, None] != owner[None])
        & (gap > -_OVERLAP_PX)
        & (gap < max_gap + 0.5 * np.minimum(length[:, None], length[None]))
        & (facing > np.cos(max_bend))
        & (offset < tolerance + _OFFSET_PER_GAP * np.abs(gap))
    )
    price = np.where(allowed, np.abs(gap) + 5 * offset, np.inf)
    k = int(price.argmin())
    if not np.isfinite(price.flat[k]):
        return None
    a, b = divmod(k, len(flat))
    return a // 2, a % 2, b // 2, b % 2


def _end(line: Array, end: int) -> _End:
    points = line[:, :2] if end == 1 else line[::-1, :2]
    near = points[np.linalg.norm(points - points[-1], axis=1) < _END_PX]
    middle = near.mean(axis=0)
    _, _, axes = np.linalg.svd(near - middle, full_matrices=False)
    direction = axes[0] if (near[-1] - near[0]) @ axes[0] >= 0 else -axes[0]
    place = middle + ((points[-1] - middle) @ direction) * direction
    return _End(place, direction, float(np.linalg.norm(points[-1] - points[0])))


def _spliced(head: Array, tail: Array) -> Array:
    """Head, then tail without what it repeats."""
    direction = head[-1, :2] - head[max(0, len(head) - 20), :2]
    ahead = (tail[:, :2] - head[-1, :2]) @ direction > 0
    first = int(np.argmax(ahead)) if ahead.any() else len(tail) - 1
    return np.concatenate([head, tail[first:]])

"""Straight pieces of chains by RANSAC, and pieces joined into lines (paper §3.2, steps 2 and 3)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array
from metrology.jit import kernel

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
        # Both ends first, which settles the matter for what is straight already.
        pairs = np.concatenate([[[0, len(part) - 1]], generator.integers(0, len(part), (_TRIALS, 2))])
        first, end = _longest_run(part[:, :2], pairs, tolerance)
        if np.linalg.norm(part[end - 1, :2] - part[first, :2]) < min_length:
            continue
        pieces.append(part[first:end])
        waiting += [part[:first], part[end:]]
    return pieces


@kernel
def _longest_run(points, pairs, tolerance):  # type: ignore[no-untyped-def]
    """First and end index of the longest run of neighbours within the tolerance of a line through one of the pairs."""
    first, end = 0, 0
    for k in range(pairs.shape[0]):
        u, v = points[pairs[k, 0], 0], points[pairs[k, 0], 1]
        along_u, along_v = points[pairs[k, 1], 0] - u, points[pairs[k, 1], 1] - v
        most = tolerance * math.sqrt(along_u * along_u + along_v * along_v)
        begin = 0
        for i in range(points.shape[0]):
            # Two samples in one place make no line: no point lies on it.
            if not abs((points[i, 1] - v) * along_u - (points[i, 0] - u) * along_v) <= most or most == 0.0:
                begin = i + 1
            elif i + 1 - begin > end - first:
                first, end = begin, i + 1
        if end - first == points.shape[0]:
            break
    return first, end


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
    near = points[np.hypot(*(points - points[-1]).T) < _END_PX]
    middle = near.mean(axis=0)
    u, v = (near - middle).T
    # Of the largest scatter.
    angle = 0.5 * math.atan2(2.0 * float(u @ v), float(u @ u - v @ v))
    direction = np.array([math.cos(angle), math.sin(angle)])
    if (near[-1] - near[0]) @ direction < 0:
        direction = -direction
    place = middle + ((points[-1] - middle) @ direction) * direction
    return _End(place, direction, float(np.linalg.norm(points[-1] - points[0])))


def _spliced(head: Array, tail: Array) -> Array:
    """Head, then tail without what it repeats."""
    direction = head[-1, :2] - head[max(0, len(head) - 20), :2]
    ahead = (tail[:, :2] - head[-1, :2]) @ direction > 0
    first = int(np.argmax(ahead)) if ahead.any() else len(tail) - 1
    return np.concatenate([head, tail[first:]])

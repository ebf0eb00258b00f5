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
    ends = [_end(line, end) for line in lines for end in (0, 1)]
    limits = (max_gap, tolerance, max_bend)
    prices = _prices(ends, ends, limits)
    while prices.size and np.isfinite(prices.flat[best := int(prices.argmin())]):
        a, b = divmod(best, len(ends))
        head = lines[a // 2] if a % 2 == 1 else lines[a // 2][::-1]
        tail = lines[b // 2] if b % 2 == 0 else lines[b // 2][::-1]
        joined = _spliced(head, tail)
        kept = [k for k in range(len(lines)) if k not in (a // 2, b // 2)]
        stay = np.repeat(2 * np.array(kept, int), 2) + np.tile((0, 1), len(kept))
        lines = [lines[k] for k in kept] + [joined]
        old, new = [ends[k] for k in stay], [_end(joined, 0), _end(joined, 1)]
        ends = old + new
        prices = np.block(
            [
                [prices[np.ix_(stay, stay)], _prices(old, new, limits)],
                [_prices(new, old, limits), np.full((2, 2), np.inf)],
            ]
        )
    return lines


def _prices(here: Sequence[_End], there: Sequence[_End], limits: tuple[float, float, float]) -> Array:
    """(n, m) what it costs to continue from an end here to one there; infinite where they do not continue each other.

    Of the same ends on both sides, two to a line, a line's own do not.
    """
    max_gap, tolerance, max_bend = limits
    if not here or not there:
        return np.empty((len(here), len(there)))
    place, other_place = (np.array([end.place for end in ends]) for ends in (here, there))
    (out_u, out_v), (other_u, other_v) = (np.array([end.outward for end in ends]).T for ends in (here, there))
    out_u, out_v = out_u[:, None], out_v[:, None]
    length, other_length = (np.array([end.length for end in ends]) for ends in (here, there))
    gap_u, gap_v = (other_place[None, :, k] - place[:, None, k] for k in (0, 1))
    gap = gap_u * out_u + gap_v * out_v
    offset = np.maximum(np.abs(gap_u * out_v - gap_v * out_u), np.abs(gap_u * other_v - gap_v * other_u))
    facing = -(out_u * other_u + out_v * other_v)
    allowed = (
        (gap > -_OVERLAP_PX)
        & (gap < max_gap + 0.5 * np.minimum(length[:, None], other_length))
        & (facing > np.cos(max_bend))
        & (offset < tolerance + _OFFSET_PER_GAP * np.abs(gap))
    )
    if here is there:
        owner = np.arange(len(here)) // 2
        allowed &= owner[:, None] != owner
    return np.where(allowed, np.abs(gap) + 5 * offset, np.inf)


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

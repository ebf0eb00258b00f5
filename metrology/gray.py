"""Gray-code stripes that tell the fringe order: other people's stereo scans have them beside the fringes.

The projector's pixels 0 … W − 1 along the fringe axis fall into S equal stripes, numbered j = ⌊S (x + ½)/W⌋; frame b,
counted from the most significant bit, is bright where bit b of ``j ^ (j >> 1)`` is set. A stripe's number is wrong by
at most one beside its own border, where the phase knows better: with at least two stripes per fringe the nearest order
is right everywhere; with fewer, pixels close to a phase wrap take the order that continues their surest neighbour's.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from metrology.fringe import GrayCode
from metrology.jit import kernel

# With fewer stripes per fringe than this a stripe border may coincide with a phase wrap.
_SURE_STRIPES_PER_FRINGE = 2
# Of the coarse bits' swing: what a bit must have for its stripes to be told apart.
_RESOLVED = 0.4
# Of neighbours, how many see the same stripe or the next: where stripes are narrower than pixels, fewer do.
_FOLLOWING = 0.7
# Of neighbours, how many see the same stripe. Where stripes are narrower than 4/3 pixels fewer do, and neighbours skip
# stripes; stripes of twice the width have a border every third pixel and tell places as well.
_SAME = 0.25
# A pixel is sure of its order where its phase is at least this share of a fringe away from the wrap.
_SURE_SHARE = 0.25


def stripe_positions(
    frames: NDArray, gray: GrayCode, reference: NDArray, exposures: Sequence[float], saturation: float
) -> NDArray[np.float32]:
    """Middle of the stripe that every pixel sees, as a share of the projector's size.

    Parameters
    ----------
    frames : (exposures, gray.frames, h, w) ndarray of uint8 or uint16
        Most significant bit first; with `gray.inverse` every frame is followed by its inverse.
    reference : (h, w) ndarray
        Level between dark and bright at exposure 1 (the mean of the fringe frames), for frames without inverse.
    saturation : float
        Grey level from which a sample counts as saturated.

    Returns
    -------
    (h, w) float32
    """
    height, width = frames.shape[2:]
    position = np.empty((height, width), np.float32)
    level = np.ascontiguousarray(reference, np.float32)
    times = np.array(exposures, float)
    _read_stripes(frames, gray.bits, gray.inverse, gray.stripes, gray.shift, level, times, float(saturation), position)
    return position


def stripe_numbers(bits: Iterable[NDArray[np.bool_]]) -> NDArray[np.int64]:
    """(h, w) numbers of stripes, from the (h, w) bits of their Gray code, the most significant one first."""
    number, bit = np.zeros((), np.int64), np.zeros((), np.bool_)
    for one in bits:
        bit = bit ^ one
        number = 2 * number + bit
    return number


def resolved_bits(swing: NDArray, lit: NDArray[np.bool_]) -> int:
    """How many bits, from the most significant one on, have stripes that the camera resolves.

    Stripes finer than the camera's blur leave no more than noise of their bit's swing; of stripes finer than its pixels
    neighbours skip some.

    Parameters
    ----------
    swing : (bits, h, w) array
        Each bit's level less that between dark and bright.
    lit : (h, w) bool array
    """
    if not lit.any():
        return len(swing)
    sizes = np.array([np.median(np.abs(bit[lit][::7])) for bit in swing])
    poor = sizes < _RESOLVED * sizes.max()
    finest = len(swing)
    while finest > 1 and (poor[finest - 1] or not _follow(swing[:finest], lit)):
        finest -= 1
    return finest


def _follow(swing: NDArray, lit: NDArray[np.bool_]) -> bool:
    """Whether lit neighbours see the same stripe, often, or the next one, mostly, along both image directions."""
    for axis in (0, 1):
        thin = np.s_[:, ::7] if axis == 0 else np.s_[::7]
        number, seen = stripe_numbers(bit[thin] > 0 for bit in swing), lit[thin]
        both = seen[1:] & seen[:-1] if axis == 0 else seen[:, 1:] & seen[:, :-1]
        steps = np.abs(np.diff(number, axis=axis))[both]
        if steps.size and (np.mean(steps <= 1) < _FOLLOWING or np.mean(steps == 0) < _SAME):
            return False
    return True


def continue_orders(coordinate: NDArray[np.float32], count: int, gray: GrayCode, size: int) -> None:
    """Mend, in place, fringe orders beside phase wraps where the stripes are too wide to settle them.

    Parameters
    ----------
    coordinate : (h, w) ndarray
        Projector pixels; changed by whole fringes.
    count : int
        Fringes of the count that the stripes unwrap.
    size : int
        Projector pixels along the fringe axis.
    """
    if gray.stripes >= _SURE_STRIPES_PER_FRINGE * count:
        return
    along_rows = runs_along_rows(coordinate)
    lines = coordinate if along_rows else np.ascontiguousarray(coordinate.T)
    # The borders that may be off lie `shift` stripes beyond the wraps.
    _continue_along(lines, np.float32(size / count), np.float32(gray.shift * count / gray.stripes))
    coordinate[:] = lines if along_rows else lines.T


def runs_along_rows(coordinate: NDArray[np.float32]) -> bool:
    """Whether a coordinate (h, w) changes more along an image's rows than along its columns; cameras may be turned."""
    steps = [np.abs(np.diff(coordinate[::8], axis=1)), np.abs(np.diff(coordinate[:, ::8], axis=0))]
    along, down = (float(np.mean(step[np.isfinite(step)])) if np.isfinite(step).any() else 0.0 for step in steps)
    return along >= down


@kernel
def _read_stripes(frames, bits, inverse, stripes, shift, reference, exposures, saturation, position):  # type: ignore[no-untyped-def]
    height, width = position.shape
    per_bit = 2 if inverse else 1
    for y in range(height):
        for x in range(width):
            number = 0
            previous = 0
            for b in range(bits):
                # The exposure with the clearest difference decides.
                best = 0.0
                for e in range(exposures.size):
                    value = float(frames[e, b * per_bit, y, x])
                    other = float(frames[e, b * per_bit + 1, y, x]) if inverse else reference[y, x] * exposures[e]
                    if other < saturation and abs(value - other) > abs(best):
                        best = value - other
                previous ^= 1 if best > 0.0 else 0
                number = 2 * number + previous
            position[y, x] = (min(number, stripes - 1) + 0.5 + shift) / stripes


@kernel
def _continue_along(coordinate, fringe, border):  # type: ignore[no-untyped-def]
    """Per line: pixels near a phase wrap continue from the sure pixel before them, else from the one after."""
    lines, length = coordinate.shape
    reach = int(2 * fringe) + 1
    settled = np.empty(length, np.bool_)
    for i in range(lines):
        for j in range(length):
            share = (coordinate[i, j] + 0.5) / fringe - border
            share -= np.floor(share)
            settled[j] = _SURE_SHARE < share < 1.0 - _SURE_SHARE
        for turn in range(2):
            known = np.nan
            since = reach
            for step in range(length):
                j = step if turn == 0 else length - 1 - step
                value = coordinate[i, j]
                since += 1
                if settled[j]:
                    since = 0
                elif value == value and since < reach:
                    value += np.rint((known - value) / fringe) * fringe
                    coordinate[i, j] = value
                    settled[j] = True
                if value == value:
                    known = value

"""Stripes that count in plain binary in place of Gray code.

In Gray code one bit changes at each border of stripes. In plain binary the lowest bits change together, 0111 to 1000,
and a camera that sees them cross at places a little apart reads numbers that are neither. Which bit is the highest that
crosses tells the border; the same border of Gray code is crossed by that bit alone, and there by the same levels. So
frames of plain binary become those of Gray code, borders unmoved.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.fringe import FringeCode

# Shares of half the difference of dark and bright. Bits nearer to the level between them than this may be misread …
_UNSURE = 0.25
# … and those that cross at the same place, which noise makes differ a little, are nearer than this.
_CROSSING = 0.5
# What bits below the highest crossing one are given, for which noise and rounding then decide nothing; bits that the
# camera does not resolve stay so.
_CLEAR = 0.25
_NEAR = np.ones((7, 7), np.uint8)  # pixels


def gray_from_binary(frames: NDArray, code: FringeCode) -> NDArray:
    """The frames as they would be under Gray code.

    Parameters
    ----------
    frames : (exposures, code.frames, h, w) ndarray of uint8 or uint16
        Fringes, then bits of plain binary from the most significant one on, then white and black, as `code` has them.

    Returns
    -------
    (exposures, code.frames, h, w) ndarray
        Of the same type.
    """
    gray = code.gray
    assert gray is not None
    turned = frames.copy()
    first = code.fringe_frames
    for exposure, out in zip(frames, turned, strict=True):
        stripes = exposure[first : first + gray.stripe_frames].astype(np.float32)
        if gray.inverse:
            swing, middle = 0.5 * (stripes[::2] - stripes[1::2]), 0.5 * (stripes[::2] + stripes[1::2])
        else:
            level = _level(exposure, stripes, code)
            swing, middle = stripes - level, np.broadcast_to(level, stripes.shape)
        swing = gray_swings(swing)
        pairs = [middle + swing, middle - swing] if gray.inverse else [middle + swing]
        both = np.stack(pairs, axis=1).reshape(stripes.shape)
        out[first : first + gray.stripe_frames] = np.clip(np.rint(both), 0, np.iinfo(frames.dtype).max)
    return turned


def binary_from_gray(lines: NDArray[np.float64], code: FringeCode) -> NDArray[np.float64]:
    """(frames, n) values that a projector shows in plain binary, from those of Gray code (`FringeCode.lines`)."""
    gray = code.gray
    assert gray is not None
    turned, first = lines.copy(), code.fringe_frames
    own = slice(first, first + gray.stripe_frames)
    bits = np.cumsum(lines[own][:: 2 if gray.inverse else 1], axis=0) % 2
    turned[own] = np.stack([bits, 1 - bits], axis=1).reshape(-1, lines.shape[1]) if gray.inverse else bits
    return turned


def _level(exposure: NDArray, stripes: NDArray[np.float32], code: FringeCode) -> NDArray[np.float32]:
    """(h, w) level between dark and bright, as the decoding has it."""
    if code.gray and code.gray.references:
        return 0.5 * (exposure[-2].astype(np.float32) + exposure[-1])
    if code.counts:
        return np.asarray(exposure[: code.fringe_frames].mean(0, dtype=np.float32))
    return np.asarray(0.5 * (stripes.max(0) + stripes.min(0)))


def gray_swings(swing: NDArray[np.float32]) -> NDArray[np.float32]:
    """(bits, h, w) levels about the middle, of Gray code from those of plain binary.

    Above the highest crossing bit m, and of m itself, bit k of Gray code is the exclusive or of bits k − 1 and k. Below
    it all bits are alike on either side of the border, and m is their opposite: 1 of the next one, 0 of the others.
    """
    half = np.asarray(cv2.dilate(np.abs(swing).max(0), _NEAR))  # where all bits cross, neighbours tell it
    crossing, bits = np.abs(swing) < _CROSSING * half, len(swing)
    unsure = (np.abs(swing) < _UNSURE * half).any(0)
    highest = np.where(unsure, crossing.argmax(0), bits)
    turned = swing.copy()
    for k in range(1, bits):
        turned[k] = np.where(swing[k - 1] > 0, -swing[k], swing[k])
        below = k > highest
        strength = np.maximum(np.abs(swing[k]), _CLEAR * half)
        turned[k][below] = (np.where(k == highest + 1, 1.0, -1.0) * strength)[below]
    return turned

"""The grey level from which a sample is saturated, told from the frames themselves.

A camera clips where its range ends, and that need not be where the file's does: 12 bits lie in files of 16, video
levels end at 235, a gain may end anywhere. What is clipped piles up in the last level of the histogram that is in use.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.fringe import FringeCode

_SAMPLED_PIXELS = 30_000  # of a frame: enough to see a ten-thousandth of all samples
_BITS = (8, 10, 12, 14)  # of cameras whose samples lie in 16
# Stamped and hot pixels beyond the camera's range: at most this share of all samples, and of these next to none in the
# quarter next to the range, where glints of a wider range would go on.
_FEW = 1e-3
_NEXT_TO_NONE = 0.03
_LEVELS = 256  # a pile-up is looked for in steps of this share of the range
_STRAY = (1e-3, 2e-4)  # shares of the samples that may lie above a pile-up
_LEAST_SHARE = 5e-4
# The crest of a noiseless fringe on an even surface fills its last level 2.4 times as much as the one below; noise
# and texture make that less.
_LEAST_RATIO = 3.0
_BELOW = 4
# Share of pixels that lie within a rounding step of the line through their neighbours: 0.7 with noise of half a step.
_NOISELESS = 0.9


def saturation_level(frames: NDArray, pictures: NDArray | None = None) -> float:
    """Grey level from which a sample counts as saturated: where samples pile up, else the top 1/255 of the range.

    The range of 16-bit frames is told from their largest samples (10, 12, 14 or 16 bits, as cameras have them), a few
    stamped or hot pixels left out.

    Parameters
    ----------
    frames : (exposures, n, h, w) ndarray of uint8 or uint16
        All frames of one camera; the range is told from these.
    pictures : (exposures, m, h, w) ndarray of uint8 or uint16, optional
        The frames among them in which a pile-up can only come from clipping, such as fringes: an even surface that a
        Gray-code frame lights evenly is all of one level. All by default.
    """
    full = _camera_range(frames)
    levels = (_pile_up(exposure, full) for exposure in (frames if pictures is None else pictures))
    return min(full * 254 / 255, *levels)


def code_saturation(frames: NDArray, code: FringeCode) -> float:
    """`saturation_level` of the (exposures, code.frames, h, w) frames of a code: stripes tell the range alone."""
    return saturation_level(frames, frames[:, : code.fringe_frames])


def _camera_range(frames: NDArray) -> int:
    """Largest sample that the camera can give."""
    if frames.dtype == np.uint8:
        return 255
    counts = np.bincount(sampled(frames).ravel(), minlength=2**16)
    above = counts[::-1].cumsum()[::-1]  # samples at a level or above
    for bits in _BITS:
        end = 2**bits
        beyond, between = above[end], above[end] - above[end * 5 // 4]
        if beyond <= _FEW * above[0] and between <= max(1, _NEXT_TO_NONE * beyond):
            return end - 1
    return 2**16 - 1


def _pile_up(frames: NDArray, full: int) -> float:
    """Level at which the samples of (n, h, w) frames pile up below the end of the range; infinite where none do."""
    counts = np.bincount(sampled(frames).ravel(), minlength=full + 1)[: full + 1]
    above = counts[::-1].cumsum()[::-1]
    for stray in _STRAY:
        # A pile-up ends at the highest level that more than stray samples reach.
        level = _last_step(counts, int(np.count_nonzero(above > stray * above[0])) - 1)
        if level is not None and not _is_noiseless(frames, level):
            return float(level)
    return np.inf


def _last_step(counts: NDArray[np.intp], top: int) -> int | None:
    """Lowest level of the step of the range that ends at `top`, if samples pile up in it."""
    width = len(counts) // _LEVELS
    level = top - width + 1
    if level < 0:
        return None
    steps = counts[level % width : top + 1].reshape(-1, width).sum(1)
    below = steps[:-1][steps[:-1] > 0][-_BELOW:]
    if len(below) < _BELOW or steps[-1] < max(_LEAST_SHARE * counts.sum(), _LEAST_RATIO * below.max()):
        return None
    return level


def _is_noiseless(frames: NDArray, level: int) -> bool:
    """Whether a picture is smooth to a rounding step below a level, as it is if no camera took it."""
    first, middle, last = (sampled(frames[..., k : frames.shape[-1] - 2 + k]).astype(np.int32) for k in range(3))
    below = np.maximum(np.maximum(first, middle), last) < level
    if not below.any():
        return True
    step = np.gcd.reduce(middle[below])
    bend = np.abs(first + last - 2 * middle)[below]
    return bool(np.mean(bend <= step) > _NOISELESS)


def sampled(frames: NDArray) -> NDArray:
    """Every so many rows and columns of (…, h, w) frames, enough for a histogram."""
    stride = max(1, int(np.sqrt(frames.shape[-2] * frames.shape[-1] / _SAMPLED_PIXELS)))
    return frames[..., ::stride, ::stride]

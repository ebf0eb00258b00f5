"""Gray code alone: the projector coordinate between the stripes' borders, which are found to a part of a pixel.

Stripe numbers are whole. Neighbouring stripes differ in one bit, and where the brightness of that bit's frame crosses
the level between dark and bright lies their border; the coordinate is known there, and runs straight between borders.
What borders scatter about a smooth course says how well they are known, whatever the cause.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from metrology.arrays import Float32
from metrology.cloud import DecodedView, PixelFlag
from metrology.fringe import FringeCode, GrayCode
from metrology.gray import resolved_bits, runs_along_rows, stripe_numbers
from metrology.jit import kernel
from metrology.noise import stripe_noise
from metrology.reconstruction_settings import ReconstructionSettings
from metrology.robust import MAD

_LIT_SIGMAS = 5.0  # of a sample's noise: what half the difference of dark and bright must exceed
_EVEN = 12.0**-0.5  # standard deviation of an even spread over one stripe
_LEAST_SIGMA_PX = 0.01
_CLEAR = 0.98  # of full light: pixels nearer to it are no farther from the border than that


def decode_stripes(
    frames: NDArray,
    code: FringeCode,
    projector_size: int,
    exposures: Sequence[float],
    settings: ReconstructionSettings,
    saturation: float,
) -> DecodedView:
    """Projector coordinate, its standard deviation, modulation, texture and flags of a code without fringes.

    Parameters
    ----------
    frames : (exposures, code.frames, h, w) ndarray of uint8 or uint16
    code : FringeCode
        Without counts.
    projector_size : int
        Projector pixels along the fringe axis.
    exposures : sequence of float
        Exposure times relative to exposure 1.
    saturation : float
        Grey level from which a sample counts as saturated.
    """
    assert code.gray is not None
    levels, clipped = _one_exposure(frames, exposures, saturation)
    swing, texture, half = _swings(levels, code.gray)
    noise = stripe_noise(levels, swing[:2], code.gray, saturation)
    sigma = noise.sigma(np.maximum(texture, 0)).astype(np.float32)
    dark = half < np.maximum(settings.min_modulation * saturation / 254, _LIT_SIGMAS * sigma)
    flags = np.where(dark, int(PixelFlag.LOW_MODULATION), 0).astype(np.uint16)
    if not code.gray.inverse:  # a frame and its inverse cross between dark and bright, however bright that is
        flags |= np.where(clipped, int(PixelFlag.SATURATED), 0).astype(np.uint16)
    bits = resolved_bits(swing, flags == 0)
    merged = 2 ** (code.gray.bits - bits)  # stripes of the code in one that is told apart
    number = np.where(flags == 0, _numbers(swing[:bits], -(-code.gray.stripes // merged)), -1).astype(np.int32)
    place, scatter = _between_borders(swing[:bits], half, number)
    stripe = projector_size / code.gray.stripes * merged
    coordinate = place * np.float32(stripe) + np.float32(code.gray.shift * stripe / merged - 0.5)
    deviation = np.where(np.isfinite(coordinate), np.maximum(scatter * stripe, 1e-4), np.nan).astype(np.float32)
    cross = code.gray.inverse
    return DecodedView(coordinate.astype(np.float32), deviation, half, texture, flags, noise, stripe, cross)


def _one_exposure(frames: NDArray, exposures: Sequence[float], saturation: float) -> tuple[Float32, NDArray[np.bool_]]:
    """(frames, h, w) levels at exposure 1, from each pixel's longest exposure that does not clip, and which clip."""
    order = np.argsort(exposures)
    levels = frames[order[0]].astype(np.float32) / np.float32(exposures[order[0]])
    clipped = frames[order[0]].max(0) >= saturation
    for e in order[1:]:
        good = frames[e].max(0) < saturation
        levels[:, good] = frames[e][:, good].astype(np.float32) / np.float32(exposures[e])
    return levels, clipped


def _swings(levels: Float32, gray: GrayCode) -> tuple[Float32, Float32, Float32]:
    """(bits, h, w) each bit's level less that between dark and bright, that level, and half their difference."""
    if gray.inverse:
        bright, dark = levels[0 : gray.stripe_frames : 2], levels[1 : gray.stripe_frames : 2]
        swing = 0.5 * (bright - dark)
        return swing, 0.5 * (bright + dark).mean(0), np.abs(swing).max(0)
    stripes = levels[: gray.bits]
    high, low = (levels[-2], levels[-1]) if gray.references else (stripes.max(0), stripes.min(0))
    middle = 0.5 * (high + low)
    return stripes - middle, middle, 0.5 * (high - low)


def _numbers(swing: Float32, stripes: int) -> NDArray[np.int64]:
    """(h, w) stripe numbers; −1 for those that the code does not have."""
    number = stripe_numbers(swing > 0)
    return np.where(number < stripes, number, -1)


def _between_borders(swing: Float32, half: Float32, number: NDArray[np.int32]) -> tuple[Float32, Float32]:
    """(h, w) place in stripes and its standard deviation; a stripe's middle where its borders are not seen."""
    along_rows = runs_along_rows(np.where(number < 0, np.nan, number).astype(np.float32))
    lines = number if along_rows else np.ascontiguousarray(number.T)
    bits = swing if along_rows else np.ascontiguousarray(swing.transpose(0, 2, 1))
    full = half if along_rows else np.ascontiguousarray(half.T)
    place, gradient = np.full(lines.shape, np.nan, np.float32), np.zeros(lines.shape, np.float32)
    course = np.full((3, *lines.shape), np.nan, np.float32)
    _place(lines, bits, full, place, gradient, course)
    sigma_px = np.float32(max(_between_sigma(course), _LEAST_SIGMA_PX))
    scatter = np.where(gradient > 0, gradient * sigma_px, np.float32(_EVEN))
    return (place, scatter) if along_rows else (np.ascontiguousarray(place.T), np.ascontiguousarray(scatter.T))


def _between_sigma(course: Float32) -> float:
    """Standard deviation of places between borders, pixels, from differences of the borders' course.

    Borders err at random by σ, and by ±a in turn, since a blurred border of the finest bit leans the other way than its
    neighbours; and their course bends by c. Differences over three borders have the variance 6 σ² + 16 a² + c², over
    four 20 σ² + 64 a², and 10 σ² over five that leave out what comes in turn. What is interpolated between two borders
    has 2 σ²/3 + a²/3 + c²/120.
    """
    bend, third, plain = (_robust_variance(values) for values in course)
    if bend is None or third is None or plain is None:
        return 0.5
    random = plain / 10
    in_turn = max(third - 20 * random, 0.0) / 64
    curved = max(bend - 6 * random - 16 * in_turn, 0.0)
    return float(np.sqrt(2 * random / 3 + in_turn / 3 + curved / 120))


def _robust_variance(values: Float32) -> float | None:
    seen = values[np.isfinite(values)]
    return (MAD * float(np.median(np.abs(seen)))) ** 2 if seen.size else None


@njit(inline="always")
def _probit(share):  # type: ignore[no-untyped-def]
    """Standard deviations of its blur that a pixel lies from a border, from its level (−1 … 1); Winitzki's formula."""
    share = min(max(share, -_CLEAR), _CLEAR)
    log = np.log(1.0 - share * share)
    t = 2.0 / (np.pi * 0.147) + 0.5 * log
    value = np.sqrt(max(np.sqrt(t * t - log / 0.147) - t, 0.0))
    return value if share >= 0 else -value


@kernel
def _place(number, swing, half, place, gradient, course):  # type: ignore[no-untyped-def]
    """Place and its gradient (stripes per pixel, 0 where unknown) along lines; differences of borders' course, px."""
    lines, length = number.shape
    bits = swing.shape[0]
    at, value = np.empty(length), np.empty(length)
    for y in range(lines):
        start = 0
        while start < length:
            if number[y, start] < 0:
                start += 1
                continue
            # A run of neighbours whose stripes follow each other.
            end, found = start + 1, 0
            while end < length and number[y, end] >= 0 and abs(number[y, end] - number[y, end - 1]) <= 1:
                a, b = number[y, end - 1], number[y, end]
                if a != b:
                    differ = (a ^ (a >> 1)) ^ (b ^ (b >> 1))
                    bit = 0
                    while differ > 1:
                        differ >>= 1
                        bit += 1
                    before, after = swing[bits - 1 - bit, y, end - 1], swing[bits - 1 - bit, y, end]
                    # A blurred border is a normal distribution's course, which is no straight line between pixels.
                    before, after = _probit(before / half[y, end - 1]), _probit(after / half[y, end])
                    at[found] = end - 1 + before / (before - after)
                    value[found] = max(a, b)
                    found += 1
                end += 1
            even = 1  # borders up to this one that follow each other in one direction
            for i in range(1, found):
                even = even + 1 if i > 1 and value[i] - value[i - 1] == value[i - 1] - value[i - 2] != 0 else 2
                here = int(at[i])
                if even > 2:
                    course[0, y, here] = at[i - 2] - 2 * at[i - 1] + at[i]
                if even > 3:
                    course[1, y, here] = at[i - 3] - 3 * at[i - 2] + 3 * at[i - 1] - at[i]
                if even > 4:
                    course[2, y, here] = at[i - 4] - 2 * at[i - 3] + 2 * at[i - 1] - at[i]
            next_border = 0
            for x in range(start, end):
                while next_border < found and at[next_border] <= x:
                    next_border += 1
                place[y, x] = number[y, x] + 0.5
                if 0 < next_border < found:
                    first, last = next_border - 1, next_border
                    step = value[last] - value[first]
                    if step != 0:
                        slope = step / (at[last] - at[first])
                        place[y, x] = value[first] + slope * (x - at[first])
                        gradient[y, x] = abs(slope)
            start = end

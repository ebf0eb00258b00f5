"""Gray code alone: the projector coordinate between the stripes' borders, which are found to a part of a pixel.

Stripe numbers are whole. Neighbouring stripes differ in one bit, and where the brightness of that bit's frame crosses
the level between dark and bright lies their border; the coordinate is known there, and runs straight between borders.
What borders scatter about a smooth course says how well they are known, whatever the cause.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import DecodedView, PixelFlag
from metrology.fringe import FringeCode, GrayCode
from metrology.gray import resolved_bits, runs_along_rows, stripe_numbers
from metrology.jit import kernel
from metrology.noise import NoiseModel
from metrology.reconstruction_settings import ReconstructionSettings
from metrology.robust import MAD

Float32 = NDArray[np.float32]

_LIT_SIGMAS = 5.0  # of a sample's noise: what half the difference of dark and bright must exceed
_EVEN = 12.0**-0.5  # standard deviation of an even spread over one stripe
_LEAST_SIGMA_PX = 0.01
_CHI2_ONE_MEDIAN = 0.4549  # median of the square of a standard normal value


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
    settings : ReconstructionSettings
    saturation : float
        Grey level from which a sample counts as saturated.
    """
    assert code.gray is not None
    levels, clipped = _one_exposure(frames, exposures, saturation)
    swing, texture, half = _swings(levels, code.gray)
    noise = _noise(levels, code.gray, saturation)
    sigma = noise.sigma(np.maximum(texture, 0)).astype(np.float32)
    dark = half < np.maximum(settings.min_modulation * saturation / 254, _LIT_SIGMAS * sigma)
    flags = np.where(dark, int(PixelFlag.LOW_MODULATION), 0).astype(np.uint16)
    if not code.gray.inverse:  # a frame and its inverse cross between dark and bright, however bright that is
        flags |= np.where(clipped, int(PixelFlag.SATURATED), 0).astype(np.uint16)
    bits = resolved_bits(swing, flags == 0)
    merged = 2 ** (code.gray.bits - bits)  # stripes of the code in one that is told apart
    number = np.where(flags == 0, _numbers(swing[:bits], -(-code.gray.stripes // merged)), -1).astype(np.int32)
    place, scatter = _between_borders(swing[:bits], number)
    stripe = projector_size / code.gray.stripes * merged
    coordinate = place * np.float32(stripe) + np.float32(code.gray.shift * stripe / merged - 0.5)
    deviation = np.where(np.isfinite(coordinate), np.maximum(scatter * stripe, 1e-4), np.nan).astype(np.float32)
    return DecodedView(coordinate.astype(np.float32), deviation, half, texture, flags, noise)


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


def _noise(levels: Float32, gray: GrayCode, saturation: float) -> NoiseModel:
    """Read noise from what frame and inverse add up to, which is the same for every bit; a usual value without."""
    if not gray.inverse or gray.bits < 2:
        return NoiseModel(max(1.0, (saturation / 255.0) ** 2), 0.0)
    total = levels[0 : gray.stripe_frames : 2, ::4, ::4] + levels[1 : gray.stripe_frames : 2, ::4, ::4]
    # The two finest bits are alike in all but noise.
    variance = float(np.median((total[-1] - total[-2]) ** 2)) / _CHI2_ONE_MEDIAN / 4
    return NoiseModel(max(variance, 1 / 12), 0.0)


def _numbers(swing: Float32, stripes: int) -> NDArray[np.int64]:
    """(h, w) stripe numbers; −1 for those that the code does not have."""
    number = stripe_numbers(swing > 0)
    return np.where(number < stripes, number, -1)


def _between_borders(swing: Float32, number: NDArray[np.int32]) -> tuple[Float32, Float32]:
    """(h, w) place in stripes and its standard deviation; a stripe's middle where its borders are not seen."""
    along_rows = runs_along_rows(np.where(number < 0, np.nan, number).astype(np.float32))
    lines = number if along_rows else np.ascontiguousarray(number.T)
    bits = swing if along_rows else np.ascontiguousarray(swing.transpose(0, 2, 1))
    place, gradient = np.full(lines.shape, np.nan, np.float32), np.zeros(lines.shape, np.float32)
    bends, pairs = np.full((2, *lines.shape), np.nan, np.float32)
    _place(lines, bits, place, gradient, bends, pairs)
    sigma_px = np.float32(max(_between_sigma(bends, pairs), _LEAST_SIGMA_PX))
    scatter = np.where(gradient > 0, gradient * sigma_px, np.float32(_EVEN))
    return (place, scatter) if along_rows else (np.ascontiguousarray(place.T), np.ascontiguousarray(scatter.T))


def _between_sigma(bends: Float32, pairs: Float32) -> float:
    """Standard deviation of places between borders, pixels, from how the borders' course bends.

    Borders err at random by σ, and by ±a in turn, since a blurred border of the finest bit leans the other way than its
    neighbours. A bend has the variance 6 σ² + 16 a², two neighbouring ones together 4 σ²; what is interpolated between
    two borders has 2 σ²/3 + a²/3.
    """
    alone, together = (_robust_variance(values) for values in (bends, pairs))
    if alone is None or together is None:
        return 0.5
    random = together / 4
    in_turn = max(alone - 6 * random, 0.0) / 16
    return float(np.sqrt(2 * random / 3 + in_turn / 3))


def _robust_variance(values: Float32) -> float | None:
    seen = values[np.isfinite(values)]
    return (MAD * float(np.median(np.abs(seen)))) ** 2 if seen.size else None


@kernel
def _place(number, swing, place, gradient, bends, pairs):  # type: ignore[no-untyped-def]
    """Place and its gradient (stripes per pixel, 0 where unknown) along lines; bends of the borders' course, px."""
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
                    at[found] = end - 1 + before / (before - after)
                    value[found] = max(a, b)
                    found += 1
                end += 1
            for i in range(1, found - 1):
                step = value[i] - value[i - 1]
                if step == 0 or value[i + 1] - value[i] != step:
                    continue
                bends[y, int(at[i])] = at[i - 1] - 2 * at[i] + at[i + 1]
                if i + 2 < found and value[i + 2] - value[i + 1] == step:
                    pairs[y, int(at[i])] = at[i - 1] - at[i] - at[i + 1] + at[i + 2]
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

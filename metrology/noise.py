"""Camera noise from the frames' own residuals.

A camera's variance rises linearly with the signal (photon transfer): ``var(I) = read_variance + gain · I``, in grey
levels. With N ≥ 4 phase steps a sinusoid leaves N − 3 residuals per pixel that hold no signal. Projector harmonics do
show in them, but they hardly change from one pixel to the next along a fringe, and noise does: the estimate uses the
difference of the residuals of two such neighbours, so that gamma and clipping do not pass for noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import nnls

from metrology.fringe import FringeCode, GrayCode
from metrology.jit import kernel

_BINS = 64
_PAIRS_OF_ROWS = 20
_COLUMN_STRIDE = 2
_LEAST_PIXELS_PER_BIN = 200
# A sample counts if its squared residual is below this many variances; a normal deviate beyond 5 sigma is 1 in 1.7e6.
_CLIP = 25.0
# Rounding to whole grey levels: no camera is quieter …
_QUANTISATION = 1.0 / 12.0
# … but where the light's own noise is below half a level, rounding hides it rather than adds to it.
_ROUNDING_ADDS_NOISE = 0.25
_REWEIGHTINGS = 5
_THIN = 4  # every so many rows and columns of Gray code are looked at
_STRIPE_SIGMAS = 4.0
_CHI2_ONE_MEDIAN = 0.4549  # median of the square of a standard normal value


@dataclass(frozen=True)
class NoiseModel:
    """``var(I) = read_variance + gain · I``."""

    read_variance: float
    """Grey levels squared; read noise and rounding."""
    gain: float
    """Grey levels of variance per grey level of signal (shot noise)."""

    def __post_init__(self) -> None:
        if not (self.read_variance > 0 and self.gain >= 0):
            raise ValueError(f"noise: found {self}, expected a positive read variance and a gain of at least 0")

    def sigma(self, level: ArrayLike) -> NDArray[np.float64]:
        """Standard deviation in grey levels at a signal of `level` grey levels."""
        return np.sqrt(self.read_variance + self.gain * np.asarray(level, float))


def estimate_noise(frames: NDArray, code: FringeCode, saturation: float) -> NoiseModel:
    """Noise model of one camera from its fringe frames.

    Parameters
    ----------
    frames : (exposures, frames, h, w) ndarray of uint8 or uint16
    saturation : float
        Grey level from which a sample counts as saturated.

    Returns
    -------
    NoiseModel
        With three steps the residual is that of the mean levels of two counts; with three steps and one count there is
        none, and the difference of neighbours' mean levels serves, an upper estimate on textured skin.
    """
    # Neighbours along a fringe: the pixel below for axis x, the one beside for axis y.
    beside = np.array([1, 0] if code.axis == "x" else [0, 1])
    first = np.concatenate([[0], np.cumsum(code.step_counts)]).astype(np.int64)
    stride = max(2, frames.shape[2] // _PAIRS_OF_ROWS)
    counts = np.zeros(_BINS)
    squares = np.zeros(_BINS)
    levels = np.zeros(_BINS)
    limit = np.full(_BINS, np.inf)
    for _ in range(2):
        counts[:] = squares[:] = levels[:] = 0
        arguments = (np.cos(code.step_angles), np.sin(code.step_angles), float(saturation), stride, beside, limit)
        _bin_residuals(frames, first, *arguments, counts, squares, levels)
        with np.errstate(invalid="ignore", divide="ignore"):
            limit = np.where(counts > 0, _CLIP * squares / counts, np.inf)
    used = counts >= _LEAST_PIXELS_PER_BIN
    if not used.any():
        return NoiseModel(max(1.0, (saturation / 255.0) ** 2), 0.0)
    level, variance = levels[used] / counts[used], squares[used] / counts[used]
    fine = variance >= _ROUNDING_ADDS_NOISE
    if fine.any():
        return _fit_line(level[fine], variance[fine], counts[used][fine])
    return NoiseModel(_ROUNDING_ADDS_NOISE, 0.0)


def stripe_noise(levels: NDArray, swing: NDArray, gray: GrayCode, saturation: float) -> NoiseModel:
    """Noise of one camera from Gray-code frames, by what says the same twice; a usual value where too little does.

    Frame and inverse add up to the same for every bit; without inverses pixels are as bright in the frames of the two
    coarsest bits where both are bright or both dark.

    Parameters
    ----------
    levels : (frames, h, w) array of float32
        Gray code from the coarsest bit on, without what comes before.
    swing : (2 or more, h, w) array
        Levels of the coarsest bits less that between dark and bright; of frames without inverses.
    """
    thin = np.s_[:, ::_THIN, ::_THIN]
    usual = NoiseModel(max(1.0, (saturation / 255.0) ** 2), 0.0)
    if gray.bits < 2:
        return usual
    if gray.inverse:  # the two finest bits are alike in all but noise
        pairs = levels[0 : gray.stripe_frames : 2][thin] + levels[1 : gray.stripe_frames : 2][thin]
        found = [_differing(pairs[-1] - pairs[-2], 4)]
        return usual if found[0] is None else NoiseModel(max(found[0], _QUANTISATION), 0.0)
    first, second, state = levels[0][thin[1:]], levels[1][thin[1:]], swing[:2][thin] > 0
    groups = [(state[0] == side) & (state[1] == side) & (first < saturation) for side in (False, True)]
    found = [_differing((second - first)[group], 2) for group in groups]
    dark, bright = found
    if dark is None or bright is None:
        told = dark or bright
        return usual if told is None else NoiseModel(max(told, _QUANTISATION), 0.0)
    at = [float(np.median(first[group])) for group in groups]
    gain = max(0.0, (bright - dark) / max(at[1] - at[0], 1.0))
    return NoiseModel(max((dark if gain else 0.5 * (dark + bright)) - gain * at[0], _QUANTISATION), gain)


def _differing(differences: NDArray, samples: int) -> float | None:
    """Variance of one sample from differences that hold so many; None where there are too few.

    Grey levels are whole: of the squares that a normal scatter may have, the mean says more than the median.
    """
    squares = np.square(differences.ravel().astype(float))
    if squares.size < _LEAST_PIXELS_PER_BIN:
        return None
    limit = _STRIPE_SIGMAS**2 * max(float(np.median(squares)) / _CHI2_ONE_MEDIAN, 1.0)
    return float(squares[squares <= limit].mean()) / samples


def _fit_line(level: NDArray, variance: NDArray, weight: NDArray) -> NoiseModel:
    """Line through (level, variance), read variance at least that of rounding.

    The spread of a bin's variance is proportional to the variance itself: that of the line, taken anew, since weights
    from the bins' own values would favour those that came out low.
    """
    read, gain = float(np.average(variance, weights=weight)), 0.0
    for _ in range(_REWEIGHTINGS):
        scale = np.sqrt(weight) / (read + gain * level)
        design = np.column_stack([scale, scale * level])
        read, gain = (float(value) for value in nnls(design, scale * variance)[0])
        if read < _QUANTISATION:
            read = _QUANTISATION
            gain = max(0.0, float(design[:, 1] @ (scale * (variance - read)) / (design[:, 1] @ design[:, 1])))
    return NoiseModel(read, gain)


@kernel
def _bin_residuals(frames, first, cosines, sines, saturation, stride, beside, limit, counts, squares, levels):  # type: ignore[no-untyped-def]
    """Sum squared residual differences of pixels and those `beside` them (rows, columns) into bins of mean level.

    Each entry of `squares` adds an unbiased estimate of the variance of one sample.
    """
    exposures, _, height, width = frames.shape
    n_counts = first.size - 1
    bins = counts.size
    difference = np.empty(cosines.size)
    for e in range(exposures):
        for row in range(0, height - beside[0], stride):
            for x in range(0, width - beside[1], _COLUMN_STRIDE):
                previous = 0.0
                for k in range(n_counts):
                    begin, n = first[k], first[k + 1] - first[k]
                    mean = 0.0
                    c = 0.0
                    s = 0.0
                    level = 0.0
                    peak = 0.0
                    trough = saturation
                    for j in range(n):
                        value = float(frames[e, begin + j, row, x])
                        other = float(frames[e, begin + j, row + beside[0], x + beside[1]])
                        d = value - other
                        difference[j] = d
                        mean += d
                        c += d * cosines[begin + j]
                        s += d * sines[begin + j]
                        level += value + other
                        peak = max(peak, max(value, other))
                        trough = min(trough, min(value, other))
                    # Clipped noise, at the top or at zero, would look smaller than it is.
                    if peak >= saturation or trough < 1.0:
                        previous = np.nan
                        continue
                    mean /= n
                    level /= 2 * n
                    if n >= 4:
                        c *= 2.0 / n
                        s *= 2.0 / n
                        total = 0.0
                        for j in range(n):
                            rest = difference[j] - mean - c * cosines[begin + j] - s * sines[begin + j]
                            total += rest * rest
                        variance = total / (2.0 * (n - 3))
                    elif n_counts > 1:
                        variance = (mean - previous) ** 2 * n / 4.0
                        previous = mean
                        if k == 0 or not variance >= 0.0:
                            continue
                    else:
                        variance = mean * mean * n / 2.0
                    index = min(int(level * bins / saturation), bins - 1)
                    if variance <= limit[index]:
                        counts[index] += 1.0
                        squares[index] += variance
                        levels[index] += level

"""How a camera's noise hangs together from pixel to pixel: it tells what was done to pictures after they were taken.

The noise of a sensor's pixels is independent. Sharpening sets neighbours against each other; smoothing, scaling and
lossy compression make them alike; a beat with a screen or a lamp makes waves; rows with levels of their own are alike
from end to end. What a sinusoid fit leaves over holds noise and the projector's harmonics; these are fitted and taken
off, and what remains of them hardly changes along a fringe, where `metrology.noise` too takes its differences.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Float32
from metrology.fringe import FringeCode
from metrology.robust import MAD

# So many bands of two blocks, one behind the other along a fringe, each of so many pixels along and across fringes.
_BANDS, _TALL, _WIDE = 6, 5, 8
_FAR = range(8, 13)  # pixels apart: farther than filters and compressed blocks reach
_APART = (3, 4, 7)  # columns: of waves of any length some of these differ
_LIT = 0.25  # of the median amplitude
_OUTLIER = 5.0
_THIN = 7  # every so many pixels tell the harmonics
_FEWEST = 400  # blocks: the grain is then known to 4 %
_TAILS = (0.01, 0.99)  # of the samples: what is beyond is stamped, hot or black
_LIKE_OTHERS = 0.01  # of a usual level's number: rarer ones come from noise that was added later, or stamps


@dataclass(frozen=True)
class NoiseTexture:
    """What the noise of one camera's pictures says of how they came about."""

    grain: float
    """Scatter of the means of 5 × 8 pixels, as a multiple of what independent pixels would leave: 1 of a sensor's own
    noise, less of sharpened pictures, more of smoothed or compressed ones."""
    neighbours: float
    """Correlation of neighbours across the fringes or along them, the larger by amount; 0 of a sensor's own noise."""
    waves: float
    """Largest correlation, by amount, of pixels farther apart than filters reach; 0 of a sensor's own noise."""
    columns: float
    """Scatter of columns, of ten pixels along a fringe, from columns a few pixels beside them, as `grain`: more where
    waves run along the fringes, or columns have levels of their own."""
    harmonics: Array
    """(n,) harmonics of the fringes in what a fit leaves over, relative to their amplitude, of projector and camera."""


def noise_texture(frames: NDArray, code: FringeCode, saturation: float) -> NoiseTexture | None:
    """Look at the noise of one camera; None where too little of it is seen, and of codes whose fits leave none.

    Parameters
    ----------
    frames : (frames, h, w) ndarray of uint8 or uint16
        Of one exposure.
    saturation : float
        Grey level from which a sample counts as saturated.
    """
    counts = [k for k, steps in enumerate(code.step_counts) if steps >= 4]
    length = frames.shape[1 if code.axis == "x" else 2]
    if not counts or length < _BANDS * 4 * _TALL or frames.shape[2 if code.axis == "x" else 1] < 4 * _FAR[-1]:
        return None
    bands = _bands(frames[: code.fringe_frames], code.axis)
    lit = (bands.max((0, 2)) < saturation) & (bands.min((0, 2)) >= 1)
    correlated, seen, behind = np.zeros(_FAR[-1] + 1), np.zeros(_FAR[-1] + 1), 0.0
    blocks, columns, harmonics = [], [], []
    for k in counts:
        own = bands[code.count_of[: len(bands)] == k]
        angles = code.step_angles[code.count_of == k]
        for residual, good, coefficients in _residuals(own, angles, lit):
            behind += _add_correlations(residual, good, correlated, seen)
            blocks.append(_block_differences(residual, good))
            columns.append(_columns(residual, good))
            harmonics.append(coefficients)
    differences = np.concatenate(blocks)
    if differences.size < _FEWEST or seen[0] == 0 or correlated[0] <= 0:
        return None
    correlation = correlated / np.maximum(seen, 1)
    # The mean of a column of a block was taken off its pixels.
    variance = correlation[0] * _TALL / (_TALL - 1)
    scatter = float(np.square(_usual(differences)).mean()) / 2 * _TALL * _WIDE
    relative = correlation / correlation[0]
    # Independent pixels, their mean taken off, have −1/(n − 1).
    along = behind / (seen[0] * (_TALL - 1) / _TALL) / correlation[0] + 1 / (_TALL - 1)
    beside, far = (relative[1], along), relative[list(_FAR)]
    return NoiseTexture(
        float(np.sqrt(scatter / variance)),
        float(max(beside, key=abs)),
        float(far[np.argmax(np.abs(far))]),
        float(np.sqrt(np.mean(columns, axis=0).max() / variance)),
        np.concatenate(harmonics),
    )


def level_step(frames: NDArray) -> float:
    """Grey levels from one level that occurs to the next, the median; 1 of frames that use all their bits.

    Parameters
    ----------
    frames : (frames, h, w) ndarray of uint8 or uint16
    """
    samples = frames[:, 2::5, 1::4]
    counts = np.bincount(samples.ravel(), minlength=2)
    cumulative = np.cumsum(counts) / counts.sum()
    first, last = (int(np.searchsorted(cumulative, share)) for share in _TAILS)
    inner = counts[first : last + 1]
    used = np.flatnonzero(inner > _LIKE_OTHERS * np.median(inner[inner > 0]))
    return float(np.median(np.diff(used))) if len(used) > 2 else 1.0


def _bands(frames: NDArray, axis: str) -> Float32:
    """(frames, bands, 2 × tall, w) float32 with fringes across the last axis."""
    if axis == "y":
        frames = frames.transpose(0, 2, 1)
    stride = frames.shape[1] // _BANDS
    rows = (np.arange(_BANDS) * stride + stride // 2 - _TALL)[:, None] + np.arange(2 * _TALL)
    return np.asarray(frames[:, rows].astype(np.float32))


def _residuals(
    levels: Float32, angles: Array, lit: NDArray[np.bool_]
) -> list[tuple[Float32, NDArray[np.bool_], Array]]:
    """What the fit of one count leaves over: each independent part, where it counts, and its harmonics.

    Returns
    -------
    list of ((bands, 2, tall, w), (bands, w), (m,))
    """
    steps = len(angles)
    design = np.column_stack([np.ones(steps), np.cos(angles), np.sin(angles)])
    left_over = np.linalg.svd(design.T)[2][3:].astype(np.float32)
    cosine, sine = (np.tensordot(f(angles).astype(np.float32) * 2 / steps, levels, 1) for f in (np.cos, np.sin))
    amplitude = np.hypot(cosine, sine)
    good = lit & (amplitude.min(1) > _LIT * np.median(amplitude))
    direction = (cosine - 1j * sine) / np.maximum(amplitude, 1e-3)
    mean = levels.mean(0)
    power, waves = direction, []
    for _ in range(2, steps - 1):
        power = power * direction
        waves += [amplitude * power.real, amplitude * power.imag]
    # Light that flickers leaves the mean level, and movement the fringes themselves.
    waves += [mean, cosine, sine]
    everywhere = np.broadcast_to(good[:, None], amplitude.shape)
    terms = np.stack([wave[everywhere][::_THIN] for wave in waves], axis=1)
    found = []
    for part in np.tensordot(left_over, levels, 1):
        coefficients = np.linalg.lstsq(terms, part[everywhere][::_THIN], rcond=None)[0]
        rest = part - sum(weight * wave for weight, wave in zip(coefficients, waves, strict=True))
        rest = rest.reshape(len(rest), 2, _TALL, -1)
        off = np.abs(rest - rest.mean(2, keepdims=True)).max((1, 2))
        # The largest of so many normal deviates has its median near 2.5 of their deviations.
        usual = off[good] if good.any() else np.ones(1)
        found.append((rest, good & (off < 2 * np.median(usual)), np.asarray(coefficients[:-3], float)))
    return found


def _add_correlations(residual: Float32, good: NDArray[np.bool_], correlated: Array, seen: Array) -> float:
    """Add products of pixels so many columns apart, and how many there are; the sum of products along the fringes."""
    noise = np.where(good[:, None, None], residual - residual.mean(2, keepdims=True), 0)
    width = noise.shape[-1]
    for apart in (0, 1, *_FAR):
        first, second = noise[..., : width - apart], noise[..., apart:]
        correlated[apart] += float(np.vdot(first, second))
        seen[apart] += 2 * _TALL * int((good[:, : width - apart] & good[:, apart:]).sum())
    return float(np.vdot(noise[:, :, 1:], noise[:, :, :-1]))


def _columns(residual: Float32, good: NDArray[np.bool_]) -> list[float]:
    """Variance of a pixel by the means of columns, from differences of those some pixels apart."""
    means, found = residual.mean((1, 2)), []
    for apart in _APART:
        off = (means[:, apart:] - means[:, :-apart])[good[:, apart:] & good[:, :-apart]]
        found.append(_TALL * float(np.square(_usual(off)).mean()) if off.size else 0.0)
    return found


def _usual(values: Array) -> Array:
    """Without outliers."""
    return values[np.abs(values) <= _OUTLIER * MAD * np.median(np.abs(values)) + 1e-9]


def _block_differences(residual: Float32, good: NDArray[np.bool_]) -> Array:
    """Means of the blocks less those of the ones behind them."""
    width = residual.shape[-1] // _WIDE * _WIDE
    whole = good[:, :width].reshape(len(good), -1, _WIDE).all(-1)
    means = residual[..., :width].reshape(len(residual), 2, _TALL, -1, _WIDE).mean((2, 4))
    return np.asarray((means[:, 1] - means[:, 0])[whole], float)

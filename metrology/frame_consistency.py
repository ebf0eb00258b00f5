"""Whether a camera's frames are what the scene says: told from a coarse grid of every scan.

Two things are looked at, over the whole picture, in bands of its rows and in blocks, since a frame may be wrong in a
part only:

- *fringes that contradict each other*: the share of pixels whose phases (or phase and Gray-code stripe) tell no common
  position;
- *deviation of a frame*: what it differs by from what the other frames say of it, in brightness (relative to the mean
  level) and in fringes (relative to their amplitude). Gamma leaves neither: its harmonics average out.

Frames that fit each other may still all hold a second picture of the fringes: see `metrology.frame_ghosts`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Float32
from metrology.cloud import PixelFlag
from metrology.flicker import levelled
from metrology.frame_ghosts import Disagreement, disagreement
from metrology.frame_sample import Agreement, FrameSample, SinusoidFit, agreement, coarse_positions, fit_sinusoids
from metrology.fringe import FringeCode
from metrology.robust import MAD

# A frame deviates if it is this much brighter or darker than the others say (flicker of 3 % leaves 0.05), …
_BRIGHTNESS = 0.15
# … or if its fringes are off by this share of their amplitude (flicker and vibration leave 0.06).
_FRINGES = 0.3
# A sound frame leaves a tenth of that; half as much again costs a look at the ripple.
_UNEVEN = 0.15
# Phases that miss each other systematically, as a share of half a lattice step (sound: 0.01).
DRIFT = 0.1
# Contrast that depends on the phase by this share of itself: a wrong frame lets it, a surface hardly. Asked where so
# few counts leave little else to ask.
_CONTRAST = 0.3
_MOST_CONTRAST = 2.0
_FEW_COUNTS = 2
# Contradictions over the whole picture, and within one band of rows: a seam along the band takes up less.
_CONTRADICTORY = 0.05
_BAND_CONTRADICTORY = 0.5
_ROWS_PER_BAND = 2
# A fault of a small part of the picture (a lamp, lost blocks) is seen in blocks of so many rows and columns.
_BLOCK = 8
# So few bands of rows do not tell whether brightness changes along them.
_FEWEST_BANDS = 6
# Gamma averages out over a fringe and more: bands along fringes are as high as one where half the projector is seen,
# and frames of few fringes are not judged by their fringes.
_FRINGES_PER_BAND = 1.2
_PART_SEEN = 0.5
_LEAST_COUNT = 8
_LEAST_PIXELS = 30
# Of one: the mean of unit vectors along a band's phases, once, twice and three times round. A fringe and a fifth leave
# 0.16, half a fringe 0.6.
_MOST_UNEVEN = 0.25
_SURE = 2.0  # standard deviations
# Pixels with more clipped samples than one are left out: a frame brighter than the others clips alone.
_CLIPPED_SAMPLES = 1
_UNLIT = PixelFlag.SATURATED | PixelFlag.LOW_MODULATION
_STRIDE = 4


@dataclass(frozen=True)
class FrameConsistency:
    """How well one exposure's frames of one camera fit each other."""

    judged: int
    """Pixels of the grid that could be judged."""
    contradictory: float
    """Share of them whose fringes contradict each other."""
    odd_rows: NDArray[np.bool_]
    """(rows,): rows of the grid in bands or blocks where a frame deviates or most fringes contradict each other."""
    odd_columns: NDArray[np.bool_]
    """(columns,): columns of the grid in such blocks, where neither a band nor the whole picture is odd; else all."""
    deviation: float
    """Largest deviation of a frame, over the whole picture, a band or a block; 1 is the limit."""
    drift: float
    """What the phases miss each other by systematically; 1 is the limit."""
    rolling: float = 0.0
    """Scatter of the frames' brightness from band to band of rows beyond noise, relative: light that flickers while a
    shutter rolls."""
    disagreement: Disagreement | None = None
    """What the phases of the counts miss each other by; None where that cannot be told."""
    unexplained: float = 0.0
    """Largest deviation of a frame beside light that flickers: once frames are brought to one level."""

    @property
    def uneven(self) -> bool:
        """Whether the frames may differ enough for their coordinate to ripple; a sound scan's hardly do."""
        return self.deviation > _UNEVEN

    @property
    def odd(self) -> bool:
        """Whether some frame is not what the scene says."""
        return max(self.deviation, self.drift, self.contradictory / _CONTRADICTORY) > 1 or bool(self.odd_rows.any())


def contradictory_share(flags: NDArray[np.uint16]) -> float:
    """Share of a view's lit pixels whose fringes contradict each other (`PixelFlag.ORDER_RESIDUAL`).

    Parameters
    ----------
    flags : (h, w) uint16
        PixelFlag bits of the view.
    """
    # One pixel in sixteen tells the share to a thousandth.
    flags = flags[::_STRIDE, ::_STRIDE]
    lit = (flags & _UNLIT) == 0
    return float(((flags & np.uint16(PixelFlag.ORDER_RESIDUAL)) != 0)[lit].mean()) if lit.any() else 0.0


def frame_consistency(sample: FrameSample, exposure: int) -> FrameConsistency:
    """Judge one exposure's frames in the order in which the scene lists them."""
    levels, gray = np.split(sample.frames(exposure), [sample.code.fringe_frames])
    rows = len(sample.rows)
    everywhere = np.ones(sample.columns.shape[1], bool)
    nothing = FrameConsistency(0, 0.0, np.zeros(rows, bool), everywhere, 0.0, 0.0)
    fit = fit_sinusoids(levels, range(len(levels)), sample.code)
    if fit is None:
        return nothing
    coarse = coarse_positions(gray, sample.code, fit.mean)
    told = agreement(fit, sample.code, sample.noise, coarse)
    lit = told.judged & unclipped(levels, sample.saturation) & ~sample.edges.ravel()
    if lit.sum() < _LEAST_PIXELS:
        return nothing
    contradictory = told.contradictory & lit
    whole = float(largest_deviation(fit, sample.code, lit, rows, np.array([0]))[0])
    even = _without_flicker(fit, levels, lit & ~contradictory, sample.code)
    # Flicker that is no fault makes parts of the picture odd that hold few pixels.
    local = even if whole <= 1 else fit
    largest, odd_rows, odd_columns = _oddities(local, sample, lit, contradictory, 0.0)
    if largest > _UNEVEN:
        largest, odd_rows, odd_columns = _oddities(local, sample, lit, contradictory, _SURE)
    return FrameConsistency(
        judged=int(lit.sum()),
        contradictory=float(contradictory[lit].mean()),
        odd_rows=odd_rows,
        odd_columns=odd_columns,
        deviation=max(largest, whole),
        drift=told.drift / DRIFT,
        rolling=_rolling(fit, lit, rows, max(_BLOCK, _rows_per_band(sample))),
        disagreement=_disagreement(told, even, lit & ~contradictory, sample),
        unexplained=largest,
    )


def _rolling(fit: SinusoidFit, lit: NDArray[np.bool_], rows: int, tall: int) -> float:
    """See `FrameConsistency.rolling`."""
    bands = np.arange(0, rows, tall)
    number = _per_band(lit, rows, bands)
    enough = number >= tall * _LEAST_PIXELS / 2
    if enough.sum() < _FEWEST_BANDS:
        return 0.0
    level = _per_band(np.where(lit, fit.mean, 0), rows, bands)[enough]
    off = _per_band(np.where(lit, fit.errors, 0), rows, bands)[:, enough] / level
    off = off - np.average(off, axis=1, weights=number[enough])[:, None]
    scatter = MAD * np.median(np.abs(fit.errors[:, lit] / fit.mean[lit]), axis=1)
    noise = np.mean(scatter**2) * np.mean(1 / number[enough])
    return float(np.sqrt(max(np.square(off).mean() - noise, 0.0)))


def _without_flicker(fit: SinusoidFit, levels: Float32, use: NDArray[np.bool_], code: FringeCode) -> SinusoidFit:
    """The fit of frames of one level, where enough is seen to tell it."""
    if use.sum() < _LEAST_PIXELS:
        return fit
    return fit_sinusoids(levelled(levels, fit, use, code), fit.shows.tolist(), code) or fit


def _disagreement(
    told: Agreement, even: SinusoidFit, use: NDArray[np.bool_], sample: FrameSample
) -> Disagreement | None:
    """See `FrameConsistency.disagreement`; light that flickers would skew what the counts miss each other by."""
    missed = None if told.missed is None else agreement(even, sample.code, sample.noise).missed
    counts = tuple(sample.code.counts[k] for k in even.used)
    return None if missed is None else disagreement(missed, counts, use, len(sample.rows))


def _oddities(
    fit: SinusoidFit, sample: FrameSample, lit: NDArray[np.bool_], contradictory: NDArray[np.bool_], sure: float
) -> tuple[float, NDArray[np.bool_], NDArray[np.bool_]]:
    """Largest deviation of a frame, over the whole picture, a band or a block, and the odd rows and columns."""
    rows, everywhere = len(sample.rows), np.ones(sample.columns.shape[1], bool)
    per_band = _rows_per_band(sample)
    bands = np.arange(0, rows, per_band)
    counted = _per_band(lit, rows, bands)
    enough = counted >= _LEAST_PIXELS
    deviation = largest_deviation(fit, sample.code, lit, rows, bands, sure)
    deviation[~_all_phases(fit, sample.code, lit, rows, bands)] = 0
    share = _per_band(contradictory, rows, bands) / np.maximum(counted, 1)
    whole = largest_deviation(fit, sample.code, lit, rows, np.array([0]), sure)
    odd_band = enough & ((deviation > 1) | (share > _BAND_CONTRADICTORY))
    odd_rows = np.repeat(odd_band, per_band)[:rows]
    largest = float(max(whole[0], deviation[enough].max(initial=0)))
    if largest <= 1 and not odd_rows.any():
        in_blocks, odd_rows, odd_columns = _odd_blocks(fit, sample, lit, per_band, sure)
        return max(largest, in_blocks), odd_rows, odd_columns
    return largest, odd_rows, everywhere


def _all_phases(
    fit: SinusoidFit, code: FringeCode, lit: NDArray[np.bool_], rows: int, bands: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """(b,) whether a band's pixels have all phases of the widest fringes alike, so that gamma averages out: not so
    where light, or the picture, ends within a fringe along y.
    """
    wide = [index for index, k in enumerate(fit.used) if code.counts[k] >= _LEAST_COUNT]
    if code.axis == "x" or not wide:  # along x all fringes cross a band
        return np.ones(len(bands), bool)
    phasor = fit.phasors[min(wide, key=lambda index: code.counts[fit.used[index]])]
    along = np.where(lit, phasor / np.maximum(np.abs(phasor), 1e-6), 0)
    uneven = np.max([np.abs(_per_band(along**turns, rows, bands)) for turns in (1, 2, 3)], axis=0)
    return np.asarray(uneven <= _MOST_UNEVEN * np.maximum(_per_band(lit, rows, bands), 1))


def _odd_blocks(
    fit: SinusoidFit, sample: FrameSample, lit: NDArray[np.bool_], per_band: int, sure: float
) -> tuple[float, NDArray[np.bool_], NDArray[np.bool_]]:
    """Largest deviation of a frame in a block, and the rows and columns of the grid in which blocks are odd."""
    rows, columns = sample.columns.shape
    tall, wide = max(_BLOCK, per_band), max(_BLOCK, _columns_per_block(sample))
    across = max(1, columns // wide)
    group = np.minimum(np.arange(columns) // wide, across - 1)
    # Blocks of one group of columns below each other become bands of a picture of that group alone.
    largest, odd = 0.0, np.zeros((rows, columns), bool)
    for column in range(across):
        inside = group == column
        at = np.flatnonzero(np.tile(inside, rows))
        own = SinusoidFit(fit.mean[at], fit.phasors[:, at], fit.used, fit.errors[:, at], fit.shows)
        bands = np.arange(0, rows, tall)
        deviation = frame_deviations(own, sample.code, lit[at], rows, bands, sure=sure).max(0)
        deviation[_per_band(lit[at], rows, bands) < _LEAST_PIXELS] = 0
        deviation[~_all_phases(own, sample.code, lit[at], rows, bands)] = 0
        largest = max(largest, float(deviation.max()))
        odd |= np.repeat(deviation > 1, tall)[:rows, None] & inside
    odd_columns = odd.any(0) if odd.any() else np.ones(columns, bool)
    return largest, np.asarray(odd.any(1)), np.asarray(odd_columns)


def _columns_per_block(sample: FrameSample) -> int:
    return _grid_per_fringe(sample, sample.columns.shape[1]) if sample.code.axis == "x" else _BLOCK


def _rows_per_band(sample: FrameSample) -> int:
    if sample.code.axis == "x":
        return _ROWS_PER_BAND
    return max(_ROWS_PER_BAND, _grid_per_fringe(sample, len(sample.rows)))


def _grid_per_fringe(sample: FrameSample, grid: int) -> int:
    """Rows or columns, of so many along the projector coordinate, that the widest fringe and a little more take up."""
    fringes = _PART_SEEN * min((count for count in sample.code.counts if count >= _LEAST_COUNT), default=1)
    return int(np.ceil(_FRINGES_PER_BAND * grid / fringes))


def unclipped(levels: Float32, saturation: float) -> NDArray[np.bool_]:
    """(n,) where at most one of the (frames, n) levels is clipped."""
    return np.asarray((levels >= saturation).sum(0) <= _CLIPPED_SAMPLES)


def frame_deviations(
    fit: SinusoidFit,
    code: FringeCode,
    lit: NDArray[np.bool_],
    rows: int,
    bands: NDArray[np.int64],
    least_count: int = _LEAST_COUNT,
    sure: float = 0.0,
) -> Array:
    """Deviation of each frame from what the others say, in bands of rows; 1 is the limit.

    Parameters
    ----------
    fit : SinusoidFit
        Of `rows` · columns pixels.
    lit : (n,) bool
        Pixels that count.
    bands : (b,) int
        First row of each band.
    least_count : int
        Counts with fewer fringes are not judged by them.
    sure : float
        So many standard deviations, as the pixels of a band scatter, are taken off: edges of paint move with what
        vibrates, and make a few pixels scatter far more than noise does.

    Returns
    -------
    (frames, b) ndarray
        0 in bands without lit pixels.
    """
    level = np.maximum(_per_band(np.where(lit, fit.mean, 0), rows, bands), 1e-6)
    brightness = _sure_sum(np.where(lit, fit.errors, 0), lit, rows, bands, sure) / level
    fringes = np.zeros_like(brightness)
    for index, k in enumerate(fit.used):
        own = code.count_of[fit.shows] == k
        if not own.any() or code.counts[k] < least_count:
            continue
        phasor = np.where(lit, fit.phasors[index], 0)
        power = np.maximum(_per_band(np.abs(phasor) ** 2, rows, bands), 1e-6)
        fringes[own] = _sure_sum(fit.errors[own] * phasor, lit, rows, bands, sure) * 2 / power
    return np.asarray(np.maximum(brightness / _BRIGHTNESS, fringes / _FRINGES))


def _sure_sum(values: NDArray, lit: NDArray[np.bool_], rows: int, bands: NDArray[np.int64], sure: float) -> Array:
    """Amount of the sums of (…, n) values, 0 where not lit, over each band's rows, less so many of their standard
    deviations, (…, b)."""
    amount = np.abs(_per_band(values, rows, bands))
    if sure == 0:
        return np.asarray(amount)
    squares = _per_band(np.square(np.abs(values)), rows, bands)
    number = np.maximum(_per_band(lit, rows, bands), 1)
    scatter = np.sqrt(np.maximum(squares - amount**2 / number, 0))
    return np.asarray(np.maximum(amount - sure * scatter, 0))


def largest_deviation(
    fit: SinusoidFit,
    code: FringeCode,
    lit: NDArray[np.bool_],
    rows: int,
    bands: NDArray[np.int64],
    sure: float = 0.0,
) -> Array:
    """(b,) largest deviation in each band of any frame, or of the contrast from not depending on the phase."""
    largest = frame_deviations(fit, code, lit, rows, bands, sure=sure).max(0)
    if len(code.counts) > _FEW_COUNTS:
        return np.asarray(largest)
    amplitude, number = fit.amplitude, np.maximum(_per_band(lit, rows, bands), 1)
    for index, k in enumerate(fit.used):
        if code.counts[k] < _LEAST_COUNT:
            continue
        contrast = np.where(lit, np.minimum(amplitude[index] / np.maximum(fit.mean, 1), _MOST_CONTRAST), 0)
        total = np.maximum(_per_band(contrast, rows, bands), 1e-6)
        direction = np.where(lit, fit.phasors[index] / np.maximum(amplitude[index], 1e-6), 0)
        turned = direction
        for _ in range(
            2
        ):  # a frame that is off as a whole shows at the phase itself, one with other fringes at twice it
            seen = _per_band(contrast * turned, rows, bands) - total / number * _per_band(turned, rows, bands)
            largest = np.maximum(largest, 2 * np.abs(seen) / total / _CONTRAST)
            turned = turned * direction
    return np.asarray(largest)


def _per_band(values: NDArray, rows: int, bands: NDArray[np.int64]) -> NDArray:
    """Sums of (…, n) values over each band's rows, (…, b)."""
    kind = np.complex128 if np.iscomplexobj(values) else np.float64
    by_row = values.reshape(*values.shape[:-1], rows, -1).sum(-1, dtype=kind)
    return np.asarray(np.add.reduceat(by_row, bands, axis=-1))

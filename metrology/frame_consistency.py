"""Whether a camera's frames are what the scene says: told from a coarse grid of every scan.

Two things are looked at, over the whole picture and in bands of its rows, since a frame may be wrong in a part only:

- *fringes that contradict each other*: the share of pixels whose phases (or phase and Gray-code stripe) tell no common
  position;
- *deviation of a frame*: what it differs by from what the other frames say of it, in brightness (relative to the mean
  level) and in fringes (relative to their amplitude). Gamma leaves neither: its harmonics average out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import DecodedView, PixelFlag
from metrology.frame_sample import (
    Array,
    Float32,
    FrameSample,
    SinusoidFit,
    agreement,
    coarse_positions,
    fit_sinusoids,
)

# A frame deviates if it is this much brighter or darker than the others say (flicker of 3 % leaves 0.05), …
_BRIGHTNESS = 0.15
# … or if its fringes are off by this share of their amplitude (flicker and vibration leave 0.06).
_FRINGES = 0.3
# Phases that miss each other systematically, as a share of half a lattice step (sound: 0.01).
DRIFT = 0.25
# Contradictions within one band of rows: a seam along the band takes up less.
_BAND_CONTRADICTORY = 0.4
_ROWS_PER_BAND = 4
_LEAST_PIXELS = 30
# Pixels with more clipped samples than one are left out: a frame brighter than the others clips alone.
_CLIPPED_SAMPLES = 1
_UNLIT = PixelFlag.SATURATED | PixelFlag.LOW_MODULATION
_STRIDE = 4


@dataclass(frozen=True)
class FrameConsistency:
    """How well one exposure's frames of one camera fit each other.

    Attributes
    ----------
    judged : int
        Pixels of the grid that could be judged.
    contradictory : float
        Share of them whose fringes contradict each other.
    odd_rows : (rows,) bool
        Rows of the grid in bands where a frame deviates or most fringes contradict each other.
    deviation : float
        Largest deviation of a frame, over the whole picture or a band; 1 is the limit.
    drift : float
        What the phases miss each other by systematically; 1 is the limit.
    """

    judged: int
    contradictory: float
    odd_rows: NDArray[np.bool_]
    deviation: float
    drift: float

    @property
    def odd(self) -> bool:
        """Whether some frame is not what the scene says."""
        return self.deviation > 1 or self.drift > 1 or bool(self.odd_rows.any())


def contradictory_share(view: DecodedView) -> float:
    """Share of a view's lit pixels whose fringes contradict each other (`PixelFlag.ORDER_RESIDUAL`)."""
    # One pixel in sixteen tells the share to a thousandth.
    flags = view.flags[::_STRIDE, ::_STRIDE]
    lit = (flags & _UNLIT) == 0
    return float(((flags & PixelFlag.ORDER_RESIDUAL) != 0)[lit].mean()) if lit.any() else 0.0


def frame_consistency(sample: FrameSample, exposure: int) -> FrameConsistency:
    """Judge one exposure's frames in the order in which the scene lists them."""
    levels, gray = np.split(sample.frames(exposure), [sample.code.fringe_frames])
    rows = len(sample.rows)
    nothing = FrameConsistency(0, 0.0, np.zeros(rows, bool), 0.0, 0.0)
    fit = fit_sinusoids(levels, range(len(levels)), sample.code)
    if fit is None:
        return nothing
    coarse = coarse_positions(gray, sample.code, fit.mean)
    told = agreement(fit, sample.code, sample.noise, coarse)
    lit = told.judged & unclipped(levels, sample.saturation)
    if lit.sum() < _LEAST_PIXELS:
        return nothing
    contradictory = told.contradictory & lit
    bands = np.arange(0, rows, _ROWS_PER_BAND)
    counted = _per_band(lit, rows, bands)
    enough = counted >= _LEAST_PIXELS
    deviations = frame_deviations(fit, sample.code.steps, lit, rows, bands)[:, enough]
    share = _per_band(contradictory, rows, bands) / np.maximum(counted, 1)
    whole = frame_deviations(fit, sample.code.steps, lit, rows, np.array([0]))
    odd_band = np.zeros(len(bands), bool)
    odd_band[enough] = (deviations.max(0) > 1) | (share[enough] > _BAND_CONTRADICTORY)
    return FrameConsistency(
        judged=int(lit.sum()),
        contradictory=float(contradictory[lit].mean()),
        odd_rows=np.repeat(odd_band, _ROWS_PER_BAND)[:rows],
        deviation=float(max(whole.max(), deviations.max(initial=0.0))),
        drift=told.drift / DRIFT,
    )


def unclipped(levels: Float32, saturation: float) -> NDArray[np.bool_]:
    """(n,) where at most one of the (frames, n) levels is clipped."""
    return np.asarray((levels >= saturation).sum(0) <= _CLIPPED_SAMPLES)


def frame_deviations(
    fit: SinusoidFit, steps: int, lit: NDArray[np.bool_], rows: int, bands: NDArray[np.int64]
) -> Array:
    """Deviation of each frame from what the others say, in bands of rows; 1 is the limit.

    Parameters
    ----------
    fit : SinusoidFit
        Of `rows` · columns pixels.
    steps : int
    lit : (n,) bool
        Pixels that count.
    rows : int
    bands : (b,) int
        First row of each band.

    Returns
    -------
    (frames, b) ndarray
        0 in bands without lit pixels.
    """
    level = np.maximum(_per_band(np.where(lit, fit.mean, 0), rows, bands), 1e-6)
    brightness = np.abs(_per_band(np.where(lit, fit.errors, 0), rows, bands)) / level
    fringes = np.zeros_like(brightness)
    for index, k in enumerate(fit.used):
        own = fit.shows // steps == k
        if not own.any():
            continue
        phasor = np.where(lit, fit.phasors[index], 0)
        power = np.maximum(_per_band(np.abs(phasor) ** 2, rows, bands), 1e-6)
        fringes[own] = np.abs(_per_band(fit.errors[own] * phasor, rows, bands)) * 2 / power
    return np.asarray(np.maximum(brightness / _BRIGHTNESS, fringes / _FRINGES))


def _per_band(values: NDArray, rows: int, bands: NDArray[np.int64]) -> NDArray:
    """Sums of (…, n) values over each band's rows, (…, b)."""
    kind = np.complex128 if np.iscomplexobj(values) else np.float64
    by_row = values.reshape(*values.shape[:-1], rows, -1).sum(-1, dtype=kind)
    return np.asarray(np.add.reduceat(by_row, bands, axis=-1))

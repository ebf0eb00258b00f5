"""Which frame of a suspicious scan is wrong, what it looks like, or in which other order the frames would fit.

A hypothesis says which pattern each listed frame shows, or that a frame is to be left out. Under the right one the
frames agree as those of a sound scan do; under others they do not. Simple ones are tried first: one frame wrong,
another order, a whole count wrong, two frames wrong. What a frame that was left out looks like is then told by the
frames that remain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Float32
from metrology.frame_consistency import DRIFT, FrameConsistency, largest_deviation, unclipped
from metrology.frame_faults import Finer, FrameFault, describe_frame
from metrology.frame_orders import FrameOrder, frame_orders
from metrology.frame_sample import FAINT_COUNT, FrameSample, SinusoidFit, agreement, coarse_positions, fit_sinusoids

# Pixels that hypotheses are tried on.
_PIXELS = 600
_LEAST_PIXELS = 30
# A pixel carries fringes if its second brightest and second darkest samples differ by this many standard deviations.
_FRINGE_SIGMAS = 10.0
# Frames agree under a hypothesis if no more than this share of the pixels has contradictory fringes, …
_FITS_SHARE = 0.3
_ODD_SHARE = 0.05
# … if what was wrong as the scene lists the frames (a frame's deviation, or this share) falls to this part, …
_FITS_PART = 0.35
# … and if it is told by at least this part of the pixels.
_JUDGED_PART = 0.3
# Hypotheses whose misfits differ by less than this factor and amount cannot be told apart; so many are looked at.
_CLEARLY, _ALIKE = 1.5, 0.05
_MOST_NAMED = 6
# Correlation of two pictures, their mean level aside, from which they show one pattern.
_ALIKE_PICTURES = 0.95
# Orders whose coordinate runs against what the rig expects (cosine of the angle between the gradients) are not meant.
_BACKWARDS = -0.5


@dataclass(frozen=True)
class FrameDiagnosis:
    """What is wrong with one camera's frames."""

    faults: tuple[FrameFault, ...] = ()
    """Frames that do not fit, each described."""
    either: bool = False
    """Whether only one of the faults is the true one, which the scan cannot tell."""
    order: FrameOrder | None = None
    """The order in which the frames would fit."""

    @property
    def named(self) -> bool:
        """Whether anything was found."""
        return bool(self.faults) or self.order is not None


@dataclass(frozen=True)
class _Trial:
    """How frames fit under a hypothesis."""

    deviation: float
    """Largest of a frame, or of all phases; 1 is the limit."""
    share: float
    """Of pixels with contradictory fringes."""
    judged: int
    """Pixels."""

    @property
    def misfit(self) -> float:
        """Both together, for ranking."""
        return self.deviation + self.share


def diagnose_frames(
    sample: FrameSample,
    found: Sequence[FrameConsistency],
    finer: Finer | None = None,
    expected_gradient: Array | None = None,
) -> FrameDiagnosis:
    """Find out what is wrong with a camera's frames.

    Parameters
    ----------
    found : sequence of FrameConsistency
        Of each exposure.
    finer : callable, optional
        Samples other image rows of the same frames, to tell the very row where a frame is torn.
    expected_gradient : (2,) ndarray, optional
        Direction in the image (u, v) along which the rig lets the projector coordinate rise.
    """
    odd = [e for e, judged in enumerate(found) if judged.odd] or list(range(len(found)))
    one = list(combinations(range(sample.code.fringe_frames), 1))
    named = [_without_fringes(sample, e) or _wrong_frames(sample, e, found[e], one, finer) for e in odd]
    if not all(diagnosis.named for diagnosis in named):
        order = _other_order(sample, expected_gradient)
        if order is not None:
            return FrameDiagnosis(order=order)
        two = list(combinations(range(sample.code.fringe_frames), 2))
        for place, e in enumerate(odd):
            if not named[place].named:
                wrong = _wrong_frames(sample, e, found[e], two, finer)
                named[place] = wrong if wrong.named else _repeated(sample, e)
    return _joined(named)


def _joined(found: Sequence[FrameDiagnosis]) -> FrameDiagnosis:
    faults = tuple(fault for one in found for fault in one.faults)
    return FrameDiagnosis(faults, either=any(one.either for one in found))


def _without_fringes(sample: FrameSample, exposure: int) -> FrameDiagnosis | None:
    """All frames of the counts that show no fringes where others do."""
    code = sample.code
    levels = sample.frames(exposure)[: code.fringe_frames]
    fit = fit_sinusoids(levels, range(code.fringe_frames), code)
    lit = _carries_fringes(sample, exposure)
    if fit is None or lit.sum() < _LEAST_PIXELS:
        return None
    amplitude = np.median(fit.amplitude[:, lit], axis=1)
    faint = [k for k in fit.used if amplitude[fit.used.index(k)] < FAINT_COUNT * amplitude.max()]
    frames = [p for p in range(code.fringe_frames) if code.count_of[p] in faint]
    described = _described(sample, exposure, tuple(frames), None)
    return FrameDiagnosis(described) if described else None


def _repeated(sample: FrameSample, exposure: int) -> FrameDiagnosis:
    """Frames that show what an earlier one shows, where nothing tells which of them is right."""
    code, lit = sample.code, _carries_fringes(sample, exposure)
    if lit.sum() < _LEAST_PIXELS:
        return FrameDiagnosis()
    levels = sample.frames(exposure)[: code.fringe_frames][:, lit].astype(np.float64)
    pictures = levels - levels.mean(0)
    length = np.maximum(np.linalg.norm(pictures, axis=1), 1e-6)
    like = pictures @ pictures.T / np.outer(length, length)
    faults = []
    for frame in range(1, code.fringe_frames):
        other = int(np.argmax(like[frame, :frame]))
        if like[frame, other] > _ALIKE_PICTURES:
            same = np.array_equal(levels[frame], levels[other])
            at = exposure * code.frames
            faults.append(FrameFault(at + frame, (None, None), "same" if same else "like", at + other))
    return FrameDiagnosis(tuple(faults))


def _wrong_frames(
    sample: FrameSample,
    exposure: int,
    found: FrameConsistency,
    sets: Sequence[tuple[int, ...]],
    finer: Finer | None,
) -> FrameDiagnosis:
    """The set of frames without which those of an exposure agree where they did not."""
    frames = sample.code.frames
    if not found.odd_columns.all():
        sample, finer = _in_columns(sample, finer, found.odd_columns)
    inside = found.odd_rows if found.odd_rows.any() else np.ones(len(sample.rows), bool)
    levels = _some_pixels(sample, exposure, inside)
    own = np.full(len(levels), -1)
    own[exposure * frames : (exposure + 1) * frames] = np.arange(exposure * frames, (exposure + 1) * frames)
    listed = _try(levels, own, sample)
    fitting = []
    for left_out in sets:
        shows = own.copy()
        shows[exposure * frames + np.array(left_out)] = -1
        trial = _try(levels, shows, sample)
        if _fits(trial, listed):
            fitting.append((trial.misfit, left_out))
    likeliest = sorted(fitting)[:_MOST_NAMED]
    named = [(misfit, _described(sample, exposure, frames, finer)) for misfit, frames in likeliest]
    named = [(misfit, faults) for misfit, faults in named if faults]
    if not named or len(named[0][1]) > 1:
        return FrameDiagnosis(named[0][1] if named else ())
    limit = _CLEARLY * named[0][0] + _ALIKE
    alike = [faults[0] for misfit, faults in named if misfit < limit]
    if len(sample.code.counts) == 1:  # any three of four steps fit: no other count contradicts
        alike = [faults[0] for _, faults in named]
    telling = [fault for fault in alike if fault.telling]
    if len(alike) == 1 or len(telling) == 1:
        return FrameDiagnosis(tuple(telling or alike))
    return FrameDiagnosis(tuple(sorted(alike, key=lambda fault: fault.frame)), either=True)


def _in_columns(
    sample: FrameSample, finer: Finer | None, columns: NDArray[np.bool_]
) -> tuple[FrameSample, Finer | None]:
    """A sample, and a finer one, in some of the grid's columns."""
    return sample.within(columns), None if finer is None else lambda rows: finer(rows).within(columns)


def _described(
    sample: FrameSample, exposure: int, frames: tuple[int, ...], finer: Finer | None
) -> tuple[FrameFault, ...]:
    """The faults of frames that were left out; none if one of them is what it should be."""
    faults = [describe_frame(sample, exposure, frame, frames, finer) for frame in frames]
    return tuple(fault for fault in faults if fault) if all(faults) else ()


def _other_order(sample: FrameSample, expected_gradient: Array | None) -> FrameOrder | None:
    """The simplest other order in which the frames of all exposures agree."""
    exposures = len(sample.levels)
    everywhere = np.ones(len(sample.rows), bool)
    # The exposure with most fringes.
    shown = [_carries_fringes(sample, e).mean() for e in range(exposures)]
    levels = _some_pixels(sample, int(np.argmax(shown)), everywhere)
    listed = _try(levels, np.arange(len(levels)), sample)
    for order in frame_orders(sample.code, exposures):
        if not _fits(_try(levels, np.array(order.shows), sample), listed):
            continue
        if expected_gradient is None or _rises_along(sample, order, expected_gradient):
            return order
    return None


def _fits(trial: _Trial, listed: _Trial) -> bool:
    """Whether frames agree under a hypothesis, and better than as they are listed."""
    if trial.judged < max(_LEAST_PIXELS, _JUDGED_PART * listed.judged):
        return False
    if trial.deviation >= 1 or trial.share > _FITS_SHARE:
        return False
    fewer = listed.share > _ODD_SHARE and trial.share <= _FITS_PART * listed.share
    return fewer or (listed.deviation > 1 and trial.deviation <= _FITS_PART * listed.deviation)


def _carries_fringes(sample: FrameSample, exposure: int) -> NDArray[np.bool_]:
    """(pixels,) where an exposure shows fringes, whatever two of its frames are."""
    levels = np.sort(sample.frames(exposure)[: sample.code.fringe_frames], axis=0)
    swing = levels[-2] - levels[1]
    return np.asarray(
        (swing > _FRINGE_SIGMAS * sample.noise.sigma(levels.mean(0))) & unclipped(levels, sample.saturation)
    )


def _some_pixels(sample: FrameSample, exposure: int, rows: NDArray[np.bool_]) -> Float32:
    """(all frames, n) at some of the pixels, in these rows, where an exposure shows fringes."""
    lit = np.flatnonzero(_carries_fringes(sample, exposure) & np.repeat(rows, sample.columns.shape[1]))
    lit = lit[:: max(1, len(lit) // _PIXELS)]
    return np.ascontiguousarray(sample.levels.reshape(-1, sample.columns.size)[:, lit])


def _try(levels: Float32, shows: NDArray[np.int64], sample: FrameSample) -> _Trial:
    """Judge (all frames, n) levels, each frame being taken for what it shows, −1 for nothing."""
    frames, fringes = sample.code.frames, sample.code.fringe_frames
    worst, contradictory, judged = 0.0, 0, 0
    for exposure in np.unique(shows[shows >= 0] // frames):
        listed = np.flatnonzero((shows // frames == exposure) & (shows % frames < fringes) & (shows >= 0))
        fit = fit_sinusoids(levels[listed], (shows[listed] % frames).tolist(), sample.code)
        if fit is None:
            return _Trial(np.inf, 1.0, 0)
        told = agreement(fit, sample.code, sample.noise, _coarse(levels, shows, int(exposure), sample, fit))
        lit = told.judged & unclipped(levels[listed], sample.saturation)
        if lit.sum() < _LEAST_PIXELS:
            continue
        deviation = largest_deviation(fit, sample.code, lit, 1, np.array([0]))[0]
        worst = max(worst, float(deviation), told.drift / DRIFT)
        contradictory += int(told.contradictory[lit].sum())
        judged += int(lit.sum())
    return _Trial(worst, contradictory / max(judged, 1), judged)


def _coarse(
    levels: Float32, shows: NDArray[np.int64], exposure: int, sample: FrameSample, fit: SinusoidFit
) -> Float32 | None:
    """Positions that the Gray-code frames tell in a hypothesis; one that is missing is taken as listed."""
    if sample.code.gray is None:
        return None
    wanted = exposure * sample.code.frames + np.arange(sample.code.fringe_frames, sample.code.frames)
    places = [int(np.flatnonzero(shows == p)[0]) if (shows == p).any() else int(p) for p in wanted]
    return coarse_positions(levels[places], sample.code, fit.mean)


def _rises_along(sample: FrameSample, order: FrameOrder, expected: Array) -> bool:
    """Whether the projector coordinate rises over the image as expected, not against it, in some exposure."""
    levels = sample.levels.reshape(-1, sample.columns.size)
    shows = np.array(order.shows)
    for exposure in range(len(sample.levels)):
        at = np.flatnonzero((shows // sample.code.frames == exposure) & (shows >= 0))
        at = at[shows[at] % sample.code.frames < sample.code.fringe_frames]
        fit = fit_sinusoids(levels[at], (shows[at] % sample.code.frames).tolist(), sample.code)
        if fit is None:
            continue
        told = agreement(fit, sample.code, sample.noise, _coarse(levels, shows, exposure, sample, fit))
        good = told.judged & ~told.contradictory
        if good.sum() < _LEAST_PIXELS:
            continue
        rows = np.repeat(sample.rows, sample.columns.shape[1])
        return direction_cosine(sample.columns.ravel()[good], rows[good], told.position[good], expected) > _BACKWARDS
    return True


def direction_cosine(columns: NDArray, rows: NDArray, position: Array, expected: Array) -> float:
    """Cosine of the angle between a coordinate's mean gradient over the image and the expected one."""
    design = np.column_stack([np.ones(len(rows)), columns, rows])
    gradient = np.linalg.lstsq(design, position, rcond=None)[0][1:]
    return float(gradient @ expected / max(np.linalg.norm(gradient) * np.linalg.norm(expected), 1e-12))

"""A coarse grid of one camera's frames, and how well each frame fits the others there.

Every pixel sees, in all frames of an exposure, one mean level A and per fringe count one phasor ``C − jS = B e^{jφ}``:
``I = A + C_k cos δ_j − S_k sin δ_j`` with 1 + 2K unknowns for K counts. A sound scan has more frames than that; what
the others say about a frame (its residual divided by one minus its leverage) needs no second fit. Unlike the
difference of neighbours that `metrology.noise` uses, it keeps the smooth residual that a wrong frame leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Float32
from metrology.fringe import FringeCode
from metrology.gray import stripe_positions
from metrology.noise import NoiseModel
from metrology.unwrap import nearest_lattice_point, order_lattice

# About this many rows and columns are looked at. Each sample lies elsewhere in its cell of the grid, evenly spread (by
# powers of the plastic number), so that no period of fringes meets the grid's.
_ROWS, _COLUMNS = 136, 64
_SHIFT = 0.5698, 0.7549
# An edge: brightness changes by this share of itself from pixel to pixel. What trembles by a tenth of a pixel there
# changes it by a fiftieth from frame to frame, and more where the slope is steeper.
_EDGE = 0.2
# The top of the camera's range, told from the brightest samples but for a few hot pixels.
_BRIGHTEST, _CLIPPED = 0.999, 0.985
# Wrong frames inflate the estimate of the noise: no camera's is taken to exceed these parts of that top.
_MOST_READ_NOISE, _MOST_GAIN = 0.01, 5e-4
# Phases contradict each other from this share of half a lattice step on …
_CONTRADICTION = 0.5
# … if noise does not explain it; a pixel is judged where these many deviations stay below this share.
_NOISE_SIGMAS, _JUDGED = 4.0, 0.9
# Turns of the phase: of the unlit pixels, whose fringes are noise alone, one in 200 000 has fringes as sure (5 σ).
_SURE_PHASE = 1 / (10 * np.pi)
# A count without fringes where the others have some: less than this share of the largest amplitude.
FAINT_COUNT = 0.1
# Gray code: farther than this from the middle of the stripe (stripes) and from the fringe it tells (fringes).
_OFF_STRIPE, _OFF_FRINGE = 0.55, 0.275


@dataclass(frozen=True)
class FrameSample:
    """Samples of one camera's frames on a coarse grid."""

    levels: Float32
    """(exposures, frames, rows, columns) float32."""
    rows: NDArray[np.int64]
    """(rows,): image rows of the grid."""
    columns: NDArray[np.int64]
    """(rows, columns): image columns of the grid."""
    code: FringeCode
    noise: NoiseModel
    saturation: float
    """Grey level from which a sample counts as clipped."""
    edges: NDArray[np.bool_]
    """(rows, columns): where brightness changes so steeply that frames differ as soon as anything trembles."""

    def frames(self, exposure: int) -> Float32:
        """(frames, pixels) of one exposure."""
        return self.levels[exposure].reshape(self.levels.shape[1], -1)

    def within(self, columns: NDArray[np.bool_]) -> FrameSample:
        """The part of the grid in these of its columns."""
        levels = np.ascontiguousarray(self.levels[..., columns])
        return replace(self, levels=levels, columns=self.columns[:, columns], edges=self.edges[:, columns])


@dataclass(frozen=True)
class SinusoidFit:
    """One exposure's fit of mean level and phasors at n pixels."""

    mean: Float32
    """(n,) float32."""
    phasors: NDArray[np.complex64]
    """(counts used, n) complex64: B e^{jφ}."""
    used: tuple[int, ...]
    """Which of the code's counts have enough frames for a phasor."""
    errors: Float32
    """(frames, n) float32: each frame less what the others say of it; 0 where they say nothing."""
    shows: NDArray[np.int64]
    """(frames,): the pattern that each of these frames was taken for."""

    @property
    def amplitude(self) -> Float32:
        """(counts used, n) B."""
        return np.abs(self.phasors)

    def pattern(self, index: int, code: FringeCode) -> Float32:
        """(n,) what pattern `index` adds to the mean level, from its count's phasor."""
        turned = self.phasors[self.used.index(code.count_of[index])] * np.complex64(
            np.exp(1j * code.step_angles[index])
        )
        return np.ascontiguousarray(turned.real)


def sample_frames(
    frames: NDArray, code: FringeCode, noise: NoiseModel, rows: NDArray[np.int64] | None = None
) -> FrameSample:
    """Take a coarse grid of samples out of one camera's frames; `rows` names image rows other than the usual ones.

    Parameters
    ----------
    frames : (exposures, code.frames, h, w) ndarray of uint8 or uint16
    """
    height, width = frames.shape[2:]
    row_stride, column_stride = max(1, height // _ROWS), max(1, width // _COLUMNS)
    if rows is None:
        rows = np.arange(row_stride // 2, height, row_stride)
    first = np.arange(0, width - column_stride + 1, column_stride)
    within = np.arange(len(rows))[:, None] * _SHIFT[0] + np.arange(len(first)) * _SHIFT[1]
    columns = first + (within % 1 * column_stride).astype(int)
    levels = frames[:, :, rows[:, None], columns].astype(np.float32)
    saturation = _CLIPPED * float(np.quantile(levels[..., ::5, ::3], _BRIGHTEST))
    read = min(noise.read_variance, max((_MOST_READ_NOISE * saturation) ** 2, 1e-3))
    quiet = NoiseModel(read, min(noise.gain, _MOST_GAIN * saturation))
    return FrameSample(levels, rows, columns, code, quiet, saturation, _edges(frames, code, rows, columns))


def _edges(frames: NDArray, code: FringeCode, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """See `FrameSample.edges`; over all steps of the first exposure, so that fringes leave none."""
    fringes = frames[0, : code.fringe_frames]
    if not len(fringes):
        return np.zeros(columns.shape, bool)
    (height, width), at = frames.shape[2:], rows[:, None]

    def level(down: int, right: int) -> NDArray:
        place = np.clip(at + down, 0, height - 1), np.clip(columns + right, 0, width - 1)
        return np.asarray(fringes[:, *place].mean(0))

    slope = np.hypot(level(1, 0) - level(-1, 0), level(0, 1) - level(0, -1)) / 2
    return np.asarray(slope > _EDGE * level(0, 0))


@lru_cache(maxsize=512)
def _solver(shows: tuple[int, ...], code: FringeCode) -> tuple[tuple[int, ...], Array, Array] | None:
    """Counts with a phasor, the solver (1 + 2·used, frames) of their fit, and errors (frames, frames) from levels.

    None where no count has frames enough.
    """
    patterns = np.array(shows, np.int64)
    step, count = code.step_angles[patterns], code.count_of[patterns]
    used = tuple(k for k in range(len(code.counts)) if len(set(patterns[count == k])) >= 2)
    design = [np.ones(len(shows))]
    for k in used:
        own = count == k
        design += [own * np.cos(step), own * -np.sin(step)]
    matrix = np.column_stack(design)[np.isin(count, used)] if used else np.empty((0, 1))
    if not used or np.linalg.matrix_rank(matrix) < matrix.shape[1]:
        return None
    solver = np.zeros((matrix.shape[1], len(shows)))
    solver[:, np.isin(count, used)] = np.linalg.pinv(matrix)
    residual = np.eye(len(shows)) - np.column_stack(design) @ solver
    own = np.diag(residual)
    told = np.isin(count, used) & (own > 1e-6)
    return used, solver, np.where(told[:, None], residual / np.where(told, own, 1.0)[:, None], 0.0)


def fit_sinusoids(levels: Float32, shows: Sequence[int], code: FringeCode) -> SinusoidFit | None:
    """Fit mean level and phasors, each frame being taken for the pattern that it `shows`.

    Parameters
    ----------
    levels : (frames, n) float32
    shows : sequence of int
        Pattern of each frame, count-major, then step.

    Returns
    -------
    SinusoidFit or None
        None where these frames do not determine it.
    """
    solved = _solver(tuple(int(p) for p in shows), code)
    if solved is None:
        return None
    used, solver, errors = solved
    values = solver.astype(np.float32) @ levels
    phasors = values[1::2] + 1j * values[2::2]
    return SinusoidFit(values[0], phasors, used, errors.astype(np.float32) @ levels, np.array(shows))


@dataclass(frozen=True)
class Agreement:
    """Whether the counts of a fit (or fringes and Gray code) tell one position."""

    judged: NDArray[np.bool_]
    """(n,): where there are fringes enough to judge by."""
    contradictory: NDArray[np.bool_]
    """(n,): False where not judged."""
    position: Array
    """(n,) float64: in [0, 1) across the projector; across a common factor's part of it where only such counts are
    used."""
    drift: float
    """Median of what the phases miss a common position by, as a share of half a lattice step; 0 with Gray code."""
    missed: Array | None = None
    """(counts used, n) what each phase misses the common position by, in turns; None with Gray code."""


def agreement(fit: SinusoidFit, code: FringeCode, noise: NoiseModel, coarse: Float32 | None = None) -> Agreement:
    """Compare the counts of a fit with each other, or with the position in [0, 1) that Gray code tells (`coarse`)."""
    amplitude = fit.amplitude
    largest = amplitude.max(0)
    faint = amplitude.min(0) < FAINT_COUNT * largest
    sigma = (
        noise.sigma(np.maximum(fit.mean, 0))
        * np.sqrt(2 / min(code.step_counts))
        / (2 * np.pi * np.maximum(largest, 1e-6))
    )
    turns = np.angle(fit.phasors).astype(np.float64) / (2 * np.pi) - code.offset_turns[list(fit.used), None]
    counts = tuple(code.counts[k] for k in fit.used)
    drift, missed = 0.0, None
    if coarse is not None and code.gray is not None:
        judged = sigma < min(_OFF_FRINGE / _NOISE_SIGMAS, _SURE_PHASE)
        position, off = _from_stripes(turns, counts, coarse, code.gray.stripes)
        far = off > 1
    else:
        lattice = order_lattice(tuple(c // int(np.gcd.reduce(counts)) for c in counts))
        half = lattice.shortest / 2
        judged = sigma < min(_JUDGED * half / _NOISE_SIGMAS, _SURE_PHASE)
        position, missed = nearest_lattice_point(turns, lattice)
        far = np.sqrt((missed**2).sum(0)) > np.maximum(_CONTRADICTION * half, _NOISE_SIGMAS * sigma)
        if len(counts) > 1 and judged.any():
            drift = float(np.linalg.norm(np.median(missed[:, judged], axis=1))) / half
    return Agreement(judged, judged & (far | faint), position, drift, missed)


def _from_stripes(turns: Array, counts: tuple[int, ...], coarse: Float32, stripes: int) -> tuple[Array, Array]:
    """Position, and how far phases lie from where Gray code, then the coarser count, expects them; 1 is too far."""
    worst = np.zeros(turns.shape[1])
    position = coarse.astype(np.float64)
    for index, k in enumerate(np.argsort(counts)):
        off = turns[k] - counts[k] * position
        off -= np.rint(off)
        limit = max(_OFF_STRIPE * counts[k] / stripes, _OFF_FRINGE) if index == 0 else _OFF_FRINGE
        worst = np.maximum(worst, np.abs(off) / limit)
        position = position + off / counts[k]
    return position, worst


def coarse_positions(levels: Float32, code: FringeCode, reference: Float32) -> Float32 | None:
    """(n,) positions in [0, 1) that Gray code tells; None for a code without.

    Parameters
    ----------
    levels : (gray frames, n) float32
    reference : (n,) float32
        Mean level of the fringe frames.
    """
    if code.gray is None:
        return None
    return stripe_positions(levels[None, :, None], code.gray, reference[None], (1.0,), np.inf)[0]

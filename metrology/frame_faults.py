"""What a frame that does not fit the others looks like, and in which rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.frame_consistency import frame_deviations, unclipped
from metrology.frame_sample import FrameSample, SinusoidFit, fit_sinusoids

Look = Literal["same", "like", "dark", "flat", "brighter", "darker", "other"]

# A frame without fringes and darker than this share of the mean level is dark.
_DARK = 0.3
# Share of a frame's variation that another picture must explain to be what it shows.
_EXPLAINS = 0.8
# A frame that varies by less than this share of what fringes would, squared, has none.
_NOTHING = 0.1
# A frame whose brightness is within this share of the others' is wrong in something else.
_AS_BRIGHT = 0.05
# A frame is wrong as a whole if hardly any rows, this share of all, are left beside the wrong ones.
_BESIDE = 0.02
# A pixel tells something of a frame where the others' fringes exceed their noise by this factor.
_FRINGE_SIGMAS = 5.0
_LEAST_PIXELS = 8

Finer = Callable[[NDArray[np.int64]], FrameSample]


@dataclass(frozen=True)
class FrameFault:
    """A frame that does not fit the others of its camera."""

    frame: int
    """Place in the scene's list, exposure-major."""
    rows: tuple[int | None, int | None]
    """(int or None, int or None): first row where it does not fit, and the row behind the last one; None: from the top,
    to the bottom."""
    look: Look
    """The same picture as another frame, like another frame, dark, without fringes, its own pattern but of other
    brightness, or none of these."""
    other: int | None = None
    """The frame whose picture it is."""
    factor: float = 1.0
    """Its brightness relative to the other frames."""

    @property
    def telling(self) -> bool:
        """Whether the look alone says that the frame is wrong, whatever the others are."""
        return self.look in ("same", "dark")


def describe_frame(
    sample: FrameSample, exposure: int, frame: int, left_out: Sequence[int], finer: Finer | None = None
) -> FrameFault | None:
    """Describe a frame of an exposure by the frames other than `left_out`; None: it is what it should be.

    Parameters
    ----------
    left_out : sequence of int
        Frames of that exposure that are not to be relied on.
    finer : callable, optional
        Samples other image rows of the same frames.
    """
    wrong = _row_misfit(sample, exposure, frame, left_out)
    if np.isfinite(wrong).any() and not (wrong > 1).any():
        return None
    rows = _wrong_rows(sample, wrong, exposure, frame, left_out, finer)
    inside = _inside(sample.rows, rows)
    part = replace(
        sample, levels=sample.levels[:, :, inside], rows=sample.rows[inside], columns=sample.columns[inside],
        edges=sample.edges[inside],
    )  # fmt: skip
    at = exposure * sample.code.frames + frame
    same = same_picture(part, at, part)
    if same is not None:
        return FrameFault(at, rows, "same", same)
    return _likeness(part, exposure, frame, left_out, rows)


def same_picture(sample: FrameSample, frame: int, other: FrameSample) -> int | None:
    """Which frame of `other` equals a frame sample by sample (another frame, where both are one camera's)."""
    picture = sample.levels.reshape(-1, *sample.levels.shape[2:])[frame]
    for index, candidate in enumerate(other.levels.reshape(-1, *other.levels.shape[2:])):
        if (other is not sample or index != frame) and np.array_equal(picture, candidate) and np.ptp(picture) > 0:
            return index
    return None


def _inside(rows: NDArray[np.int64], wrong: tuple[int | None, int | None]) -> NDArray[np.bool_]:
    inside = (rows >= (wrong[0] or 0)) & (rows < (wrong[1] if wrong[1] is not None else rows[-1] + 1))
    return inside if inside.any() else np.ones(len(rows), bool)


def _fit_without(
    sample: FrameSample, exposure: int, left_out: Sequence[int]
) -> tuple[SinusoidFit, NDArray[np.int64], NDArray[np.bool_]] | None:
    """Fit of the frames that are relied on, which they are, and where they have fringes."""
    code = sample.code
    kept = np.array([p for p in range(code.fringe_frames) if p not in left_out])
    levels = sample.frames(exposure)[kept]
    fit = fit_sinusoids(levels, kept.tolist(), code)
    if fit is None:
        return None
    carries = fit.amplitude.min(0) > _FRINGE_SIGMAS * sample.noise.sigma(np.maximum(fit.mean, 0))
    lit = np.asarray(carries & unclipped(levels, sample.saturation))
    return fit, kept, lit


def _wrong_rows(
    sample: FrameSample, wrong: Array, exposure: int, frame: int, left_out: Sequence[int], finer: Finer | None
) -> tuple[int | None, int | None]:
    """Image rows in which a frame differs from its own pattern; (None, None): in all of them, or unknown."""
    judged = np.flatnonzero(np.isfinite(wrong))
    if not judged.size:
        return None, None
    bad = wrong[judged] > 1
    first, end = _densest_run(bad)
    beside = int(_BESIDE * len(bad))
    edges: list[int | None] = [None, None]
    for place, index in ((0, first), (1, end)):
        if beside < index < len(bad) - beside:
            low, high = int(sample.rows[judged[index - 1]]), int(sample.rows[judged[index]])
            edges[place] = _edge(low, high, place == 0, exposure, frame, left_out, finer)
    return edges[0], edges[1]


def _edge(
    low: int, high: int, begins: bool, exposure: int, frame: int, left_out: Sequence[int], finer: Finer | None
) -> int:
    """The row between two of the grid from which a frame is wrong, or is right again."""
    if finer is None or high - low < 2:
        return high
    rows = np.arange(low, high + 1)
    bad = np.nan_to_num(_row_misfit(finer(rows), exposure, frame, left_out)) > 1
    sign = np.where(bad == begins, 1, -1)
    # The split with most rows on their right side.
    after = np.concatenate([np.cumsum(sign[::-1])[::-1], [0]])
    before = np.concatenate([[0], np.cumsum(-sign)])
    return int(low + np.argmax(after + before))


def _row_misfit(sample: FrameSample, exposure: int, frame: int, left_out: Sequence[int]) -> Array:
    """(rows,) deviation of a frame from its own pattern, 1 the limit; NaN where it cannot be told."""
    rows = len(sample.rows)
    unknown = np.full(rows, np.nan)
    fitted = _fit_without(sample, exposure, left_out)
    if fitted is None or sample.code.count_of[frame] not in fitted[0].used:
        return unknown
    fit, _, lit = fitted
    error = sample.frames(exposure)[frame] - fit.mean - fit.pattern(frame, sample.code)
    alone = SinusoidFit(fit.mean, fit.phasors, fit.used, error[None], np.array([frame]))
    deviation = frame_deviations(alone, sample.code, lit, rows, np.arange(rows), 1)[0]
    return np.where(lit.reshape(rows, -1).sum(1) >= _LEAST_PIXELS, deviation, np.nan)


def _densest_run(bad: NDArray[np.bool_]) -> tuple[int, int]:
    """First and end of the run with the largest surplus of True over False."""
    total = np.concatenate([[0], np.cumsum(np.where(bad, 1, -1))])
    lowest = np.minimum.accumulate(total)
    end = int(np.argmax(total - lowest))
    first = int(np.flatnonzero(total[: end + 1] == lowest[end])[-1])
    return first, max(end, first + 1)


def _likeness(
    part: FrameSample, exposure: int, frame: int, left_out: Sequence[int], rows: tuple[int | None, int | None]
) -> FrameFault:
    """What picture explains a frame: its own pattern, that of another frame, or none."""
    at, code = exposure * part.code.frames + frame, part.code
    fitted = _fit_without(part, exposure, left_out)
    if fitted is None or not fitted[2].any():
        return FrameFault(at, rows, "other")
    fit, kept, lit = fitted
    levels = part.frames(exposure)
    mean = fit.mean[lit]
    pictures = {int(p): levels[p][lit] - mean for p in kept}
    if code.count_of[frame] in fit.used:
        pictures[frame] = fit.pattern(frame, code)[lit]
    factor = float(levels[frame][lit] @ mean / (mean @ mean))
    varied = levels[frame][lit] - factor * mean
    explained = {p: _explained(varied, mean, picture) for p, picture in pictures.items()}
    best = max(explained, key=lambda p: explained[p])
    if explained[best] > _EXPLAINS and best == frame and abs(factor - 1) > _AS_BRIGHT:
        return FrameFault(at, rows, "brighter" if factor > 1 else "darker", None, factor)
    amplitude, own = fit.amplitude.max(0)[lit], levels[frame][lit] - levels[frame][lit].mean()
    # A frame without fringes shows the skin's texture or nothing at all.
    if min(float(varied @ varied), float(own @ own)) < _NOTHING * float(amplitude @ amplitude) / 2:
        return FrameFault(at, rows, "dark" if factor < _DARK else "flat", None, factor)
    if explained[best] > _EXPLAINS and best != frame:
        return FrameFault(at, rows, "like", exposure * code.frames + best, factor)
    return FrameFault(at, rows, "other", None, factor)


def _explained(varied: NDArray, mean: NDArray, picture: NDArray) -> float:
    """Share of a frame's variation that a positive multiple of a picture explains, the mean level aside."""
    picture = picture - (picture @ mean) / (mean @ mean) * mean
    along = float(varied @ picture)
    total = float(varied @ varied) * float(picture @ picture)
    return along**2 / total if along > 0 and total > 0 else 0.0

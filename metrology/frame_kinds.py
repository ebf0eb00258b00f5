"""What the frames of an unknown capture show: fringes and their steps, stripes of Gray code, all white, all black.

Told from pixels that the pattern reaches. Between its darkest and its brightest level a pixel of a stripe is at one
end, one of a fringe anywhere; phase steps even over a turn leave one sinusoid and the same mean in every block of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.errors import SceneError
from metrology.fringe import Axis

Kind = Literal["fringes", "gray", "white", "black"]

_SAMPLES = 40_000
_BESIDE = 2  # px: over which a pattern is seen to change
_LEAST_SWING = 0.25  # of what the brightest pixels swing
_LEAST_LIT = 200
_HIGH, _LOW = 0.8, 0.2
_UNIFORM = 0.97  # of the lit pixels: an all-white or all-black frame
_LEAST_BETWEEN = 0.2  # of the lit pixels between low and high: of a sinusoid 0.41
_MOST_STEPS = 36
_AS_DENSE = 1.25  # stripes' borders of one frame over those of another: fringes of one count have as many at each step
_MANY_BORDERS = 0.02  # of the lit pixels: fine stripes have more
_LARGEST_MISFIT = 0.45  # of the amplitude: what a projector's gamma leaves of a sinusoid
_CLEARLY = 0.5  # of the misfit of another order of the frames
_LEAST_TURN = 0.2  # of all change: what a turn of the code from one axis to the other explains more than none
_TOGETHER = -0.5  # correlation with its inverse that a frame is below


@dataclass(frozen=True)
class FrameSample:
    """Some pixels of every frame, with their neighbours to the right and below."""

    here: Array
    """(frames, n)."""
    right: Array
    below: Array


@dataclass(frozen=True)
class Run:
    """Frames in succession that show one kind of pattern along one axis."""

    kind: Kind
    axis: Axis | None
    """None of uniform frames."""
    frames: int
    steps: tuple[int, ...] = ()
    """Phase steps of each count; empty where they were not found."""
    inverse: bool = False
    """Whether Gray-code frames come with their inverses."""
    apart: bool = False
    """Whether the inverses of all bits come after the bits, or else each after its bit."""
    by_step: bool = False
    """Whether fringes run through all counts at each step, or else through all steps of each count."""


def sample(frames: Iterable[NDArray]) -> FrameSample:
    """A grid of pixels out of frames that come one by one, (h, w) each."""
    parts: list[list[NDArray]] = [[], [], []]
    for frame in frames:
        height, width = frame.shape
        step = max(1, round(float(np.sqrt(height * width / _SAMPLES))))
        grid = np.s_[: height - _BESIDE : step, : width - _BESIDE : step]
        for part, (dv, du) in zip(parts, ((0, 0), (0, _BESIDE), (_BESIDE, 0)), strict=True):
            part.append(frame[dv:, du:][grid].ravel().astype(np.float32))
    if not parts[0]:
        raise SceneError("found no frames, expected those of one camera")
    return FrameSample(*(np.array(part) for part in parts))


def runs_of(taken: FrameSample) -> list[Run]:
    """The frames of one camera as runs of one kind each.

    Raises
    ------
    SceneError
        Where hardly a pixel changes from frame to frame.
    """
    dark, bright = taken.here.min(0), taken.here.max(0)
    swing = bright - dark
    lit = swing > max(_LEAST_SWING * float(np.percentile(swing, 99)), 1.0)
    if lit.sum() < _LEAST_LIT:
        raise SceneError(f"found {int(lit.sum())} pixels that change from frame to frame, expected those of a pattern")
    level = (taken.here - dark)[:, lit] / swing[lit]
    kinds = _kinds(level, _borders(taken, lit))
    axes = _axes(taken, lit, kinds)
    runs = []
    for first, end in _stretches(list(zip(kinds, axes, strict=True))):
        kind, axis, own = kinds[first], axes[first], taken.here[first:end][:, lit]
        steps, by_step = _steps(own) if kind == "fringes" else ((), False)
        even = kind == "gray" and (end - first) % 2 == 0
        paired = even and _paired(own)
        apart = even and not paired and _paired(_in_turn(own))
        runs.append(Run(kind, axis, end - first, steps, paired or apart, apart, by_step))
    return runs


def _kinds(level: Array, borders: Array) -> list[Kind]:
    """Fringes or stripes, which leave few levels between dark and bright; white and black."""
    ends = (level > _HIGH).mean(1) + (level < _LOW).mean(1)
    kinds: list[Kind] = ["gray" if share > 1 - _LEAST_BETWEEN else "fringes" for share in ends]
    for first, end in _stretches(kinds):  # the finest stripes are blurred, and fringes take three steps
        if kinds[first] == "fringes":
            steps = _without_stripes(borders, first, end, kinds) if end - first >= 3 else range(0)
            kinds[first:end] = ["fringes" if k in steps else "gray" for k in range(first, end)]
    _name_references(level, kinds)
    return kinds


def _borders(taken: FrameSample, lit: NDArray[np.bool_]) -> Array:
    """(frames,) how often a lit pixel and one beside it lie on either side of the middle between dark and bright."""
    above = [part[:, lit] > ((part.min(0) + part.max(0)) / 2)[lit] for part in (taken.here, taken.right, taken.below)]
    return np.asarray((above[0] != above[1]).mean(1) + (above[0] != above[2]).mean(1))


def _without_stripes(borders: Array, first: int, end: int, kinds: Sequence[Kind]) -> range:
    """What is left of fringes when blurred stripes beside other stripes are taken off: frames to which no two others
    are alike in borders, since a count has three steps and more, and a bit twice the borders of the one before.
    """
    own = borders[first:end]
    alike = (own <= _AS_DENSE * own[:, None]) & (own[:, None] <= _AS_DENSE * own)
    alone = (alike.sum(1) < 3) & (own > _MANY_BORDERS)
    start, stop = 0, end - first
    while first and kinds[first - 1] == "gray" and start < stop and alone[start]:
        start += 1
    while end < len(kinds) and kinds[end] == "gray" and start < stop and alone[stop - 1]:
        stop -= 1
    return range(first + start, first + stop if stop - start >= 3 else first + start)


def _name_references(level: Array, kinds: list[Kind]) -> None:
    """Name all-white and all-black frames. They come as a pair before or after the stripes; a coarse bit among stripes
    may be uniform where the object is.
    """
    high, low = (level > _HIGH).mean(1), (level < _LOW).mean(1)
    said = list(kinds)
    for k in range(len(kinds) - 1):
        white_first = high[k] > low[k]
        pair = (high[k], low[k + 1]) if white_first else (low[k], high[k + 1])
        inside = 0 < k < len(kinds) - 2 and said[k - 1] == said[k + 2] == "gray"
        if min(pair) > _UNIFORM and not inside:
            kinds[k : k + 2] = ["white", "black"] if white_first else ["black", "white"]
    ends = (high[0], low[-1]) if high[0] > low[0] else (low[0], high[-1])
    if min(ends) > _UNIFORM and said[0] == said[-1] == "gray":  # named so that one comes first and the other last
        kinds[0], kinds[-1] = ("white", "black") if high[0] > low[0] else ("black", "white")


def _axes(taken: FrameSample, lit: NDArray[np.bool_], kinds: Sequence[Kind]) -> list[Axis | None]:
    """Along which image axis the frames change: x where stripes stand upright.

    A run of one kind runs along one axis, or along one and then the other. Coarse stripes change at few pixels, and
    weigh by them. Each pixel counts between its own dark and bright: what is printed on the object changes from pixel
    to pixel too, more than coarse stripes do.
    """
    here, right, below = (_shares(part[:, lit]) for part in (taken.here, taken.right, taken.below))
    along, down = np.abs(right - here).mean(1), np.abs(below - here).mean(1)
    axes: list[Axis | None] = [None] * len(kinds)
    for first, end in _stretches(kinds):
        if kinds[first] in ("white", "black"):
            continue
        lead = (along - down)[first:end]
        ahead = np.concatenate([[0.0], np.cumsum(lead)])
        turned = np.abs(ahead - (ahead[-1] - ahead))  # the first k along one axis, the others along the other one
        k, least = int(np.argmax(turned)), _LEAST_TURN * np.abs(lead).sum()
        half = (end - first) // 2
        if turned[half] > turned[k] - _LEAST_TURN / 2 * np.abs(lead).sum():
            k = half  # a coarse bit leans to either side; codes along both axes are mostly of one length
        if turned[k] < abs(ahead[-1]) + least:
            k = 0
        start: Axis = "x" if ahead[k] - (ahead[-1] - ahead[k]) > 0 else "y"
        other: Axis = "y" if start == "x" else "x"
        axes[first:end] = [start] * k + [other] * (end - first - k)
    return axes


def _shares(frames: Array) -> Array:
    """(frames, n) where between its darkest and its brightest level each pixel is."""
    dark = frames.min(0)
    return np.asarray((frames - dark) / np.maximum(frames.max(0) - dark, 1.0))


def _stretches(labels: Sequence[object]) -> list[tuple[int, int]]:
    """First and end of each stretch of equal labels."""
    starts = [k for k in range(len(labels)) if k == 0 or labels[k] != labels[k - 1]]
    return list(zip(starts, [*starts[1:], len(labels)], strict=True))


def _steps(levels: Array) -> tuple[tuple[int, ...], bool]:
    """Steps of each count: the division into blocks that are one sinusoid each, about one and the same mean.

    The second value is whether the blocks' frames come in turn, step by step.
    """
    count = len(levels)
    best: list[tuple[float, tuple[int, ...]]] = [(np.inf, ()) for _ in range(count + 1)]
    best[0] = (0.0, ())
    amplitude = np.sqrt(2) * levels.std(0)
    good = amplitude > np.median(amplitude)
    levels, amplitude = levels[:, good], amplitude[good]
    mean = levels.mean(0)
    for end in range(3, count + 1):
        for steps in range(3, min(end, _MOST_STEPS) + 1):
            before, told = best[end - steps]
            if not np.isfinite(before):
                continue
            worst = max(before, _misfit(levels[end - steps : end], mean, amplitude))
            if worst < best[end][0] - 1e-3:
                best[end] = (worst, (*told, steps))
    misfit, told = best[count]
    turns = [n for n in range(2, count // 3 + 1) if count % n == 0 and count // n <= _MOST_STEPS]
    by_step = {n: max(_misfit(levels[k::n], mean, amplitude) for k in range(n)) for n in turns}
    n = min(by_step, key=by_step.__getitem__, default=0)
    if n and by_step[n] < min(_CLEARLY * misfit, _LARGEST_MISFIT):
        return (count // n,) * n, True
    return (told, False) if misfit < _LARGEST_MISFIT else ((), False)


def _misfit(block: Array, mean: Array, amplitude: Array) -> float:
    """How far frames are off one sinusoid, of its amplitude: by its residual, its mean and its strength."""
    steps = len(block)
    angle = 2 * np.pi * np.arange(steps) / steps
    own = block.mean(0)
    phasor = np.exp(-1j * angle) @ block * 2 / steps
    off = block - own - (np.exp(1j * angle)[:, None] * phasor).real
    parts = (np.sqrt((off**2).mean(0) * 2), np.abs(own - mean), np.abs(np.abs(phasor) - amplitude))
    return float(sum(np.median(part / amplitude) for part in parts))


def _in_turn(frames: Array) -> Array:
    """Bits and then their inverses as each bit and its inverse."""
    half = len(frames) // 2
    return np.asarray(np.stack([frames[:half], frames[half:]], axis=1).reshape(frames.shape))


def _paired(levels: Array) -> bool:
    """Whether every second frame is dark where the one before is bright."""
    centred = levels - levels.mean(0)
    return all(
        float(np.corrcoef(centred[k], centred[k + 1])[0, 1]) < _TOGETHER or centred[k].std() < 1.0
        for k in range(0, len(levels), 2)
    )

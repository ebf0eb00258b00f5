"""Ways in which a scene may list its frames in another order than they were shown.

An order is told as `shows`: for each listed frame (exposure-major, then as the code has them) the frame of the code
that it really is, −1 where that cannot be told. Simple mix-ups come first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from metrology.fringe import FringeCode

# More counts than this have too many orders to try.
_MOST_COUNTS = 4
# Of more frames than this only neighbours are tried exchanged.
_MOST_EXCHANGED = 16


@dataclass(frozen=True)
class FrameOrder:
    """One way of listing frames."""

    what: str
    """What the frames fit if they are taken for it: completes "they fit …"."""
    shows: tuple[int, ...]


def frame_orders(code: FringeCode, exposures: int) -> Iterator[FrameOrder]:
    """Likely orders other than the listed one, simple ones first, each only once."""
    seen = {tuple(range(exposures * code.frames))}
    for order in _candidates(code, exposures):
        if order.shows not in seen:
            seen.add(order.shows)
            yield order


def _candidates(code: FringeCode, exposures: int) -> Iterator[FrameOrder]:
    if isinstance(code.steps, int):  # what follows takes blocks of as many frames for counts
        yield from _of_steps(code, code.steps, exposures)
        yield from _of_names(code, code.steps, exposures)
        yield from _of_counts(code, code.steps, exposures)
    yield from _shifted(code, exposures)
    yield from _exchanged(code, exposures)


def _each_exposure(what: str, shows: list[int], code: FringeCode, exposures: int) -> FrameOrder:
    """The same order of fringe frames in every exposure; Gray-code frames stay unless they are told as well."""
    whole = shows + list(range(len(shows), code.frames))
    return FrameOrder(what, tuple(e * code.frames + p if p >= 0 else -1 for e in range(exposures) for p in whole))


def _of_steps(code: FringeCode, n: int, exposures: int) -> Iterator[FrameOrder]:
    def every(step: list[int]) -> list[int]:
        return [k * n + s for k in range(len(code.counts)) for s in step]

    reverse = [(-s) % n for s in range(n)]
    backwards = "with the steps of each count in reverse order"
    yield _each_exposure(backwards, every(reverse), code, exposures)
    yield _each_exposure(backwards, every(reverse[1:] + reverse[:1]), code, exposures)
    for turn in range(1, n):
        rotated = [(s + turn) % n for s in range(n)]
        yield _each_exposure(
            f"with the steps of each count beginning at step {turn + 1}", every(rotated), code, exposures
        )
    for turn in range(1, n - 1):
        turned = [(-s - 1 - turn) % n for s in range(n)]
        yield _each_exposure(
            f"with the steps of each count in reverse order, beginning at step {turned[0] + 1}",
            every(turned),
            code,
            exposures,
        )


def _of_names(code: FringeCode, steps: int, exposures: int) -> Iterator[FrameOrder]:
    names = "if they are read in the order of their numbers: they are listed as text is sorted (1, 10, 11, 2)"
    total = exposures * code.frames
    for size in (total, code.frames, code.fringe_frames):
        for first in (1, 0):
            shows = sorted(range(size), key=lambda i, first=first: str(i + first))  # type: ignore[misc]
            if size == total:
                yield FrameOrder(names, tuple(shows))
                inverse = np.argsort(shows)
                yield FrameOrder(names, tuple(int(i) for i in inverse))
            else:
                yield _each_exposure(names, shows, code, exposures)
    for first in (1, 0):
        step = sorted(range(steps), key=lambda i, first=first: str(i + first))  # type: ignore[misc]
        yield _each_exposure(names, [k * steps + s for k in range(len(code.counts)) for s in step], code, exposures)
    yield FrameOrder("if they are read in reverse order, the last one first", tuple(range(total))[::-1])
    yield _each_exposure(
        "if they are read in reverse order, the last one first", list(range(code.fringe_frames))[::-1], code, exposures
    )
    interleaved = [i % exposures * code.frames + i // exposures for i in range(total)]
    yield FrameOrder("with all exposures of a frame one after the other", tuple(interleaved))


def _of_counts(code: FringeCode, n: int, exposures: int) -> Iterator[FrameOrder]:
    k = len(code.counts)
    by_step = [i % k * n + i // k for i in range(n * k)]
    yield _each_exposure("with all counts of a step one after the other", by_step, code, exposures)
    if code.gray:
        first = list(range(code.fringe_frames, code.frames)) + list(range(code.fringe_frames))
        yield _each_exposure("with the Gray-code frames before the fringes", first, code, exposures)
        bits = list(range(code.fringe_frames, code.frames))
        per_bit = 2 if code.gray.inverse else 1
        pairs = [bits[i : i + per_bit] for i in range(0, len(bits), per_bit)]
        turned = [frame for pair in pairs[::-1] for frame in pair]
        yield _each_exposure(
            "with the Gray-code frames from the least significant bit on",
            list(range(code.fringe_frames)) + turned,
            code,
            exposures,
        )
    if not 1 < k <= _MOST_COUNTS:
        return
    reverse = [(-s) % n for s in range(n)]
    for steps, also in ((list(range(n)), ""), (reverse, " and the steps of each in reverse order")):
        for order in permutations(range(k)):
            counts = ", ".join(str(code.counts[c]) for c in order)
            yield _each_exposure(
                f"with counts in the order {counts}{also}", [c * n + s for c in order for s in steps], code, exposures
            )


def _shifted(code: FringeCode, exposures: int) -> Iterator[FrameOrder]:
    """Sequences that run late or early, from the first frame or a later one on, or begin somewhere else."""
    total = exposures * code.frames
    for first in range(total - 1):
        since = "" if first == 0 else f" from frame {first + 1} on"
        late = (*range(first), first - 1, *range(first, total - 1))
        early = (*range(first), *range(first + 1, total), -1)
        yield FrameOrder(f"if each is taken for the one before it{since}: they are late by one", late)
        yield FrameOrder(f"if each is taken for the one after it{since}: one was left out", early)
    for turn in range(1, code.fringe_frames):
        rotated = [(i + turn) % code.fringe_frames for i in range(code.fringe_frames)]
        yield _each_exposure(f"if the sequence begins at frame {turn + 1}", rotated, code, exposures)


def _exchanged(code: FringeCode, exposures: int) -> Iterator[FrameOrder]:
    total = exposures * code.frames
    for i in range(total):
        for j in range(i + 1, total if total <= _MOST_EXCHANGED else min(i + 2, total)):
            shows = list(range(total))
            shows[i], shows[j] = j, i
            yield FrameOrder(f"if frame {i + 1} and frame {j + 1} of the list are exchanged", tuple(shows))

"""Exposure times: what they are relative to, and whether the frames agree with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrology.errors import SceneError
from metrology.fringe import FringeCode
from metrology.saturation import code_saturation, sampled

MAX_RATIO = 1e6  # of the longest to the shortest: more than any camera has
_TOLERANCE = 1.2  # factor between the ratio that is stated and the one that is seen
_LEAST_AMPLITUDE = 0.03  # of the saturation level, in the shorter exposure
_LEAST_PIXELS = 300
_MOST_ORDERED = 5  # more exposure times have too many orders to try


def relative_exposures(times: Sequence[float]) -> tuple[float, ...]:
    """Times relative to exposure 1: as they are where 1 is among or between them, else relative to the middle one.

    Times that all lie on one side of 1 are in a unit: seconds, ms or µs. Only their ratios matter to the phase; with
    exposure 1 in the middle, brightness and least modulation are those of a usual frame.
    """
    if min(times) <= 1.0 <= max(times):
        return tuple(times)
    middle = sorted(times)[(len(times) - 1) // 2]
    return tuple(time / middle for time in times)


def check_brightness(frames: NDArray, code: FringeCode, exposures: Sequence[float]) -> None:
    """Refuse exposure times whose ratios are not those of the fringes' brightness, saying in which order they would be.

    Compared are amplitudes, which neither the room's light nor the camera's black level changes.

    Parameters
    ----------
    frames : (exposures, code.frames, h, w) ndarray of uint8 or uint16
    """
    if len(exposures) < 2:
        return
    samples = sampled(frames)[..., ::2, ::2]
    limit = code_saturation(frames, code)
    found = _first_mismatch(samples, code, exposures, limit)
    if isinstance(found, _Mismatch):
        raise SceneError(
            f"exposures: found {found.short:g} and {found.long:g}, {found.long / found.short:.3g} times as long, but "
            f"frames that are {found.seen:.3g} times as bright; {_expected(samples, code, exposures, limit)}"
        )


@dataclass(frozen=True)
class _Mismatch:
    """Two exposure times, and how many times as bright the frames of the longer one are."""

    short: float
    long: float
    seen: float


def _first_mismatch(
    samples: NDArray, code: FringeCode, exposures: Sequence[float], limit: float
) -> _Mismatch | Literal["none", "unseen"]:
    """The first two exposures that are not as bright as stated; "unseen" where no two can be compared."""
    stack = samples[:, : code.fringe_frames].reshape(len(exposures), code.fringe_frames, -1)
    of = [np.flatnonzero(code.count_of == k) for k in range(len(code.counts))]
    turning = np.exp(-1j * code.step_angles)
    phasors = np.stack([np.tensordot(turning[own], stack[:, own], (0, 1)) * 2 / len(own) for own in of], 1)
    clipped = np.stack([(stack[:, own] >= limit).any(1) for own in of], 1)
    seen_any = False
    for short, long in pairwise(np.argsort(exposures)):
        usable = (np.abs(phasors[short]) > _LEAST_AMPLITUDE * limit) & ~clipped[short] & ~clipped[long]
        ratios = [
            np.median(np.real(longer[use] / shorter[use]))
            for shorter, longer, use in zip(phasors[short], phasors[long], usable, strict=True)
            if use.sum() >= _LEAST_PIXELS
        ]
        if not ratios:
            continue
        seen_any = True
        seen = float(np.median(ratios))
        if not 1 / _TOLERANCE < seen * exposures[short] / exposures[long] < _TOLERANCE:
            return _Mismatch(exposures[short], exposures[long], seen)
    return "none" if seen_any else "unseen"


def _expected(samples: NDArray, code: FringeCode, exposures: Sequence[float], limit: float) -> str:
    """What the scene should list: the frames in another order, the times in another order, or other times."""
    by_frame = samples.reshape(samples.shape[1], samples.shape[0], *samples.shape[2:]).swapaxes(0, 1)
    if _first_mismatch(by_frame, code, exposures, limit) == "none":
        return (
            "the frames fit with all exposures of a frame one after the other; expected all frames of the first "
            "exposure, then all of the next"
        )
    for times in permutations(exposures) if len(exposures) <= _MOST_ORDERED else ():
        if _first_mismatch(samples, code, times, limit) == "none":
            return f"expected the times in the order of the frames: {', '.join(f'{time:g}' for time in times)}"
    return "expected the exposure times that the frames were taken with, in their order (they are relative)"

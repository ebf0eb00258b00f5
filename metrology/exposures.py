"""Exposure times: what they are relative to, and whether the frames agree with them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from metrology.errors import SceneError
from metrology.fringe import FringeCode
from metrology.saturation import sampled, saturation_level

MAX_RATIO = 1e6  # of the longest to the shortest: more than any camera has
_TOLERANCE = 1.2  # factor between the ratio that is stated and the one that is seen
_LEAST_AMPLITUDE = 0.03  # of the saturation level, in the shorter exposure
_LEAST_PIXELS = 300


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
    """Refuse exposure times whose ratios are not those of the fringes' brightness.

    Compared are amplitudes, which neither the room's light nor the camera's black level changes.

    Parameters
    ----------
    frames : (exposures, code.frames, h, w) ndarray of uint8 or uint16
    code : FringeCode
    exposures : sequence of float
    """
    if len(exposures) < 2:
        return
    fringes = sampled(frames[:, : code.fringe_frames])[..., ::2, ::2]
    limit = saturation_level(frames, frames[:, : code.fringe_frames])
    stack = fringes.reshape(len(exposures), len(code.counts), code.steps, -1)
    phasors = np.tensordot(np.exp(-2j * np.pi * np.arange(code.steps) / code.steps), stack, (0, 2)) * 2 / code.steps
    clipped = np.asarray((stack >= limit).any(2))
    order = np.argsort(exposures)
    for short, long in pairwise(order):
        usable = (np.abs(phasors[short]) > _LEAST_AMPLITUDE * limit) & ~clipped[short] & ~clipped[long]
        ratios = [
            np.median(np.real(longer[use] / shorter[use]))
            for shorter, longer, use in zip(phasors[short], phasors[long], usable, strict=True)
            if use.sum() >= _LEAST_PIXELS
        ]
        if not ratios:
            continue
        seen, stated = float(np.median(ratios)), exposures[long] / exposures[short]
        if not 1 / _TOLERANCE < seen / stated < _TOLERANCE:
            raise SceneError(
                f"exposures: found {exposures[short]:g} and {exposures[long]:g}, {stated:.3g} times as long, but "
                f"frames that are {seen:.3g} times as bright; expected the exposure times that the frames were taken "
                "with, in their order (they are relative)"
            )

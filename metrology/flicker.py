"""Frames without what light that flickers makes of them: one level, and fringes as strong as at that level."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Float32
from metrology.frame_sample import SinusoidFit
from metrology.fringe import FringeCode

# Fringes tell a frame's strength to some tenths of a percent: where brightness scatters by no more, nothing is told.
_UNTOLD = 0.003
# Fringes over the projector: fewer do not average out over the picture, and such frames stay as they are.
LEAST_COUNT = 32


def levelled(levels: Float32, fit: SinusoidFit, use: NDArray[np.bool_], code: FringeCode) -> Float32:
    """Each frame as if its light had been as bright as the others'.

    A projector's lamp that flickers changes the fringes as it changes the level, light in the room the level alone.
    Which of both it is, frames of one count tell, whose fringes are alike but for it.

    Parameters
    ----------
    levels : (frames, n) float32
    fit : SinusoidFit
        Of all of them.
    use : (n,) bool
        Pixels that tell the level, all over the picture.
    code : FringeCode

    Returns
    -------
    (frames, n) float32
    """
    own, fine = levels[:, use].mean(1, dtype=np.float64), np.array(code.counts)[code.count_of[fit.shows]] >= LEAST_COUNT
    if not fine.any():
        return levels
    brighter = np.where(fine, own / own[fine].mean(), 1.0)
    fringes = levels - fit.mean * brighter[:, None].astype(np.float32)
    strength = np.sqrt(np.square(fringes[:, use]).mean(1, dtype=np.float64))
    power = _of_lamp(strength[fine], brighter[fine], code.count_of[fit.shows][fine])
    return np.asarray(fit.mean + fringes / (brighter**power)[:, None].astype(np.float32))


def _of_lamp(strength: Array, brighter: Array, count: NDArray[np.int64]) -> float:
    """By which power of its brightness a frame's fringes grow: 1 where the lamp flickers, 0 where the room's light."""
    level, fringe = np.log(brighter), np.log(np.maximum(strength, 1e-6))
    for k in np.unique(count):
        level[count == k] -= level[count == k].mean()
    return float(np.clip(level @ fringe / (level @ level + len(level) * _UNTOLD**2), 0.0, 1.0))

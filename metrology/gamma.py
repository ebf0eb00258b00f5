"""The projector's gamma, and what it does to fringes.

A projector with gamma g shows ``(½ + ½ cos φ)^g``. Its second harmonic is r = (g − 1)/(g + 2) of the first and in phase
with it; averaged over the pixels it stands out of any noise. The first is 2 g/(g + 1) of the mean: fringes of g > 1
change the light by more than its mean. Three steps per count do not show it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.fringe import FringeCode

# Of the first, within which the second harmonic is believed: gamma 0.14 to 8.
_HARMONIC = (-0.4, 0.7)


def projector_gamma(fringes: NDArray, code: FringeCode) -> float | None:
    """The projector's gamma from the second harmonic of every count with more than three steps.

    Parameters
    ----------
    fringes : (code.fringe_frames, n) ndarray
        Grey levels of pixels without a clipped sample.

    Returns
    -------
    float or None
        None where the steps cannot tell.
    """
    product = square = 0.0
    first = 0
    for steps in code.step_counts:
        levels = fringes[first : first + steps].astype(np.float64)
        delta = code.step_angles[first : first + steps]
        first += steps
        if steps < 4 or not levels.size:
            continue
        phasor = 2 / steps * np.exp(-1j * delta) @ levels
        expected = np.abs(phasor) * np.cos(2 * (np.angle(phasor) + delta[:, None]))
        rest = levels - levels.mean(0) - np.real(phasor * np.exp(1j * delta[:, None]))
        product += float((rest * expected).sum())
        square += float((expected**2).sum())
    if square <= 0:
        return None
    r = float(np.clip(product / square, *_HARMONIC))
    return (1 + 2 * r) / (1 - r)


def fringe_gain(gamma: float | None) -> float:
    """Amplitude of the fringes over their mean; 1 where the gamma is not known."""
    return 1.0 if gamma is None else 2 * gamma / (gamma + 1)

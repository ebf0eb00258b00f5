"""Which exposures a skin needs, from pictures of it under full light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Fringes are to reach this share of the range where a pixel is exposed best.
_FILL = 0.9
# All but so many of the lit pixels are unsaturated in the shortest exposure …
_BRIGHTEST = 0.002
# … and so many have a strong fringe in the longest one.
_DARKEST = 0.9
# Neighbouring exposures differ by no more than this.
_LARGEST_RATIO = 4.0
_LIT = 0.02  # of the range, over the picture of the dark projector


def best_exposures(
    white: NDArray[np.float64], black: NDArray[np.float64], exposure: float, most: int = 3
) -> tuple[float, ...]:
    """Exposure times that cover the skin's brightness.

    Parameters
    ----------
    white, black : (n,) ndarray
        Pixels under full light and none, as shares of the camera's range, not saturated; both cameras' together.
    exposure : float
        With which they were taken.
    most : int
        Exposures at most.

    Returns
    -------
    tuple of float
        Rising; empty where nothing is lit.
    """
    lit = white - black > _LIT
    if not lit.any():
        return ()
    best = exposure * _FILL / white[lit]
    shortest, longest = np.quantile(best, [_BRIGHTEST, _DARKEST])
    ratio = float(longest / shortest)
    count = min(most, 1 + int(np.ceil(np.log(max(ratio, 1.0)) / np.log(_LARGEST_RATIO) - 0.5)))
    if count <= 1:
        return (float(shortest),)
    step = min(ratio ** (1 / (count - 1)), _LARGEST_RATIO)
    return tuple(float(shortest * step**k) for k in range(count))

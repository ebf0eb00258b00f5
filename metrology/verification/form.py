"""Errors of form after VDI/VDE 2634 part 2 and ISO 10360-13: how wide the shell is that holds the points.

The guideline lets three in a thousand points be left out, so the error is the distance between the 0.15 % and the
99.85 % quantile of the distances from the fitted plane or sphere; ISO 10360-13 asks for the shell of 95 % as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

ALL = (0.0015, 0.9985)
MOST = (0.025, 0.975)
_BLOCK = 8  # px, wider than a matching window
_LEAST_BLOCKS = 20
_COVERAGE = 2.0


@dataclass(frozen=True)
class Form:
    """An error of form."""

    n: int
    """Points, those left out included."""
    form_mm: float
    form_u95_mm: float
    """form_mm, form_u95_mm: shell without three in a thousand points; its U95 is that of the two quantiles."""
    form95_mm: float
    """Shell of 95 % of the points."""


def form(distances: ArrayLike, inflation: float = 1.0) -> Form:
    """Error of form of points.

    Parameters
    ----------
    distances : (n,) array
        Signed distances from the fitted surface, mm; 1000 or more.
    inflation : float
        How much a mean's variance is larger than that of independent points (see `inflation`).
    """
    d = np.sort(np.asarray(distances, float))
    n = len(d)
    spread = sum(_quantile_variance(d, p) for p in ALL) * inflation
    return Form(n, _width(d, ALL), _COVERAGE * float(np.sqrt(spread)), _width(d, MOST))


def _width(ordered: NDArray[np.float64], between: tuple[float, float]) -> float:
    low, high = np.quantile(ordered, between)
    return float(high - low)


def _quantile_variance(ordered: NDArray[np.float64], p: float) -> float:
    """Variance of a sample quantile, from the distance of the order statistics one standard deviation to its sides."""
    n = len(ordered)
    ranks = n * p + np.array([-1.0, 1.0]) * np.sqrt(n * p * (1 - p))
    low, high = np.interp(ranks, np.arange(n) + 0.5, ordered)
    return float(((high - low) / 2) ** 2)


def inflation(residuals: NDArray[np.float64]) -> float:
    """How much the variance of a mean exceeds that of independent points: neighbours share matching windows and grain.

    Parameters
    ----------
    residuals : (h, w) ndarray
        Over the pixel grid, NaN where there is none.
    """
    h, w = (side // _BLOCK * _BLOCK for side in residuals.shape)
    tiles = residuals[:h, :w].reshape(h // _BLOCK, _BLOCK, w // _BLOCK, _BLOCK)
    blocks = tiles.swapaxes(1, 2).reshape(-1, _BLOCK**2)
    whole = blocks[np.isfinite(blocks).all(axis=1)]
    if len(whole) < _LEAST_BLOCKS:
        return 1.0
    ratio = float(_BLOCK**2 * whole.mean(axis=1).var(ddof=1) / whole.var())
    return ratio if ratio > 1 + 2 * np.sqrt(2 / len(whole)) else 1.0  # what chance may give is none

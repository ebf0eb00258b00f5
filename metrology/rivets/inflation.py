"""How much more heights and tilts scatter than independent noise of every point would make them.

Two witnesses. Matching averages neighbouring pixels, so the residuals are correlated over some eight pixels: means
over blocks of pixels scatter more than σ/√n. And control places, the same measurement on bare skin, where height and
tilt are zero but for noise of every range and the skin's own waviness. The blocks are many and tell the inflation to a
few per cent; a few controls tell it to no better than a third, so what they show beyond the blocks counts as far as it
is significant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array
from metrology.rivets.fits import Fits

_BLOCK_PX = 12  # wider than the correlation reaches
_FULL = 0.6  # of a block's pixels that must be there
_CLIPPED_MEAN = 0.83  # of a squared normal deviate, the largest tenth clipped


@dataclass(frozen=True)
class Inflation:
    """Variances of heights and slopes against what independent noise would give."""

    height: float
    slope: float


def noise_inflation(fits: Sequence[Fits], controls: Sequence[Fits]) -> Inflation:
    """Inflation for the rivets of one scan.

    Parameters
    ----------
    fits : sequence of Fits
        Of the rivets.
    controls : sequence of Fits
        Of places on bare skin.
    """
    blocks = block_inflation([*fits, *controls])
    heights, slopes = [], []
    for control in controls:
        (h1, a1, b1), head = control.head.tangent(0.0, 0.0)
        (h0, a0, b0), skin = control.skin.tangent(0.0, 0.0)
        covariance = head + skin
        slope = np.array([a1 - a0, b1 - b0])
        heights.append(float((h1 - h0) ** 2 / covariance[0, 0]))
        slopes.append(float(0.5 * slope @ np.linalg.solve(covariance[1:, 1:], slope)))
    return Inflation(_borne_out(heights, len(heights), blocks), _borne_out(slopes, 2 * len(slopes), blocks))


def _borne_out(squares: Sequence[float], freedom: int, blocks: float) -> float:
    """The blocks' inflation, raised to what controls show as far as that is significant.

    The ratio of n squares' mean to its expectation scatters by √(2/n) of itself; an excess of x counts by the share
    x² / (x² + 2 r²/n), the best in the mean square (a shrinkage estimate).
    """
    if not squares:
        return blocks
    # A control on a dent or a scratch is not noise: the largest tenth counts as the next one down.
    values = np.sort(squares)
    values = np.minimum(values, values[int(0.9 * (len(values) - 1))]) / _CLIPPED_MEAN
    ratio = float(values.mean()) / blocks
    excess = max(ratio - 1.0, 0.0)
    return blocks * (1.0 + excess**3 / (excess**2 + 2 * ratio**2 / freedom))


def block_inflation(fits: Sequence[Fits]) -> float:
    """Variance of means over large areas against that of independent residuals, pooled over all heads.

    A block of b pixels a side sees all of the correlation but a share that falls as 1/b (a pixel at its border has its
    neighbours outside), so that two sizes of blocks tell the limit.
    """
    small, large = sum((_block_squares(fit) for fit in fits), np.zeros((2, 2)))
    small, large = (observed / expected if expected > 0 else 1.0 for observed, expected in (small, large))
    # Slots and scratches are small: they raise the small blocks alone, which must not lower the limit.
    return max(1.0, large, 2 * large - small)


def _block_squares(fit: Fits) -> Array:
    """(2, 2) for small and large blocks: squared sums of the residuals over full blocks, and what is expected of them.

    Expected of independent ones; a surface of k coefficients takes as much from the blocks' means as from k of them.
    """
    squares = np.zeros((2, 2))
    p = fit.patch
    for members, surface in ((fit.inner, fit.head), (fit.outer, fit.skin)):
        chosen = np.flatnonzero(members)[surface.weights > 0]
        residual = (p.h[chosen] - surface.height(p.x[chosen], p.y[chosen])) / p.sigma[chosen]
        variance = float(np.mean(residual**2))
        for sums, block_px in zip(squares, (_BLOCK_PX // 2, _BLOCK_PX), strict=True):
            row, column = p.v[chosen] // block_px, p.u[chosen] // block_px
            cell = (row - row.min()) * (column.max() - column.min() + 1) + column - column.min()
            total, count = np.bincount(cell, residual), np.bincount(cell)
            full = count > _FULL * block_px**2
            spared = 1 - len(surface.coefficients) * block_px**2 / len(chosen)
            if spared > 0.5:
                sums += (total[full] ** 2).sum(), count[full].sum() * spared * variance
    return squares

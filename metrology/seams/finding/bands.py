"""Grey-level model of a line's cross-section: bands of constant brightness with blurred borders.

With borders e_1 < … < e_m, levels L_0 … L_m, slopes s on the outer bands and a blurred unit step S (`EdgeResponse`)

``I(x) = L_0 + s_0 (x − e_1)(1 − S_1) + Σ_k (L_k − L_{k−1}) S_k + s_1 (x − e_m) S_m``, ``S_k = S(x − e_k)``.

Borders move in groups, ``e = e⁰ + T q``, so that a chamfer of known width shifts as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrology.arrays import Array
from metrology.seams.blur import EdgeResponse
from metrology.seams.finding.band_kernel import fit


@dataclass(frozen=True)
class BandFit:
    """A fitted cross-section."""

    edges: Array
    """(m,): borders, in the unit of x."""
    shifts: Array
    """(q,): the groups' displacements from where they started."""
    levels: Array
    """(m + 1,): grey levels."""
    covariance: Array
    """(q, q): of the shifts."""
    rms: float
    """Of the residuals, grey levels."""
    cost: float
    """Sum of the residuals' squares."""
    n: int
    """Pixels used."""


def fit_bands(
    x: ArrayLike,
    grey: ArrayLike,
    edges: ArrayLike,
    response: EdgeResponse,
    ties: ArrayLike | None = None,
    slopes: tuple[bool, bool] = (True, True),
    counts: ArrayLike | None = None,
) -> BandFit | None:
    """Least squares (Levenberg–Marquardt) fit of the band model.

    Parameters
    ----------
    x, grey : (n,) array
        Positions across the line, and grey levels.
    edges : (m,) array
        Where the borders are expected, rising.
    ties : (m, q) array, optional
        T; by default every border moves on its own.
    slopes : (bool, bool)
        Whether the first and the last band may slope.
    counts : (n,) array, optional
        How many pixels each entry is the mean of; 1 by default.

    Returns
    -------
    BandFit or None
        None where the samples do not determine the model.
    """
    x = np.ascontiguousarray(x, float)
    grey = np.ascontiguousarray(grey, float)
    edges = np.ascontiguousarray(edges, float)
    tie = np.eye(len(edges)) if ties is None else np.ascontiguousarray(ties, float)
    first = len(edges) + 3
    free = np.ones(first + tie.shape[1], bool)
    free[first - 2 : first] = slopes
    if len(x) < 2 * len(free):
        return None
    table = np.stack([response.values, response.slopes])
    count = np.ones(len(x)) if counts is None else np.ascontiguousarray(counts, float)
    parameters, normal, cost, good = fit(x, grey, count, edges, tie, response.step, table, free)
    moved = edges + tie @ parameters[first:]
    if not good or not np.all(np.diff(moved) > 0):
        return None
    variance = cost / (len(x) - int(free.sum()))
    try:
        covariance = np.linalg.inv(normal)[first:, first:] * variance
    except np.linalg.LinAlgError:
        return None
    return BandFit(
        edges=moved,
        shifts=parameters[first:],
        levels=parameters[: len(edges) + 1],
        covariance=covariance,
        rms=float(np.sqrt(variance)),
        cost=float(cost),
        n=len(x),
    )

"""How many lens terms the data support: nested models, each judged by what it explains and what it costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from metrology.calibration.observations import DeviceName

PINHOLE: tuple[str, ...] = ("fx", "fy", "cx", "cy")
LADDER: tuple[tuple[str, ...], ...] = (
    (),
    ("k1",),
    ("k1", "k2"),
    ("k1", "k2", "p1", "p2"),
    ("k1", "k2", "p1", "p2", "k3"),
)
USUAL = LADDER[3]


@dataclass(frozen=True)
class Evidence:
    """One lens model of one device against the data."""

    device: DeviceName
    terms: tuple[str, ...]
    """Distortion terms of the model."""
    bic: float
    """Bayesian information criterion, relative to the chosen model (0 for that one, positive for the others)."""
    p_value: float | None
    """F-test of the terms that it adds to the model before it: how likely noise alone would explain as much."""
    chosen: bool


def choose_terms(
    device: DeviceName, fit: Callable[[tuple[str, ...]], tuple[float, int]], count: int
) -> tuple[tuple[str, ...], list[Evidence]]:
    """The distortion terms with the lowest BIC, χ²/s² + p ln n, with s² the residual variance of the fullest model.

    Parameters
    ----------
    fit : callable
        Terms to (χ², degrees of freedom) of the whole adjustment; χ² is infinite where the terms cannot be.
    count : int
        n: measured coordinates.
    """
    fits = [fit(terms) for terms in LADDER]
    fullest = [one for one in fits if np.isfinite(one[0])][-1]
    scale = fullest[0] / fullest[1]
    bic = np.array([chi2 / scale + (count - freedom) * np.log(count) for chi2, freedom in fits])
    best = int(np.argmin(bic))
    evidence = []
    for k, terms in enumerate(LADDER):
        p_value = None
        if k and np.isfinite(fits[k - 1][0]) and np.isfinite(fits[k][0]):
            added = fits[k - 1][1] - fits[k][1]
            ratio = (fits[k - 1][0] - fits[k][0]) / added / (fits[k][0] / fits[k][1])
            p_value = float(f_distribution.sf(ratio, added, fits[k][1]))
        evidence.append(Evidence(device, terms, float(bic[k] - bic[best]), p_value, k == best))
    return LADDER[best], evidence

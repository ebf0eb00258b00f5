"""Deviations from certified values: of each feature, their common bias, and how they grow with the value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from metrology.errors import UsageError
from metrology.gage_bias import linearity

_LEAST = 3


@dataclass(frozen=True)
class Deviation:
    """A measured value beside the certified one, mm or what else both are in."""

    of: str
    """Feature and scan."""
    feature: str
    measured: float
    measured_u95: float
    certified: float
    certified_u95: float

    @property
    def value(self) -> float:
        """Measured less certified."""
        return self.measured - self.certified

    @property
    def u95(self) -> float:
        """Expanded uncertainty of the deviation."""
        return float(np.hypot(self.measured_u95, self.certified_u95))


@dataclass(frozen=True)
class Trend:
    """A figure of many deviations with its expanded uncertainty; n features."""

    value: float
    u95: float
    n: int


def common_bias(deviations: list[Deviation]) -> Trend:
    """Mean deviation over the features.

    The scatter between features, about their line over the certified value where there is one, tells how well the mean
    is known; certified values may all err alike, which it does not tell, so their uncertainty counts in full.
    """
    means, certified = _by_feature(deviations)
    n = len(means)
    if n < _LEAST:
        raise UsageError(f"bias: found {n} features, expected {_LEAST} or more")
    unknowns, sigma = 1, means.std(ddof=1)
    if n > _LEAST and np.ptp(certified[:, 0]) > 0:
        unknowns, sigma = 2, linearity(certified[:, 0], means).sigma
    half = float(stats.t.ppf(0.975, n - unknowns) * sigma / np.sqrt(n))
    return Trend(float(means.mean()), float(np.hypot(half, certified[:, 1].mean())), n)


def growth(deviations: list[Deviation]) -> Trend:
    """Slope of the deviations over the certified values (linearity), mm per mm."""
    means, certified = _by_feature(deviations)
    line = linearity(certified[:, 0], means)
    # Certified values that err alike by their U95 over the whole range tilt the line by no more than this.
    tilt = certified[:, 1].mean() / np.ptp(certified[:, 0])
    return Trend(line.slope, float(np.hypot(line.slope_u95, tilt)), len(means))


def _by_feature(deviations: list[Deviation]) -> tuple[np.ndarray, np.ndarray]:
    """(n,) mean deviation of each feature; (n, 2) its certified value and U95."""
    features: dict[str, list[Deviation]] = {}
    for one in deviations:
        features.setdefault(one.feature, []).append(one)
    means = np.array([np.mean([one.value for one in of]) for of in features.values()])
    return means, np.array([(of[0].certified, of[0].certified_u95) for of in features.values()])

"""Bias and linearity of a gage: measured parts whose values are known otherwise.

AIAG, Measurement Systems Analysis, 4th edition (2010), chapter III, section B: the bias of each part against zero by
Student's t, and the straight line of all deviations over the reference values,

    y_ij = a x_i + b + ε_ij,    y deviation, x reference value.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from metrology.errors import UsageError


@dataclass(frozen=True)
class Bias:
    """Mean deviation of repeated values from a reference value."""

    n: int
    bias: float
    sigma: float
    """bias, sigma: mean deviation, and standard deviation of the values."""
    t: float
    p_value: float
    """t, p_value: against zero, with n − 1 degrees of freedom; p is NaN without any scatter."""
    u95: float
    """Half the 95 % interval of the bias, the reference value's own uncertainty included."""

    @property
    def is_zero(self) -> bool:
        """Whether zero lies within the interval: the bias is not significant."""
        return abs(self.bias) <= self.u95


def bias(values: ArrayLike, reference: float, reference_u95: float = 0.0) -> Bias:
    """The bias of repeated values of one part.

    Parameters
    ----------
    values : (n,) array
        At least 2.
    reference, reference_u95 : float
        What the part is, and its expanded uncertainty.
    """
    deviations = np.asarray(values, float) - reference
    n = len(deviations)
    if n < 2 or not np.isfinite(deviations).all():
        raise UsageError(f"bias: found {n} values, expected 2 or more, all of them measured")
    mean, sigma = float(deviations.mean()), float(deviations.std(ddof=1))
    error = sigma / math.sqrt(n)
    t = mean / error if error > 0 else math.copysign(math.inf, mean) if mean else 0.0
    p = float(2 * stats.t.sf(abs(t), n - 1)) if error > 0 else math.nan
    return Bias(n, mean, sigma, t, p, math.hypot(float(stats.t.ppf(0.975, n - 1)) * error, reference_u95))


@dataclass(frozen=True)
class Linearity:
    """The straight line of deviations over reference values."""

    n: int
    """Deviations."""
    slope: float
    intercept: float
    slope_u95: float
    intercept_u95: float
    """slope_u95, intercept_u95: half their 95 % intervals."""
    sigma: float
    """Standard deviation of the residuals."""
    r_squared: float
    slope_t: float
    intercept_t: float
    slope_p: float
    intercept_p: float

    @property
    def is_linear(self) -> bool:
        """Whether neither slope nor intercept is significant."""
        return abs(self.slope) <= self.slope_u95 and abs(self.intercept) <= self.intercept_u95


def linearity(reference: ArrayLike, deviation: ArrayLike) -> Linearity:
    """Fit the line.

    Parameters
    ----------
    reference, deviation : (n,) arrays
        One of each for every single value; at least 3, of at least 2 different reference values.
    """
    x, y = np.asarray(reference, float), np.asarray(deviation, float)
    if len(x) < 3 or np.ptp(x) == 0:
        found = f"{len(x)} values of {len(np.unique(x))} reference values"
        raise UsageError(f"linearity: found {found}, expected 3 or more of at least 2")
    n, mean = len(x), x.mean()
    spread = float(((x - mean) ** 2).sum())
    slope = float(((x - mean) * (y - y.mean())).sum() / spread)
    intercept = float(y.mean() - slope * mean)
    residual = float(((y - slope * x - intercept) ** 2).sum())
    total = float(((y - y.mean()) ** 2).sum())
    sigma = math.sqrt(residual / (n - 2))
    errors = sigma / math.sqrt(spread), sigma * math.sqrt(1 / n + mean**2 / spread)
    times = float(stats.t.ppf(0.975, n - 2))
    t = [value / error if error > 0 else math.nan for value, error in zip((slope, intercept), errors, strict=True)]
    p = [float(2 * stats.t.sf(abs(one), n - 2)) for one in t]
    return Linearity(
        n, slope, intercept, times * errors[0], times * errors[1], sigma,
        1 - residual / total if total > 0 else math.nan, t[0], t[1], p[0], p[1],
    )  # fmt: skip

"""Is the process steady, and can it hold its limits? Control charts, run rules, capability, Pareto.

Sources
-------
NIST/SEMATECH e-Handbook of Statistical Methods, 6.1.6 (capability), 6.3.2 (run rules), 6.3.2.2 (individuals charts).
L. S. Nelson, "The Shewhart control chart: tests for special causes", Journal of Quality Technology 16 (1984) 237-239.
A. F. Bissell, "How reliable is your capability index?", Applied Statistics 39 (1990) 331-340.
D. C. Montgomery, Introduction to Statistical Quality Control, chapter 8.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from metrology.arrays import Array
from metrology.errors import UsageError

# Mean of the range of two independent standard normal values, and what the range's 3σ limit is as a multiple of it.
_D2 = 2 / np.sqrt(np.pi)
_D4 = 1 + 3 * np.sqrt(1 - 2 / np.pi) * np.sqrt(2) / _D2
# Mean moving range of two uses the data as well as 0.605 (n − 1) independent values would (its asymptotic efficiency).
_MOVING_RANGE_EFFICIENCY = 0.605


@dataclass(frozen=True)
class ControlChart:
    """An individuals chart with its moving-range chart.

    Attributes
    ----------
    lower, upper : float
        centre ∓ 3 σ.
    range_centre, range_upper : float
        Mean moving range and its upper limit D4 · MR, D4 = 3.267.
    """

    values: Array
    """(n,): in the order of time; NaN where there is none."""
    moving_range: Array
    """(n,): |x_i − x_{i−1}| over the values that are there; NaN at the first."""
    centre: float
    sigma: float
    """centre, sigma: mean, and σ = mean moving range / d2 with d2 = 2/√π. NaN with fewer than two values."""
    range_centre: float

    @property
    def lower(self) -> float:
        """Lower control limit."""
        return self.centre - 3 * self.sigma

    @property
    def upper(self) -> float:
        """Upper control limit."""
        return self.centre + 3 * self.sigma

    @property
    def range_upper(self) -> float:
        """Upper control limit of the moving range; the lower one is 0."""
        return float(_D4 * self.range_centre)


def individuals_chart(values: ArrayLike, baseline: int | None = None) -> ControlChart:
    """Individuals and moving-range chart.

    Parameters
    ----------
    values : (n,) array
        In the order of time.
    baseline : int, optional
        Limits from the first `baseline` values only; from all where it is not given.
    """
    series: Array = np.asarray(values, float)
    present = np.flatnonzero(np.isfinite(series))
    moving = np.full(series.shape, np.nan)
    moving[present[1:]] = np.abs(np.diff(series[present]))
    used = present if baseline is None else present[present < baseline]
    ranges = moving[used[1:]]
    mean_range = float(ranges.mean()) if ranges.size else np.nan
    centre = float(series[used].mean()) if used.size else np.nan
    return ControlChart(series, moving, centre, float(mean_range / _D2), mean_range)


@dataclass(frozen=True)
class RunRule:
    """A pattern that chance seldom makes: its name, its meaning and a function that marks the points completing it.

    The function takes (n,) values in units of σ from the centre and returns (n,) bool.
    """

    name: str
    meaning: str
    test: Callable[[Array], NDArray[np.bool_]]


def _windows(z: Array, length: int, holds: Callable[[Array], NDArray[np.bool_]]) -> NDArray[np.bool_]:
    """Marks the last point of every window of `length` points for which `holds` (m, length) → (m,) is true."""
    marked = np.zeros(len(z), bool)
    if len(z) >= length:
        marked[length - 1 :] = holds(np.lib.stride_tricks.sliding_window_view(z, length))
    return marked


def _same_side(z: Array, needed: int, of: int, beyond: float) -> NDArray[np.bool_]:
    """`needed` of `of` points beyond ±`beyond` σ on one side, the last point among them."""

    def holds(window: Array) -> NDArray[np.bool_]:
        above, below = window > beyond, window < -beyond
        return np.asarray(
            ((above.sum(1) >= needed) & above[:, -1]) | ((below.sum(1) >= needed) & below[:, -1]), dtype=bool
        )

    return _windows(z, of, holds)


def _monotone(window: Array) -> NDArray[np.bool_]:
    steps = np.diff(window, axis=1)
    return np.asarray((steps > 0).all(1) | (steps < 0).all(1))


def _alternating(window: Array) -> NDArray[np.bool_]:
    steps = np.diff(window, axis=1)
    return np.asarray((steps[:, 1:] * steps[:, :-1] < 0).all(1))


NELSON_RULES: tuple[RunRule, ...] = (
    RunRule("1", "one point beyond 3σ", lambda z: np.abs(z) > 3),
    RunRule("2", "nine points in a row on one side of the centre", lambda z: _same_side(z, 9, 9, 0)),
    RunRule("3", "six points in a row rising or falling", lambda z: _windows(z, 6, _monotone)),
    RunRule("4", "fourteen points in a row going up and down in turn", lambda z: _windows(z, 14, _alternating)),
    RunRule("5", "two of three points beyond 2σ on one side", lambda z: _same_side(z, 2, 3, 2)),
    RunRule("6", "four of five points beyond 1σ on one side", lambda z: _same_side(z, 4, 5, 1)),
    RunRule(
        "7", "fifteen points in a row within 1σ", lambda z: _windows(z, 15, lambda w: np.asarray((abs(w) < 1).all(1)))
    ),
    RunRule(
        "8",
        "eight points in a row beyond 1σ on either side",
        lambda z: _windows(z, 8, lambda w: np.asarray((abs(w) > 1).all(1))),
    ),
)
"""Nelson's eight tests."""

WESTERN_ELECTRIC_RULES: tuple[RunRule, ...] = (
    NELSON_RULES[0],
    NELSON_RULES[4],
    NELSON_RULES[5],
    RunRule("WE 4", "eight points in a row on one side of the centre", lambda z: _same_side(z, 8, 8, 0)),
)
"""The Western Electric rules (NIST 6.3.2): in control they alarm once in 91.75 points instead of once in 370."""


def rule_violations(chart: ControlChart, rules: tuple[RunRule, ...] = NELSON_RULES) -> dict[str, NDArray[np.intp]]:
    """Which points complete a pattern, by rule name; rules that no point breaks are left out.

    Missing values are passed over; without any spread nothing is marked.
    """
    present = np.flatnonzero(np.isfinite(chart.values))
    if not (np.isfinite(chart.sigma) and chart.sigma > 0):
        return {}
    z = (chart.values[present] - chart.centre) / chart.sigma
    found = {rule.name: present[np.flatnonzero(rule.test(z))] for rule in rules}
    return {name: points for name, points in found.items() if points.size}


@dataclass(frozen=True)
class Index:
    """A capability index with its confidence interval; None where the limits do not allow it."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Capability:
    """How a process stands against its limits."""

    n: int
    mean: float
    sigma_overall: float
    sigma_within: float
    """Short-term: from moving ranges in the order of time, or pooled within subgroups; NaN where neither is known."""
    cp: Index | None
    cpk: Index | None
    """cp, cpk: with the short-term σ (within)."""
    pp: Index | None
    ppk: Index | None
    """pp, ppk: with the overall σ. Cp and Pp need both limits."""
    outside_fraction: float
    """Expected share outside the limits for a normal distribution with the overall σ."""


def capability(
    values: ArrayLike, lower: float | None, upper: float | None, confidence: float = 0.95, ordered: bool = True
) -> Capability | None:
    """Cp, Cpk, Pp and Ppk of values (n,) with two-sided confidence intervals; None with fewer than two values.

    Parameters
    ----------
    lower, upper : float or None
        Tolerance limits; at least one.
    ordered : bool
        Whether the values are in the order of time, so that moving ranges mean something.
    """
    sample: Array = np.asarray(values, float)
    sample = sample[np.isfinite(sample)]
    if len(sample) < 2:
        return None
    sigma_within = individuals_chart(sample).sigma if ordered else np.nan
    return capability_from_moments(
        len(sample), float(sample.mean()), float(sample.std(ddof=1)), lower, upper, confidence, sigma_within
    )


def capability_from_moments(
    n: int,
    mean: float,
    sigma_overall: float,
    lower: float | None,
    upper: float | None,
    confidence: float = 0.95,
    sigma_within: float = np.nan,
    freedom_within: float | None = None,
) -> Capability:
    """The same from a sample's size, mean and standard deviations.

    Parameters
    ----------
    freedom_within : float, optional
        Degrees of freedom of `sigma_within`; by default those of moving ranges of n values.
    """
    if lower is None and upper is None:
        raise UsageError("capability: found neither a lower nor an upper limit, expected at least one")
    if n < 2:
        raise UsageError(f"capability: found {n} values, expected at least two")
    if freedom_within is None:
        freedom_within = _MOVING_RANGE_EFFICIENCY * (n - 1)

    def both(sigma: float, freedom: float) -> tuple[Index | None, Index | None]:
        if not (np.isfinite(sigma) and sigma > 0):
            return None, None
        return (
            _potential(lower, upper, sigma, freedom, confidence),
            _actual(mean, lower, upper, sigma, n, freedom, confidence),
        )

    cp, cpk = both(sigma_within, freedom_within)
    pp, ppk = both(sigma_overall, n - 1)
    if sigma_overall > 0:
        below = stats.norm.cdf(lower, mean, sigma_overall) if lower is not None else 0.0
        above = stats.norm.sf(upper, mean, sigma_overall) if upper is not None else 0.0
    else:
        below = float(lower is not None and mean < lower)
        above = float(upper is not None and mean > upper)
    return Capability(n, mean, sigma_overall, sigma_within, cp, cpk, pp, ppk, float(below + above))


def pooled_sigma(variances: ArrayLike, sizes: ArrayLike) -> tuple[float, float]:
    """Standard deviation within subgroups, and its degrees of freedom Σ(nᵢ − 1); NaN, 0 where no subgroup has two.

    Parameters
    ----------
    variances : (k,) array
        Sample variance of each subgroup; ignored where it has fewer than two values.
    sizes : (k,) array
    """
    variance, freedom = np.asarray(variances, float), np.asarray(sizes, float) - 1
    used = (freedom > 0) & np.isfinite(variance)
    total = float(freedom[used].sum())
    if total == 0:
        return float("nan"), 0.0
    return float(np.sqrt((variance[used] * freedom[used]).sum() / total)), total


def _potential(
    lower: float | None, upper: float | None, sigma: float, freedom: float, confidence: float
) -> Index | None:
    """(USL − LSL) / 6σ; ν s²/σ² is χ² distributed, which gives the interval (NIST 6.1.6)."""
    if lower is None or upper is None:
        return None
    value = (upper - lower) / (6 * sigma)
    low, high = np.sqrt(stats.chi2.ppf([(1 - confidence) / 2, (1 + confidence) / 2], freedom) / freedom)
    return Index(float(value), float(value * low), float(value * high))


def _actual(
    mean: float,
    lower: float | None,
    upper: float | None,
    sigma: float,
    n: int,
    freedom: float,
    confidence: float,
) -> Index:
    """Distance of the mean to the nearer limit in 3σ; interval by Bissell: k ± z √(1/(9n) + k²/(2ν))."""
    sides = [upper - mean] if upper is not None else []
    sides += [mean - lower] if lower is not None else []
    value = min(sides) / (3 * sigma)
    half = stats.norm.ppf((1 + confidence) / 2) * np.sqrt(1 / (9 * n) + value**2 / (2 * freedom))
    return Index(float(value), float(value - half), float(value + half))


@dataclass(frozen=True)
class ParetoBar:
    """A category, its count, and the share of all counts up to and including it."""

    name: str
    count: int
    cumulative: float


def pareto(counts: Mapping[str, int], most: int = 20) -> list[ParetoBar]:
    """Categories from frequent to rare (equal ones by name); those beyond `most` are summed up as "others"."""
    ranked = sorted(
        ((name, count) for name, count in counts.items() if count > 0), key=lambda item: (-item[1], item[0])
    )
    shown = ranked[:most]
    if len(ranked) > most:
        shown.append((f"{len(ranked) - most} others", sum(count for _, count in ranked[most:])))
    total = sum(count for _, count in shown)
    running = np.cumsum([count for _, count in shown])
    return [ParetoBar(name, count, float(so_far / total)) for (name, count), so_far in zip(shown, running, strict=True)]

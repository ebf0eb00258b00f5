"""Crossed gage repeatability and reproducibility: how much of what is seen comes from the measuring.

Every part is measured by every operator in several trials. Two-way analysis of variance with random effects:

    y_pot = μ + P_p + O_o + (PO)_po + ε_pot,    p < n, o < k, t < r

Sources
-------
AIAG, Measurement Systems Analysis, 4th edition (2010), chapter III and appendix A (ANOVA method; σ without the 5.15).
D. C. Montgomery, G. C. Runger, "Gauge capability and designed experiments", Quality Engineering 6 (1993) 115 and 289.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from metrology.errors import UsageError

_SPREAD = 6.0  # a process is said to fill ± 3 σ
_DISTINCT = 1.41  # ndc: how many 97 % confidence intervals of the measuring fit into the parts' spread


@dataclass(frozen=True)
class Effect:
    """One line of the analysis of variance; F and p are None for the error."""

    name: str
    freedom: int
    sum_of_squares: float
    mean_square: float
    f: float | None = None
    p_value: float | None = None


@dataclass(frozen=True)
class GageStudy:
    """Standard deviations of a crossed study, in the unit of the values."""

    effects: tuple[Effect, ...]
    """parts, operators, parts × operators, repeatability."""
    pooled: bool
    """Whether the interaction was not significant and went into the repeatability."""
    repeatability: float
    """EV, the same operator and part."""
    operators: float
    interaction: float
    """operators, interaction: between operators, and between operators differently for each part; together the
    reproducibility."""
    parts: float
    """PV, between parts."""

    @property
    def reproducibility(self) -> float:
        """AV with the interaction."""
        return math.hypot(self.operators, self.interaction)

    @property
    def grr(self) -> float:
        """Repeatability and reproducibility."""
        return math.hypot(self.repeatability, self.reproducibility)

    @property
    def total(self) -> float:
        """TV: gage and parts."""
        return math.hypot(self.grr, self.parts)

    @property
    def percent_of_variation(self) -> float:
        """%GRR of the total variation."""
        return 100 * self.grr / self.total if self.total > 0 else math.nan

    def percent_of_tolerance(self, tolerance: float) -> float:
        """%GRR of a tolerance (upper less lower limit): 100 · 6 σ_GRR / tolerance."""
        if not tolerance > 0:
            raise UsageError(f"tolerance: found {tolerance:g}, expected more than 0")
        return 100 * _SPREAD * self.grr / tolerance

    @property
    def distinct_categories(self) -> int | None:
        """ndc = 1.41 PV / GRR, rounded down, at least 1; None where the gage shows no spread at all."""
        return max(1, int(_DISTINCT * self.parts / self.grr)) if self.grr > 0 else None


def gage_study(values: ArrayLike, significance: float = 0.05) -> GageStudy:
    """Analyse a crossed study.

    Parameters
    ----------
    values : (parts, operators, trials) array
        Complete, at least 2 of each.
    significance : float
        An interaction with a larger p-value is pooled with the repeatability (AIAG: 0.05).
    """
    y = np.asarray(values, float)
    if y.ndim != 3 or min(y.shape) < 2:
        raise UsageError(f"gage study: found values of shape {y.shape}, expected (parts, operators, trials), 2 or more")
    if not np.isfinite(y).all():
        raise UsageError(f"gage study: found {int((~np.isfinite(y)).sum())} missing values, expected a complete table")
    n, k, r = y.shape
    mean, by_part, by_operator, by_cell = y.mean(), y.mean((1, 2)), y.mean((0, 2)), y.mean(2)
    ss_part = k * r * float(((by_part - mean) ** 2).sum())
    ss_operator = n * r * float(((by_operator - mean) ** 2).sum())
    ss_interaction = r * float(((by_cell - by_part[:, None] - by_operator + mean) ** 2).sum())
    ss_error = float(((y - by_cell[..., None]) ** 2).sum())
    df_interaction, df_error = (n - 1) * (k - 1), n * k * (r - 1)
    error = Effect("repeatability", df_error, ss_error, ss_error / df_error)
    interaction = _effect("parts × operators", df_interaction, ss_interaction, error)
    pooled = interaction.p_value is None or interaction.p_value > significance
    if pooled:
        freedom, sum_of_squares = df_error + df_interaction, ss_error + ss_interaction
        error = Effect("repeatability", freedom, sum_of_squares, sum_of_squares / freedom)
    against = error if pooled else interaction
    part = _effect("parts", n - 1, ss_part, against)
    operator = _effect("operators", k - 1, ss_operator, against)
    return GageStudy(
        effects=(part, operator, interaction, error),
        pooled=pooled,
        repeatability=math.sqrt(error.mean_square),
        operators=_component(operator, against, n * r),
        interaction=0.0 if pooled else _component(interaction, error, r),
        parts=_component(part, against, k * r),
    )


def _effect(name: str, freedom: int, sum_of_squares: float, against: Effect) -> Effect:
    """An effect tested against another line's mean square."""
    mean_square = sum_of_squares / freedom
    if against.mean_square == 0:
        return Effect(name, freedom, sum_of_squares, mean_square)
    f = mean_square / against.mean_square
    return Effect(name, freedom, sum_of_squares, mean_square, f, float(stats.f.sf(f, freedom, against.freedom)))


def _component(effect: Effect, against: Effect, times: int) -> float:
    """σ of an effect whose mean square expects σ²_against + times · σ²; negative estimates count as none."""
    return math.sqrt(max(effect.mean_square - against.mean_square, 0.0) / times)

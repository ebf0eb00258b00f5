"""Crossed gage R&R against the worked example of AIAG's manual, and against variances that are known."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from metrology.errors import UsageError
from metrology.gage import gage_study

# AIAG, Measurement Systems Analysis, 4th edition, figure III-B 6a: ten parts, three appraisers, three trials.
AIAG = np.array([
    [[.29, -.56, 1.34, .47, -.80, .02, .59, -.31, 2.26, -1.36],
     [.41, -.68, 1.17, .50, -.92, -.11, .75, -.20, 1.99, -1.25],
     [.64, -.58, 1.27, .64, -.84, -.21, .66, -.17, 2.01, -1.31]],
    [[.08, -.47, 1.19, .01, -.56, -.20, .47, -.63, 1.80, -1.68],
     [.25, -1.22, .94, 1.03, -1.20, .22, .55, .08, 2.12, -1.62],
     [.07, -.68, 1.34, .20, -1.28, .06, .83, -.34, 2.19, -1.50]],
    [[.04, -1.38, .88, .14, -1.46, -.29, .02, -.46, 1.77, -1.49],
     [-.11, -1.13, 1.09, .20, -1.07, -.67, .01, -.56, 1.45, -1.77],
     [-.15, -.96, .67, .11, -1.45, -.49, .21, -.49, 1.87, -2.16]],
]).transpose(2, 0, 1)  # fmt: skip


def test_the_manuals_example() -> None:
    study = gage_study(AIAG)
    parts, operators, interaction, error = study.effects
    # Table A 3: sums of squares and F of the full model.
    assert parts.sum_of_squares == pytest.approx(88.3619, abs=2e-4)
    assert operators.sum_of_squares == pytest.approx(3.1673, abs=2e-4)
    assert interaction.sum_of_squares == pytest.approx(0.3590, abs=2e-4)
    assert interaction.f == pytest.approx(0.434, abs=1e-3)
    assert error.sum_of_squares - interaction.sum_of_squares == pytest.approx(2.7589, abs=2e-4)
    assert (parts.freedom, operators.freedom, interaction.freedom, error.freedom) == (9, 2, 18, 78)
    # Table A 4: the interaction is not significant and pooled.
    assert study.pooled
    assert study.repeatability == pytest.approx(0.199933, abs=1e-5)
    assert study.operators == pytest.approx(0.226838, abs=1e-5)
    assert study.interaction == 0
    assert study.grr == pytest.approx(0.302373, abs=1e-5)
    assert study.parts == pytest.approx(1.042327, abs=1e-5)
    assert study.percent_of_variation == pytest.approx(27.9, abs=0.05)
    assert study.distinct_categories == 4


@pytest.mark.parametrize("shape", [(5, 2, 3), (10, 3, 3), (3, 4, 2)])
def test_the_analysis_of_variance_is_that_of_statsmodels(shape: tuple[int, int, int]) -> None:
    formula, anova = pytest.importorskip("statsmodels.formula.api"), pytest.importorskip("statsmodels.stats.anova")
    rng = np.random.default_rng(sum(shape))
    n, k, _ = shape
    values = rng.normal(0, 1, (n, 1, 1)) + rng.normal(0, 1, (n, k, 1)) + rng.normal(0, 0.1, shape)
    part, operator, _ = (index.ravel() for index in np.indices(shape))
    frame = pd.DataFrame({"y": values.ravel(), "part": part.astype(str), "operator": operator.astype(str)})
    theirs = anova.anova_lm(formula.ols("y ~ C(part) * C(operator)", frame).fit())
    study = gage_study(values)
    assert not study.pooled
    for ours, (_, row) in zip(study.effects, theirs.iterrows(), strict=True):
        assert ours.freedom == row["df"]
        assert ours.sum_of_squares == pytest.approx(row["sum_sq"], rel=1e-9)
    # Operators and parts are random: theirs are tested against the error, ours against the interaction.
    assert study.effects[2].f == pytest.approx(theirs["F"].iloc[2], rel=1e-9)
    assert study.effects[2].p_value == pytest.approx(theirs["PR(>F)"].iloc[2], rel=1e-6)


def test_known_variances_are_found_with_an_interaction() -> None:
    rng = np.random.default_rng(3)
    n, k, r = 200, 60, 4
    values = (
        3.0 + rng.normal(0, 2.0, (n, 1, 1)) + rng.normal(0, 0.5, (1, k, 1))
        + rng.normal(0, 0.3, (n, k, 1)) + rng.normal(0, 0.2, (n, k, r))
    )  # fmt: skip
    study = gage_study(values)
    assert not study.pooled
    assert study.repeatability == pytest.approx(0.2, rel=0.02)
    assert study.interaction == pytest.approx(0.3, rel=0.02)
    assert study.operators == pytest.approx(0.5, rel=0.2)
    assert study.parts == pytest.approx(2.0, rel=0.1)
    assert study.total == pytest.approx(np.sqrt(4 + 0.25 + 0.09 + 0.04), rel=0.1)


def test_unit_and_origin_do_not_matter() -> None:
    plain, moved = gage_study(AIAG), gage_study(25.4 * AIAG - 7)
    assert moved.grr == pytest.approx(25.4 * plain.grr)
    assert moved.percent_of_variation == pytest.approx(plain.percent_of_variation)
    assert moved.percent_of_tolerance(25.4) == pytest.approx(plain.percent_of_tolerance(1.0))


def test_no_spread_at_all_is_no_error() -> None:
    study = gage_study(np.arange(3.0)[:, None, None] * np.ones((3, 2, 2)))
    assert study.grr == 0
    assert study.distinct_categories is None
    assert study.parts == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("values", "words"),
    [(np.ones((3, 1, 2)), r"shape \(3, 1, 2\)"), (np.full((2, 2, 2), np.nan), "8 missing"), ([1.0, 2.0], "shape")],
)
def test_incomplete_studies_are_refused(values: object, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        gage_study(values)  # type: ignore[arg-type]


def test_a_tolerance_is_positive() -> None:
    with pytest.raises(UsageError, match="found 0"):
        gage_study(AIAG).percent_of_tolerance(0)

"""Bias and linearity against the worked examples of AIAG's manual."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from metrology.errors import UsageError
from metrology.gage_bias import bias, linearity

# AIAG, Measurement Systems Analysis, 4th edition, table III-B 1: fifteen values of a part of 6.00.
ONE_PART = [5.8, 5.7, 5.9, 5.9, 6.0, 6.1, 6.0, 6.1, 6.4, 6.3, 6.0, 6.1, 6.2, 5.6, 6.0]
# Table III-B 4: five parts, twelve values each.
REFERENCE = np.array([2.0, 4.0, 6.0, 8.0, 10.0])
FIVE_PARTS = np.array([
    [2.7, 2.5, 2.4, 2.5, 2.7, 2.3, 2.5, 2.5, 2.4, 2.4, 2.6, 2.4],
    [5.1, 3.9, 4.2, 5.0, 3.8, 3.9, 3.9, 3.9, 3.9, 4.0, 4.1, 3.8],
    [5.8, 5.7, 5.9, 5.9, 6.0, 6.1, 6.0, 6.1, 6.4, 6.3, 6.0, 6.1],
    [7.6, 7.7, 7.8, 7.7, 7.8, 7.8, 7.8, 7.7, 7.8, 7.5, 7.6, 7.7],
    [9.1, 9.3, 9.5, 9.3, 9.4, 9.5, 9.5, 9.5, 9.6, 9.2, 9.3, 9.4],
])  # fmt: skip


def test_the_manuals_bias() -> None:
    found = bias(ONE_PART, 6.0)
    assert found.bias == pytest.approx(0.0067, abs=5e-5)
    assert found.is_zero
    theirs = stats.ttest_1samp(ONE_PART, 6.0)
    assert (found.t, found.p_value) == (pytest.approx(theirs.statistic), pytest.approx(theirs.pvalue))
    assert found.bias + found.u95 == pytest.approx(theirs.confidence_interval().high - 6.0 + 0)


def test_the_manuals_linearity() -> None:
    deviation = FIVE_PARTS - REFERENCE[:, None]
    assert deviation.mean(axis=1) == pytest.approx([0.491667, 0.125, 0.025, -0.291667, -0.616667], abs=1e-6)
    found = linearity(np.repeat(REFERENCE, 12), deviation.ravel())
    assert found.slope == pytest.approx(-0.131667, abs=1e-6)
    assert found.intercept == pytest.approx(0.736667, abs=1e-6)
    assert found.sigma == pytest.approx(0.23954, abs=1e-5)
    assert found.r_squared == pytest.approx(0.714, abs=5e-4)
    assert found.slope_t == pytest.approx(-12.043, abs=2e-3)
    assert found.intercept_t == pytest.approx(10.158, abs=2e-3)
    assert not found.is_linear


def test_the_references_own_uncertainty_widens_the_interval() -> None:
    values = np.array([1.01, 1.012, 1.008])
    assert not bias(values, 1.0).is_zero
    assert bias(values, 1.0, 0.02).is_zero
    assert bias([2.0, 2.0], 2.0).is_zero
    assert not bias([2.0, 2.0], 1.9).is_zero


def test_too_few_values_are_refused() -> None:
    with pytest.raises(UsageError, match="found 1 values"):
        bias([1.0], 1.0)
    with pytest.raises(UsageError, match="of 1 reference values"):
        linearity([1.0, 1.0, 1.0], [0.1, 0.2, 0.3])

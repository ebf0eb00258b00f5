"""Control charts and capability against published examples and published run lengths."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from metrology.errors import UsageError
from metrology.statistics import (
    NELSON_RULES,
    WESTERN_ELECTRIC_RULES,
    ControlChart,
    capability,
    capability_from_moments,
    individuals_chart,
    pareto,
    pooled_sigma,
    rule_violations,
)

# NIST/SEMATECH e-Handbook 6.3.2.2, flow rate of ten batches.
FLOW_RATE = [49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1]


def unit_chart(z: object) -> ControlChart:
    """A chart whose σ and centre are known: 1 and 0."""
    values = np.asarray(z, float)
    return ControlChart(values, np.full(values.shape, np.nan), 0.0, 1.0, 1.0)


def test_individuals_chart_of_the_nist_handbook() -> None:
    chart = individuals_chart(FLOW_RATE)
    assert chart.centre == pytest.approx(50.81)
    assert chart.range_centre == pytest.approx(1.8778, abs=5e-5)
    # NIST rounds d2 to 1.128.
    assert chart.upper == pytest.approx(55.8041, abs=2e-3)
    assert chart.lower == pytest.approx(45.8159, abs=2e-3)
    assert chart.range_upper / chart.range_centre == pytest.approx(3.267, abs=1e-3)
    assert rule_violations(chart) == {}


def test_missing_values_neither_break_nor_enter_the_chart() -> None:
    with_gaps = np.insert(np.array(FLOW_RATE), [0, 3, 3, 10], np.nan)
    full, gappy = individuals_chart(FLOW_RATE), individuals_chart(with_gaps)
    assert (gappy.centre, gappy.sigma) == (full.centre, full.sigma)
    np.testing.assert_allclose(gappy.moving_range[np.isfinite(gappy.moving_range)], full.moving_range[1:])


def test_limits_from_a_baseline_show_a_later_shift() -> None:
    rng = np.random.default_rng(3)
    values = np.r_[rng.normal(0, 1, 40), rng.normal(4, 1, 10)]
    violations = rule_violations(individuals_chart(values, baseline=40))
    assert "2" in violations
    assert violations["1"].min() >= 40


@pytest.mark.parametrize("values", [[], [1.0], [np.nan, np.nan], [2.0, 2.0, 2.0]])
def test_too_little_to_chart_marks_nothing(values: list[float]) -> None:
    assert rule_violations(individuals_chart(values)) == {}


@pytest.mark.parametrize(
    ("rule", "pattern", "marked"),
    [
        ("1", [0, 3.1, -3.1, 2.9], [1, 2]),
        ("2", [-0.1, *[0.1] * 9, -0.1], [9]),
        ("3", [0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.45], [5]),
        ("4", [0.5, -0.5] * 7, [13]),
        ("5", [2.1, 0, 2.1], [2]),
        ("6", [1.1, 1.1, 0, 1.1, 1.1], [4]),
        ("7", [0.5, 0.4, -0.5] * 5, [14]),
        ("8", [1.5, -1.5, -1.2, 1.2, 1.3, -1.4, 1.5, 1.6], [7]),
    ],
)
def test_each_rule_marks_its_own_pattern_and_its_mirror_image(
    rule: str, pattern: list[float], marked: list[int]
) -> None:
    for sign in (1, -1):
        found = rule_violations(unit_chart(sign * np.array(pattern)))
        assert found[rule].tolist() == marked


def test_one_value_less_completes_no_pattern() -> None:
    assert "2" not in rule_violations(unit_chart([0.1] * 8))
    assert "5" not in rule_violations(unit_chart([2.1, 0, -2.1]))
    assert "6" not in rule_violations(unit_chart([1.1, 1.1, 0, -1.1, 1.1]))


@pytest.mark.parametrize(
    ("rules", "published"),
    [(NELSON_RULES[:1], 370.4), (WESTERN_ELECTRIC_RULES, 91.75)],
    ids=["3σ alone", "Western Electric"],
)
def test_average_run_length_in_control_is_as_published(rules: tuple, published: float) -> None:
    """Champ and Woodall, Technometrics 29 (1987) 393: 370.4 for 3σ limits, 91.75 with the Western Electric rules."""
    rng = np.random.default_rng(7)
    lengths = []
    for _ in range(1500):
        z = rng.standard_normal(4000)
        lengths.append(1 + min(points[0] for points in rule_violations(unit_chart(z), rules).values()))
    error = np.std(lengths) / np.sqrt(len(lengths))
    assert abs(np.mean(lengths) - published) < 4 * error


def test_capability_of_the_nist_handbook() -> None:
    """NIST 6.1.6: LSL 8, USL 20, mean 16, s 2 gives Cp 1.0 and Cpk 0.6667."""
    found = capability_from_moments(50, 16.0, 2.0, 8.0, 20.0)
    assert found.pp is not None
    assert found.ppk is not None
    assert found.pp.value == pytest.approx(1.0)
    assert found.ppk.value == pytest.approx(0.6667, abs=5e-5)
    assert found.cp is None  # no order in time is known
    assert found.outside_fraction == pytest.approx(stats.norm.cdf(-4) + stats.norm.sf(2))


def test_confidence_interval_of_montgomery() -> None:
    """Montgomery, chapter 8: USL 62, LSL 38, s 1.75, n 20 gives 1.57 ≤ Cp ≤ 3.01 around 2.29."""
    index = capability_from_moments(20, 50.0, 1.75, 38.0, 62.0).pp
    assert index is not None
    assert (index.value, index.low, index.high) == pytest.approx((2.29, 1.57, 3.01), abs=6e-3)


@pytest.mark.parametrize(("name", "n"), [("pp", 30), ("ppk", 60), ("cp", 60), ("cpk", 60)])
def test_confidence_intervals_cover(name: str, n: int) -> None:
    rng = np.random.default_rng(11)
    truth = 6 / 6 if name in ("cp", "pp") else (3 - 0.5) / 3
    inside = 0
    for _ in range(1500):
        index = getattr(capability(rng.normal(0.5, 1.0, n), -3.0, 3.0), name)
        inside += index.low <= truth <= index.high
    assert 0.93 < inside / 1500 < 0.97


def test_drift_shows_in_overall_and_not_in_within_sigma() -> None:
    rng = np.random.default_rng(5)
    found = capability(np.linspace(-3, 3, 200) + rng.normal(0, 0.3, 200), -5, 5)
    assert found is not None
    assert found.sigma_within == pytest.approx(0.3, rel=0.15)
    assert found.cpk.value > 3 * found.ppk.value


def test_sigma_within_subgroups_does_not_see_what_lies_between_them() -> None:
    rng = np.random.default_rng(4)
    groups = [rng.normal(centre, 0.5, n) for centre, n in ((0.0, 40), (3.0, 60), (-2.0, 1), (1.0, 80))]
    sigma, freedom = pooled_sigma([g.var(ddof=1) if len(g) > 1 else np.nan for g in groups], [len(g) for g in groups])
    assert freedom == 39 + 59 + 79
    assert abs(sigma / 0.5 - 1) < 3 / np.sqrt(2 * freedom)
    assert np.concatenate(groups).std() > 2 * sigma
    found = capability_from_moments(181, 1.0, 1.3, -3.0, 5.0, sigma_within=sigma, freedom_within=freedom)
    assert found.cp is not None
    assert found.pp is not None
    assert found.cp.value > 2 * found.pp.value
    assert np.isnan(pooled_sigma([np.nan], [1])[0])


def test_capability_with_one_limit_or_without_spread() -> None:
    one = capability([0.1, 0.2, 0.15, 0.12], None, 0.5)
    assert one is not None
    assert one.pp is None
    assert one.ppk is not None
    flat = capability([0.7, 0.7], None, 0.5)
    assert flat is not None
    assert flat.ppk is None
    assert flat.outside_fraction == 1.0
    assert capability([0.7], None, 0.5) is None
    with pytest.raises(UsageError, match="neither"):
        capability([1, 2], None, None)


def test_pareto_ranks_and_sums_up_the_rest() -> None:
    bars = pareto({"b": 5, "a": 5, "none": 0, "c": 30, "d": 1, "e": 1}, most=3)
    assert [(bar.name, bar.count) for bar in bars] == [("c", 30), ("a", 5), ("b", 5), ("2 others", 2)]
    assert bars[-1].cumulative == 1.0
    assert pareto({}) == []

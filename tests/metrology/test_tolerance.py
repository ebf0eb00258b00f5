"""Verdicts against limits."""

from __future__ import annotations

import numpy as np
import pytest

from metrology.errors import SpecError
from metrology.results import Rivet
from metrology.tolerance import Limit, PanelSpec, Zone, judge_rivets

LIMIT = Limit(lower=-0.1, upper=0.1, serious_lower=-0.2, serious_upper=0.2, source="DS-1", revision="B")


def rivet(height: float | None, u95: float | None = 0.01, tilt: float | None = 0.1) -> Rivet:
    return Rivet(
        "R01", 0, 0, 700, 10, 10, None, None, 8, 30, 29, 0, 1,
        height_mean_mm=height, height_u95_mm=u95, tilt_deg=tilt, tilt_u95_deg=0.02,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("value", "severity", "decision"),
    [
        (0.0, "green", "pass"),
        (0.085, "green", "pass"),
        (0.095, "green", "conditional pass"),
        (-0.095, "green", "conditional pass"),
        (0.105, "blue", "conditional fail"),
        (0.15, "blue", "fail"),
        (-0.15, "blue", "fail"),
        (0.21, "red", "fail"),
        (-0.21, "red", "fail"),
    ],
)
def test_colour_and_decision(value: float, severity: str, decision: str) -> None:
    judged = judge_rivets([rivet(value)], PanelSpec("P", "1", {"default": Zone(height_mm=LIMIT)}))[0]
    assert (judged.severity, judged.decision) == (severity, decision)
    assert (judged.reason is None) == (decision == "pass")


def test_not_measured_is_never_a_pass_and_never_hides_a_failure() -> None:
    spec = PanelSpec("P", "1", {"default": Zone(height_mm=LIMIT, tilt_deg=Limit(upper=0.5))})
    missing = judge_rivets([rivet(None)], spec)[0]
    assert (missing.severity, missing.decision) == (None, "not measured")
    failing = judge_rivets([rivet(None, tilt=0.9)], spec)[0]
    assert (failing.severity, failing.decision) == ("blue", "fail")


def test_without_limits_nothing_is_judged() -> None:
    judged = judge_rivets([rivet(5.0)], PanelSpec("P", "1"))[0]
    assert (judged.severity, judged.decision, judged.reason) == (None, "no limit", None)


def test_guard_band_keeps_wrong_acceptance_below_its_risk() -> None:
    rng = np.random.default_rng(0)
    sigma, accepted = 0.005, 0
    truth = 0.1 + rng.uniform(0, 3 * sigma, 10_000)
    for value in truth + rng.normal(0, sigma, truth.size):
        accepted += LIMIT.decision(value, 1.96 * sigma) == "pass"
    assert accepted / truth.size <= 0.025


def test_limits_out_of_order_are_refused() -> None:
    with pytest.raises(SpecError, match="ascending"):
        Limit(lower=0.2, upper=0.1)
    with pytest.raises(SpecError, match="neither"):
        Limit(serious_upper=1)

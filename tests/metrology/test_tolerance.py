"""Verdicts against limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrology.assembly.verdict import findings
from metrology.errors import SpecError
from metrology.kinds import RIVET, SEAM_STATION
from metrology.results import Rivet, SeamStation
from metrology.tolerance import Limit, PanelSpec, decisive, judge
from tests.support.rows import rivet_at, station_at

LIMIT = Limit(lower=-0.1, upper=0.1, serious_lower=-0.2, serious_upper=0.2, source="DS-1", revision="B")


def rivet(height: float | None, u95: float | None = 0.01, tilt: float | None = 0.1) -> Rivet:
    return rivet_at(
        "R01", (0, 0, 700), (10, 10), 8, 30, minor_px=29,
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
    judged = judge(RIVET, [rivet(value)], PanelSpec("P", "1", {"default": {"height_mm": LIMIT}}))[0]
    assert (judged.severity, judged.decision) == (severity, decision)
    assert (judged.reason is None) == (decision == "pass")


def test_not_measured_is_never_a_pass_and_never_hides_a_failure() -> None:
    spec = PanelSpec("P", "1", {"default": {"height_mm": LIMIT, "tilt_deg": Limit(upper=0.5)}})
    missing = judge(RIVET, [rivet(None)], spec)[0]
    assert (missing.severity, missing.decision) == (None, "not measured")
    failing = judge(RIVET, [rivet(None, tilt=0.9)], spec)[0]
    assert (failing.severity, failing.decision) == ("blue", "fail")


@pytest.mark.parametrize(
    ("height", "tilt", "about"),
    [
        (0.05, 0.9, "tilt"),
        (0.05, 0.49, "tilt"),
        (0.3, 0.1, "height"),
        (0.095, 0.9, "tilt"),  # the height is doubtful, the tilt is out
        (0.3, 0.505, "height"),
        (0.3, 5.0, "tilt"),  # both are out, the tilt by more of its limit
        (None, 0.1, "height"),
    ],
)
def test_a_verdict_is_about_the_quantity_that_decided(height: float | None, tilt: float, about: str) -> None:
    spec = PanelSpec("P", "1", {"default": {"height_mm": LIMIT, "tilt_deg": Limit(upper=0.5)}})
    judged = judge(RIVET, [rivet(height, tilt=tilt)], spec)[0]
    decided = decisive(RIVET, judged, spec)
    assert decided is not None
    assert decided.name == about
    [finding] = findings({RIVET.name: [judged]}, spec)
    assert finding.quantity == about
    assert finding.value == (tilt if about == "tilt" else height)
    # What no limit decided is about none of them, and listed by the first.
    assert decisive(RIVET, replace(judged, decision="unconfirmed"), spec) is None
    assert findings({RIVET.name: [replace(judged, decision="unconfirmed")]}, spec)[0].quantity == "height"


def test_without_limits_nothing_is_judged() -> None:
    judged = judge(RIVET, [rivet(5.0)], PanelSpec("P", "1"))[0]
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


def station(step: float, into_wind: float | None = None, zone: str | None = None) -> SeamStation:
    return station_at(
        "S01", 0, (0, 0, 700), (10, 10), step_mm=step, step_u95_mm=0.01, width_mm=2.0, width_u95_mm=0.05,
        step_into_wind_mm=into_wind, zone=zone,
    )  # fmt: skip


def test_each_feature_is_judged_by_its_own_zone_and_by_the_default_where_that_is_silent() -> None:
    tight = Limit(lower=-0.01, upper=0.01)
    zones = {"default": {"height_mm": LIMIT, "tilt_deg": Limit(upper=0.05)}, "nose": {"height_mm": tight}}
    spec = PanelSpec("P", "1", zones)
    nose, wing = judge(RIVET, [replace(rivet(0.05), zone="nose"), replace(rivet(0.05), tilt_deg=0.0)], spec)
    assert (nose.decision, wing.decision) == ("fail", "pass")
    assert "tilt" in (nose.reason or "")


WIND = {
    "step_into_wind_mm": Limit(upper=0.1, serious_upper=0.2, source="DS-7", revision="C"),
    "step_out_of_wind_mm": Limit(upper=0.3, source="DS-8", revision="A"),
}


@pytest.mark.parametrize(
    ("step", "into_wind", "severity", "decision"),
    [
        (-0.05, 0.05, "green", "pass"),
        (0.15, 0.15, "blue", "fail"),
        (-0.15, 0.15, "blue", "fail"),
        (0.25, 0.25, "red", "fail"),
        (0.25, -0.25, "green", "pass"),
        (0.295, -0.295, "green", "conditional pass"),
        (0.35, -0.35, "blue", "fail"),
        # Which way the air flows is not known: the stricter limit holds.
        (-0.15, None, "blue", "fail"),
        (0.05, None, "green", "pass"),
    ],
)
def test_steps_are_judged_by_where_the_wind_comes_from(
    step: float, into_wind: float | None, severity: str, decision: str
) -> None:
    judged = judge(SEAM_STATION, [station(step, into_wind)], PanelSpec("P", "1", {"default": WIND}))[0]
    assert (judged.severity, judged.decision) == (severity, decision)
    if decision == "fail":
        assert "DS-" in (judged.reason or "")


def test_limits_of_a_step_by_wind_are_of_its_amount() -> None:
    with pytest.raises(SpecError, match="amount"):
        PanelSpec("P", "1", {"default": {"step_into_wind_mm": Limit(lower=-0.1, upper=0.1)}})


def test_reasons_name_rule_source_and_revision() -> None:
    judged = judge(RIVET, [rivet(0.15)], PanelSpec("P", "1", {"default": {"height_mm": LIMIT}}))[0]
    assert judged.reason == "height +0.150 ± 0.010 mm outside -0.100 … +0.100 (DS-1 B); ISO 14253-1, guard band U95"

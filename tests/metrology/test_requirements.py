"""The limits told for charts and close-ups are those judged by: zone, default zone and wind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrology.kinds import RIVET, SEAM_STATION
from metrology.requirements import downstream_of, limit_of, requirements
from metrology.results import Rivet, SeamStation
from metrology.tolerance import Limit, PanelSpec, Zone, judge

INTO = Limit(upper=0.1, serious_upper=0.25, source="DS-7", revision="C")
OUT = Limit(upper=0.3, source="DS-8", revision="A")
BOTH = Limit(-0.2, 0.2, -0.4, 0.4, source="DS-1", revision="B")
STEP = SEAM_STATION.quantities[0]
STATION = SeamStation(
    "S01", 0, x_mm=0, y_mm=0, z_mm=700, u_px=10, v_px=10, step_mm=0.0, step_u95_mm=0.01, width_mm=2.0,
    width_u95_mm=0.05,
)  # fmt: skip


@pytest.mark.parametrize("zone", [
    {"step_mm": BOTH}, {"step_into_wind_mm": INTO, "step_out_of_wind_mm": OUT}, {"step_into_wind_mm": INTO},
    {"step_out_of_wind_mm": OUT}, {"step_mm": BOTH, "step_into_wind_mm": INTO, "step_out_of_wind_mm": OUT}, {},
])  # fmt: skip
@pytest.mark.parametrize("sign", [-1, 0, 1])
def test_a_step_s_limit_is_what_it_is_judged_by(zone: Zone, sign: int) -> None:
    """Whatever the step, the one limit gives the verdict that the inspection gives by all of them together."""
    spec = PanelSpec("P", "1", {"default": zone})
    limit = limit_of(spec.zone(None), STEP, sign)
    for step in np.linspace(-0.5, 0.5, 202):
        station = replace(STATION, step_mm=float(step), step_into_wind_mm=float(sign * step) if sign else None)
        assert downstream_of(STEP, station) == sign
        judged = judge(SEAM_STATION, [station], spec)[0]
        if limit is None:
            assert judged.decision == "no limit"
        else:
            told = limit.severity(station.step_mm), limit.decision(station.step_mm, station.step_u95_mm)
            assert told == (judged.severity, judged.decision)


def test_a_zone_that_is_silent_takes_the_default_s_limit() -> None:
    spec = PanelSpec(
        "P", "1", {"default": {"height_mm": BOTH, "tilt_deg": Limit(upper=1.0)}, "nose": {"height_mm": OUT}}
    )
    rivet = Rivet(
        "R1", x_mm=0, y_mm=0, z_mm=700, u_px=0, v_px=0, u_right_px=None, v_right_px=None, diameter_mm=5.0, major_px=20,
        minor_px=20, angle_deg=0, confidence=1.0, height_mean_mm=0.05, height_u95_mm=0.01, zone="nose",
    )  # fmt: skip
    assert [(r.name, r.limit) for r in requirements(RIVET, rivet, spec)] == [
        ("height", OUT),
        ("tilt", Limit(upper=1.0)),
    ]
    assert limit_of(spec.zone("nose"), RIVET.quantities[1]) == Limit(upper=1.0)
    assert limit_of(spec.zone("nose"), RIVET.quantities[0]) == OUT
    assert limit_of(spec.zone("elsewhere"), RIVET.quantities[0]) == BOTH


def test_every_limit_that_judges_a_station_is_among_its_requirements() -> None:
    spec = PanelSpec("P", "1", {"default": {"step_into_wind_mm": INTO, "step_out_of_wind_mm": OUT}})
    known = replace(STATION, step_mm=0.15, step_into_wind_mm=0.15)
    (step, width) = requirements(SEAM_STATION, known, spec)
    assert (step.name, step.value) == ("step into the wind", 0.15)
    assert (step.limit.lower, step.limit.upper, step.limit.source) == (-0.3, 0.1, "DS-8 / DS-7")
    assert width.limit is None
    unknown = requirements(SEAM_STATION, replace(STATION, step_mm=-0.15), spec)
    assert [(r.value, r.limit) for r in unknown[:2]] == [(0.15, INTO), (0.15, OUT)]


@pytest.mark.parametrize(
    ("limit", "value", "relative"),
    [
        (Limit(-0.1, 0.1), 0.05, 0.5),
        (Limit(-0.05, 0.15), 0.15, 1.0),
        (Limit(1.0, 3.5), 1.0, -1.0),
        (Limit(upper=2.0), 1.0, 0.5),
        (Limit(lower=-0.2), -0.1, -0.5),
        (Limit(0.1, 0.1), 0.1, None),
        (Limit(lower=1.0), 2.0, None),
        (Limit(upper=0.0), -1.0, None),
    ],
)
def test_values_relative_to_their_limits(limit: Limit, value: float, relative: float | None) -> None:
    assert limit.relative(value) == (None if relative is None else pytest.approx(relative))

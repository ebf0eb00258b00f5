"""The limits told for charts and close-ups are those judged by: zone, default zone and wind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrology.requirements import downstream_of, limit_of, rivet_requirements, station_requirements
from metrology.results import Rivet, SeamStation
from metrology.tolerance import Limit, PanelSpec, Zone, judge_stations

INTO = Limit(upper=0.1, serious_upper=0.25, source="DS-7", revision="C")
OUT = Limit(upper=0.3, source="DS-8", revision="A")
BOTH = Limit(-0.2, 0.2, -0.4, 0.4, source="DS-1", revision="B")
STATION = SeamStation("S01", 0, 0, 0, 700, 10, 10, 0.0, 0.01, 2.0, 0.05)


@pytest.mark.parametrize("zone", [
    Zone(step_mm=BOTH), Zone(step_into_wind_mm=INTO, step_out_of_wind_mm=OUT), Zone(step_into_wind_mm=INTO),
    Zone(step_out_of_wind_mm=OUT), Zone(BOTH, None, BOTH, None, INTO, OUT), Zone(),
])  # fmt: skip
@pytest.mark.parametrize("sign", [-1, 0, 1])
def test_a_step_s_limit_is_what_it_is_judged_by(zone: Zone, sign: int) -> None:
    """Whatever the step, the one limit gives the verdict that the inspection gives by all of them together."""
    spec = PanelSpec("P", "1", {"default": zone})
    limit = limit_of(spec.zone(None), "step_mm", sign)
    for step in np.linspace(-0.5, 0.5, 202):
        station = replace(STATION, step_mm=float(step), step_into_wind_mm=float(sign * step) if sign else None)
        assert downstream_of(station) == sign
        judged = judge_stations([station], spec)[0]
        if limit is None:
            assert judged.decision == "no limit"
        else:
            told = limit.severity(station.step_mm), limit.decision(station.step_mm, station.step_u95_mm)
            assert told == (judged.severity, judged.decision)


def test_a_zone_that_is_silent_takes_the_default_s_limit() -> None:
    spec = PanelSpec(
        "P", "1", {"default": Zone(height_mm=BOTH, tilt_deg=Limit(upper=1.0)), "nose": Zone(height_mm=OUT)}
    )
    rivet = Rivet("R1", 0, 0, 700, 0, 0, None, None, 5.0, 20, 20, 0, 1.0, 0.05, height_u95_mm=0.01, zone="nose")
    assert [(r.name, r.limit) for r in rivet_requirements(rivet, spec)] == [("height", OUT), ("tilt", Limit(upper=1.0))]
    assert limit_of(spec.zone("nose"), "tilt_deg") == Limit(upper=1.0)
    assert limit_of(spec.zone("nose"), "height_mm") == OUT
    assert limit_of(spec.zone("elsewhere"), "height_mm") == BOTH


def test_every_limit_that_judges_a_station_is_among_its_requirements() -> None:
    spec = PanelSpec("P", "1", {"default": Zone(step_into_wind_mm=INTO, step_out_of_wind_mm=OUT)})
    known = replace(STATION, step_mm=0.15, step_into_wind_mm=0.15)
    (step, width) = station_requirements(known, spec)
    assert (step.name, step.value) == ("step into the wind", 0.15)
    assert (step.limit.lower, step.limit.upper, step.limit.source) == (-0.3, 0.1, "DS-8 / DS-7")
    assert width.limit is None
    unknown = station_requirements(replace(STATION, step_mm=-0.15), spec)
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

"""Values that say nothing, or that no head or joint can have, are not measured, with the reason."""

from __future__ import annotations

from dataclasses import replace

import pytest

from metrology import kinds
from metrology.plausibility import plausible_rivet, plausible_station
from metrology.results import Rivet, SeamStation
from metrology.tolerance import Limit, PanelSpec, judge

RIVET = Rivet(
    "R01", x_mm=1.0, y_mm=2.0, z_mm=700.0, u_px=10.0, v_px=12.0, u_right_px=None, v_right_px=None, diameter_mm=5.5,
    major_px=28.0, minor_px=27.0, angle_deg=5.0, confidence=0.9,
)  # fmt: skip
SOUND = replace(
    RIVET,
    height_mean_mm=0.05,
    height_min_mm=0.03,
    height_max_mm=0.07,
    height_u95_mm=0.004,
    tilt_deg=0.3,
    tilt_u95_deg=0.1,
    crown_mm=0.1,
)
STATION = SeamStation(
    "S01", 4.0, x_mm=1.0, y_mm=2.0, z_mm=700.0, u_px=10.0, v_px=12.0, step_mm=0.1, step_u95_mm=0.01, width_mm=2.4,
    width_u95_mm=0.05, n_left=90, n_right=95,
)  # fmt: skip


def test_sound_values_stay_as_they_are() -> None:
    assert plausible_rivet(SOUND) == SOUND
    assert plausible_station(STATION) == STATION
    assert plausible_rivet(RIVET) == RIVET


@pytest.mark.parametrize(
    ("height", "u95", "words"),
    [
        (28.3, 744.0, "height: found U95 of 744 mm, expected at most 0.55 mm"),
        (0.05, 0.6, "height: found U95 of 0.6 mm"),
        (-4.0, 0.01, "height: found -4 mm, expected at most 2.75 mm either way"),
        (0.05, float("nan"), "height: found U95 of nan mm"),
    ],
)
def test_an_absurd_height_leaves_nothing_of_the_head(height: float, u95: float, words: str) -> None:
    found = plausible_rivet(replace(SOUND, height_mean_mm=height, height_u95_mm=u95))
    assert found.decision == "not measured"
    assert found.reason is not None
    assert words in found.reason
    values = (found.height_mean_mm, found.height_min_mm, found.height_max_mm, found.height_u95_mm, found.tilt_deg)
    assert {*values, found.tilt_u95_deg, found.crown_mm, found.x_mm, found.z_mm, found.diameter_mm} == {None}
    assert (found.u_px, found.v_px) == (10.0, 12.0)


@pytest.mark.parametrize(("tilt", "u95"), [(3.0, 2074.0), (60.0, 0.5)])
def test_an_absurd_tilt_takes_the_extreme_heights_with_it(tilt: float, u95: float) -> None:
    found = plausible_rivet(replace(SOUND, tilt_deg=tilt, tilt_u95_deg=u95))
    assert (found.tilt_deg, found.tilt_u95_deg, found.height_min_mm, found.height_max_mm) == (None,) * 4
    assert (found.height_mean_mm, found.height_u95_mm, found.x_mm) == (0.05, 0.004, 1.0)
    assert found.decision == "not measured"


def test_absurd_steps_and_widths_go_one_by_one() -> None:
    no_step = plausible_station(replace(STATION, step_u95_mm=3.0))
    assert (no_step.step_mm, no_step.step_u95_mm, no_step.width_mm) == (None, None, 2.4)
    no_width = plausible_station(replace(STATION, width_mm=80.0))
    assert (no_width.step_mm, no_width.width_mm, no_width.width_u95_mm) == (0.1, None, None)
    assert no_width.reason == "width: found +80 mm, expected at most 50 mm either way"


SPEC = PanelSpec(
    "P",
    "A",
    {
        "default": {
            "height_mm": Limit(-0.05, 0.05),
            "tilt_deg": Limit(upper=1.0),
            "step_mm": Limit(-0.1, 0.1),
            "width_mm": Limit(1.0, 1.5),
        },
        "wind": {"step_into_wind_mm": Limit(upper=0.02), "step_out_of_wind_mm": Limit(upper=0.03)},
    },
)


def test_what_is_vaguer_than_its_limits_range_is_not_judged_by_them() -> None:
    [vague, sharp] = judge(kinds.RIVET, [replace(SOUND, height_u95_mm=0.11), replace(SOUND, height_u95_mm=0.09)], SPEC)
    assert vague.decision == "not measured"
    assert (vague.height_mean_mm, vague.height_u95_mm, vague.height_min_mm) == (None, None, None)
    assert (vague.x_mm, vague.tilt_deg) == (1.0, 0.3)
    assert vague.reason is not None
    assert "found U95 of 0.11 mm, expected less than the 0.1 mm that its limits leave" in vague.reason
    assert (sharp.decision, sharp.height_mean_mm) == ("conditional pass", 0.05)


def test_seams_are_judged_by_what_their_limits_leave() -> None:
    [step] = judge(kinds.SEAM_STATION, [replace(STATION, step_u95_mm=0.21)], SPEC)
    assert (step.decision, step.step_mm, step.width_mm) == ("fail", None, 2.4)  # its width fails
    [width] = judge(kinds.SEAM_STATION, [replace(STATION, width_u95_mm=0.51)], SPEC)
    assert (width.decision, width.step_mm, width.width_mm) == ("not measured", 0.1, None)
    [unknown_wind] = judge(kinds.SEAM_STATION, [replace(STATION, zone="wind", step_u95_mm=0.045)], SPEC)
    assert unknown_wind.step_mm is None
    into_wind = replace(STATION, zone="wind", step_u95_mm=0.045, step_into_wind_mm=0.1)
    assert judge(kinds.SEAM_STATION, [into_wind], SPEC)[0].step_into_wind_mm == 0.1
    assert judge(kinds.SEAM_STATION, [replace(into_wind, step_u95_mm=0.051)], SPEC)[0].step_into_wind_mm is None


def test_limits_that_allow_one_value_alone_still_judge() -> None:
    nowhere = PanelSpec("P", "A", {"default": {"height_mm": Limit(0.0, 0.0)}})
    assert judge(kinds.RIVET, [SOUND], nowhere)[0].decision == "fail"

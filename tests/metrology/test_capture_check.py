"""Frames of known exposure, noise and gamma: each is told, and what is good is called so."""

from __future__ import annotations

import numpy as np
import pytest

from metrology.capture_check import CaptureState, check_capture, verdict
from metrology.fringe import FringeCode, GrayCode
from tests.support.rendered_fringes import clean_frames, ramp, recorded

CODE = FringeCode("x", 4, (13, 12, 11))


def state(
    rng: np.random.Generator, code: FringeCode = CODE, mean: float = 110.0, amplitude: float = 90.0,
    gamma: float = 1.0, sigma: float = 1.5,
) -> CaptureState:  # fmt: skip
    clean = clean_frames(ramp(90, 320, 640), code, 640, mean, amplitude, gamma)
    return check_capture(recorded(clean, rng, sigma)[0], code)


def test_good_frames_are_good(rng: np.random.Generator) -> None:
    found = state(rng)
    assert found.good
    assert verdict([found]) == "good"
    assert found.lit == 1.0
    assert found.clipped == 0.0
    assert found.gamma == pytest.approx(1.0, abs=0.03)
    assert found.noise == pytest.approx(1.5, rel=0.1)
    assert found.amplitude * 254 == pytest.approx(90, rel=0.02)


@pytest.mark.parametrize("steps", [4, 5, 8])
@pytest.mark.parametrize("gamma", [0.8, 1.6, 2.2])
def test_gamma_is_measured(rng: np.random.Generator, steps: int, gamma: float) -> None:
    found = state(rng, FringeCode("x", steps, (13, 12, 11)), mean=110, amplitude=90, gamma=gamma)
    assert found.gamma == pytest.approx(gamma, abs=0.08)
    assert any("not linear" in problem for problem in found.problems)


def test_three_steps_do_not_show_gamma(rng: np.random.Generator) -> None:
    assert state(rng, FringeCode("x", 3, (13, 12, 11)), gamma=1.6).gamma is None


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"mean": 200.0, "amplitude": 120.0}, "are clipped: expose half as long"),
        ({"mean": 20.0, "amplitude": 16.0}, "too dark: expose"),
        ({"mean": 150.0, "amplitude": 30.0}, "keep other light away"),
        ({"mean": 60.0, "amplitude": 40.0, "sigma": 8.0}, "times the noise"),
        ({"mean": 5.0, "amplitude": 1.0}, "reaches 0% of the pixels"),
    ],
)
def test_what_is_wrong_is_named(rng: np.random.Generator, arguments: dict[str, float], said: str) -> None:
    found = state(rng, **arguments)  # type: ignore[arg-type]
    assert any(said in problem for problem in found.problems), found.problems
    assert verdict([found]) != "good"


def test_clipped_frames_are_not_asked_for_more_light(rng: np.random.Generator) -> None:
    noisy = state(rng, mean=170.0, amplitude=90.0, sigma=12.0)
    assert noisy.clipped > 0.1
    assert any("times the noise" in problem for problem in noisy.problems)
    assert not any("more light" in problem for problem in noisy.problems)


def test_stripes_alone_are_judged_too(rng: np.random.Generator) -> None:
    code = FringeCode("x", 0, (), GrayCode(64, True))
    lines = code.patterns(640, 1)[:, 0]
    levels = 30 + 180 * lines[:, np.rint(ramp(90, 320, 640)).astype(int).clip(0, 639)]
    found = check_capture(recorded(levels, rng, 1.5)[0], code)
    assert found.good
    assert found.gamma is None

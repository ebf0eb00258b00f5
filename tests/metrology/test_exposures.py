"""Exposure times: only their ratios count, and the frames must agree with them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.errors import SceneError
from metrology.exposures import check_brightness, relative_exposures
from tests.support.rendered_fringes import USUAL, clean_frames, ramp, recorded


@pytest.mark.parametrize(
    ("times", "relative"),
    [
        ((1.0,), (1.0,)),
        ((0.2, 1.0, 5.0), (0.2, 1.0, 5.0)),
        ((0.5, 2.0), (0.5, 2.0)),
        ((20000.0,), (1.0,)),
        ((5.0, 10.0, 20.0), (0.5, 1.0, 2.0)),
        ((0.02, 0.005, 0.08), (1.0, 0.25, 4.0)),
    ],
)
def test_times_in_a_unit_become_relative_ones(times: tuple[float, ...], relative: tuple[float, ...]) -> None:
    assert relative_exposures(times) == pytest.approx(relative)


TIMES = (0.25, 1.0, 2.5)


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        (TIMES, None),
        ((0.27, 1.0, 2.4), None),
        ((0.25, 1.0, 5.0), "found 1 and 5, 5 times as long, but frames that are 2.[45]"),
        ((1.0, 0.25, 2.5), "found 0.25 and 1, 4 times as long, but frames that are 0.25 times as bright"),
    ],
)
@pytest.mark.parametrize("room_light", [0.0, 25.0])
def test_frames_that_are_not_as_bright_as_stated_are_refused(
    stated: tuple[float, ...], said: str | None, room_light: float, rng: np.random.Generator
) -> None:
    brightness = np.geomspace(0.3, 3.0, 400)
    clean = clean_frames(ramp(160, 400, 1280), USUAL, 1280, 60 * brightness + room_light, 45 * brightness)
    frames = recorded(clean + 6.0, rng, 1.5, TIMES)
    frames = np.clip(frames.astype(int) + 8, 0, 255).astype(np.uint8)  # the camera's black level
    if said is None:
        check_brightness(frames, USUAL, stated)
        return
    with pytest.raises(SceneError, match=said):
        check_brightness(frames, USUAL, stated)


def three_exposures(rng: np.random.Generator) -> NDArray[np.uint8]:
    brightness = np.geomspace(0.3, 3.0, 400)
    return recorded(clean_frames(ramp(160, 400, 1280), USUAL, 1280, 60 * brightness, 45 * brightness), rng, 1.5, TIMES)


def test_frames_listed_with_all_exposures_of_each_are_said_to_be(rng: np.random.Generator) -> None:
    frames = three_exposures(rng)
    listed = frames.swapaxes(0, 1).reshape(frames.shape)
    with pytest.raises(SceneError, match="fit with all exposures of a frame one after the other"):
        check_brightness(listed, USUAL, TIMES)


def test_times_in_another_order_are_named_in_the_order_of_the_frames(rng: np.random.Generator) -> None:
    with pytest.raises(SceneError, match=r"expected the times in the order of the frames: 0\.25, 1, 2\.5"):
        check_brightness(three_exposures(rng), USUAL, (1.0, 2.5, 0.25))


def test_black_frames_say_nothing_about_exposures() -> None:
    check_brightness(np.zeros((2, 12, 90, 120), np.uint8), USUAL, (1.0, 4.0))

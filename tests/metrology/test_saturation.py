"""Where a camera clips is told from the frames: wider containers, ranges that end early, stamped and hot pixels."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.calibration.frames import BoardFrames
from metrology.cloud import PixelFlag
from metrology.decode import decode_phase
from metrology.fringe import FringeCode, GrayCode
from metrology.saturation import saturation_level
from tests.support.rendered_fringes import USUAL, clean_frames, ramp

SIZE = 1280
SHAPE = (120, 500)
# dtype, grey levels of the file per 8-bit grey level, where the camera clips, and its full range
CONTAINERS = [
    (np.uint8, 1, 200, 255),
    (np.uint8, 1, 235, 255),
    (np.uint16, 4, 1000, 1023),
    (np.uint16, 16, 3800, 4095),
    (np.uint16, 64, 15000, 16383),
    (np.uint16, 256, 60160, 65535),
]


def truth() -> NDArray[np.float64]:
    return ramp(*SHAPE, SIZE)


def levels(rng: np.random.Generator, gain: float, code: FringeCode = USUAL) -> NDArray[np.float64]:
    """(1, frames, h, w) noisy levels of skin that is brighter on one side, on an 8-bit scale without an end."""
    brightness = gain * np.linspace(0.5, 1.1, SHAPE[1])
    clean = clean_frames(truth(), code, SIZE, 100 * brightness, 80 * brightness)
    return (clean + rng.normal(0, 1.0, clean.shape))[None]


def kept(seen: NDArray, dtype: type, scale: float, top: int) -> NDArray:
    """What a file holds of levels: whole numbers that end at `top`."""
    return np.clip(np.rint(seen) * scale if scale == 256 else np.rint(seen * scale), 0, top).astype(dtype)


@pytest.mark.parametrize(("dtype", "scale", "top", "full"), CONTAINERS)
def test_samples_that_pile_up_are_saturated(
    dtype: type, scale: int, top: int, full: int, rng: np.random.Generator
) -> None:
    frames = kept(levels(rng, 1.5), dtype, scale, top)
    assert top - (full + 1) // 256 < saturation_level(frames) <= top
    sound = kept(levels(rng, 0.9), dtype, scale, top)
    assert sound.max() < top
    assert saturation_level(sound) == pytest.approx(full * 254 / 255)


@pytest.mark.parametrize("gain", [0.9, 1.5])
@pytest.mark.parametrize(("dtype", "scale", "top", "full"), CONTAINERS[1:5])
def test_stamped_and_hot_pixels_tell_nothing(
    dtype: type, scale: int, top: int, full: int, gain: float, rng: np.random.Generator
) -> None:
    frames = kept(levels(rng, gain), dtype, scale, top)
    before = saturation_level(frames)
    frames[:, :, 0, :6] = np.iinfo(dtype).max
    frames[:, :, rng.random(SHAPE) < 2e-4] = np.iinfo(dtype).max
    assert saturation_level(frames) == before


def test_one_exposure_that_is_clipped_tells(rng: np.random.Generator) -> None:
    frames = np.concatenate([kept(levels(rng, gain), np.uint8, 1, 235) for gain in (0.2, 0.6, 1.6)])
    assert saturation_level(frames) == 235.0
    assert saturation_level(frames[:2]) == 254.0


@pytest.mark.parametrize("gain", [0.03, 0.15, 1.0])
@pytest.mark.parametrize("even", [False, True])
def test_frames_without_noise_are_not_taken_for_clipped(gain: float, even: bool) -> None:
    brightness = gain * (1.0 if even else np.linspace(0.5, 1.1, SHAPE[1]))
    clean = clean_frames(truth(), USUAL, SIZE, 120 * brightness, 90 * brightness)
    assert saturation_level(np.rint(clean).astype(np.uint8)[None]) == 254.0


def test_a_few_specular_samples_at_the_end_change_nothing(rng: np.random.Generator) -> None:
    frames = kept(levels(rng, 0.9), np.uint8, 1, 255)
    frames[:, :, rng.random(SHAPE) < 0.01] = 255
    assert saturation_level(frames) == 254.0


def test_even_light_of_gray_code_is_no_clipping(rng: np.random.Generator) -> None:
    code = FringeCode("x", 4, (16,), GrayCode(16))
    frames = np.rint(clean_frames(truth(), code, SIZE, 100.0, 80.0))[None].astype(np.uint8)
    frames[:, : code.fringe_frames] = kept(levels(rng, 0.9)[:, : code.fringe_frames], np.uint8, 1, 255)
    assert saturation_level(frames, frames[:, : code.fringe_frames]) == 254.0


def test_a_clipped_scan_keeps_an_unbiased_coordinate(rng: np.random.Generator) -> None:
    frames = kept(levels(rng, 1.15), np.uint8, 1, 180)
    view = decode_phase(frames, USUAL, SIZE)
    partial = (view.flags & PixelFlag.SATURATED_SAMPLES) != 0
    error = ((view.coordinate - truth()) / view.sigma)[partial & np.isfinite(view.coordinate)]
    assert error.size > 10_000
    assert np.std(error) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("dtype", "scale", "top", "full"), CONTAINERS)
def test_a_board_that_is_clipped_is_told_from_one_that_is_white(
    dtype: type, scale: int, top: int, full: int, rng: np.random.Generator
) -> None:
    board = np.full((200, 300), 0.9 * top / scale)
    board[::4, ::4] = 20.0
    noisy = board + rng.normal(0, 1.0, board.shape)
    noisy[:, :160] *= 1.4
    clipped = BoardFrames(kept(noisy, dtype, scale, top)).saturated
    assert clipped[:, :160].mean() > 0.9
    assert not clipped[:, 160:].any()
    assert not BoardFrames(kept(board, dtype, scale, top)).saturated.any()

"""The camera's noise, found in the fringe frames themselves."""

from __future__ import annotations

import numpy as np
import pytest

from metrology.decode import decode_phase
from metrology.fringe import FringeCode, GrayCode
from metrology.noise import NoiseModel, estimate_noise
from tests.support.rendered_fringes import USUAL, clean_frames, ramp, recorded

SIZE = 1280


def photon_frames(code: FringeCode, rng: np.random.Generator, gamma: float = 1.0) -> np.ndarray:
    """Frames of a camera with a read variance of 2.25 and a gain of 0.03, brightness falling along the rows."""
    truth = ramp(600, 500, SIZE)
    brightness = np.linspace(0.25, 1.0, 600)[:, None]
    if code.axis == "y":
        truth, brightness = truth.T[:, :500], brightness[:500]
    clean = clean_frames(truth, code, SIZE, 115 * brightness, 100 * brightness, gamma)
    noisy = clean + rng.normal(0, 1, clean.shape) * np.sqrt(2.25 + 0.03 * clean)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)[None]


@pytest.mark.parametrize(
    "code",
    [
        USUAL,
        FringeCode("y", 4, (70, 64, 59)),
        FringeCode("x", 3, (70, 64, 59)),
        FringeCode("x", 8, (9, 8)),
    ],
)
def test_gain_and_read_noise_are_found(code: FringeCode, rng: np.random.Generator) -> None:
    noise = estimate_noise(photon_frames(code, rng), code, 254.0)
    levels = np.array([30.0, 60.0, 110.0])
    np.testing.assert_allclose(noise.sigma(levels), np.sqrt(2.25 + 1 / 12 + 0.03 * levels), rtol=0.05)


def test_projector_harmonics_do_not_pass_for_noise(rng: np.random.Generator) -> None:
    straight = estimate_noise(photon_frames(USUAL, rng), USUAL, 254.0)
    bent = estimate_noise(photon_frames(USUAL, rng, gamma=1.8), USUAL, 254.0)
    assert bent.sigma(80.0) == pytest.approx(straight.sigma(80.0), rel=0.08)


def test_saturated_and_black_samples_do_not_count(rng: np.random.Generator) -> None:
    frames = photon_frames(USUAL, rng)
    frames[:, :, :200] = 255
    frames[:, :, 200:300] = 0
    noise = estimate_noise(frames, USUAL, 254.0)
    assert noise.sigma(90.0) == pytest.approx(np.sqrt(2.25 + 1 / 12 + 0.03 * 90), rel=0.06)


def test_nothing_to_learn_from_gives_a_cautious_model() -> None:
    noise = estimate_noise(np.zeros((1, 12, 40, 40), np.uint8), USUAL, 254.0)
    assert noise == NoiseModel(1.0, 0.0)


def test_senseless_models_are_refused() -> None:
    with pytest.raises(ValueError, match="positive read variance"):
        NoiseModel(0.0, 0.1)


@pytest.mark.parametrize("gray", [GrayCode(128), GrayCode(128, True)], ids=str)
def test_three_steps_of_one_count_have_the_noise_of_their_gray_code(gray: GrayCode, rng: np.random.Generator) -> None:
    code = FringeCode("x", 3, (64,), gray)
    clean = clean_frames(ramp(160, 400, 1280), code, 1280, 110, 80)
    skin = 1 + 0.1 * rng.normal(0, 1, clean.shape[1:])  # neighbours' difference would tell ten times the noise
    view = decode_phase(recorded(clean * skin, rng, 1.5), code, 1280)
    assert view.noise is not None
    assert view.noise.sigma(100) == pytest.approx(1.5, rel=0.1)

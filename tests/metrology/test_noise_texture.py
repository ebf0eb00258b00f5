"""What the noise of pictures tells of how they came about, on painted fringes of random noise."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.fringe import Axis, FringeCode
from metrology.noise_texture import NoiseTexture, level_step, noise_texture
from tests.support.rendered_fringes import USUAL, clean_frames, ramp, recorded

SIZE = 1024
Edit = Callable[[NDArray, np.random.Generator], NDArray]


def frames(rng: np.random.Generator, code: FringeCode = USUAL, gamma: float = 1.0) -> NDArray[np.uint8]:
    """(frames, 400, 640) pictures of a tilted ramp with noise of 2 grey levels."""
    coordinate = ramp(400, 640, SIZE, 0.05)
    clean = clean_frames(coordinate, code, SIZE, 110, 60, gamma)
    return recorded(clean, rng, 2.0)[0]


def looked_at(pictures: NDArray, code: FringeCode = USUAL) -> NoiseTexture:
    found = noise_texture(pictures, code, 254.0)
    assert found is not None
    return found


def each(edit: Callable[[NDArray], NDArray]) -> Edit:
    return lambda pictures, _: np.stack([edit(picture) for picture in pictures])


def sharpened(picture: NDArray) -> NDArray:
    blurred = cv2.GaussianBlur(picture, (0, 0), 1.0).astype(float)
    return np.clip(np.rint(1.5 * picture - 0.5 * blurred), 0, 255).astype(np.uint8)


def compressed(picture: NDArray) -> NDArray:
    coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE))


def beating(pictures: NDArray, rng: np.random.Generator) -> NDArray:
    """Waves of 4 %, 9 pixels long, that lie elsewhere in every frame."""
    v, u = np.mgrid[: pictures.shape[1], : pictures.shape[2]]
    phase = 2 * np.pi * (0.8 * u + 0.6 * v) / 9
    waves = [1 + 0.04 * np.cos(phase + rng.uniform(0, 6.28)) for _ in pictures]
    return np.clip(np.rint(pictures * np.stack(waves)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("gamma", [1.0, 1.6])
def test_a_sensors_own_noise_is_independent(seed: int, gamma: float) -> None:
    found = looked_at(frames(np.random.default_rng(seed), gamma=gamma))
    assert found.grain == pytest.approx(1, abs=0.06)
    assert abs(found.neighbours) < 0.02
    assert abs(found.waves) < 0.02
    assert found.columns == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("steps", [5, 8])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_other_codes_tell_it_too(axis: Axis, steps: int, rng: np.random.Generator) -> None:
    pictures = frames(rng, FringeCode("x", steps, (37, 35)))
    if axis == "y":
        pictures = np.ascontiguousarray(pictures.transpose(0, 2, 1))
    found = looked_at(pictures, FringeCode(axis, steps, (37, 35)))
    assert found.grain == pytest.approx(1, abs=0.06)
    assert abs(found.neighbours) < 0.02


@pytest.mark.parametrize(
    ("edit", "grain", "neighbours"),
    [(each(sharpened), (0.5, 0.9), (-0.2, -0.02)), (each(compressed), (1.3, 4), (0.35, 1)),
     (each(lambda picture: cv2.blur(picture, (7, 1))), (1.5, 4), (0.35, 1))],
    ids=["sharpened", "compressed", "smeared"],
)  # fmt: skip
def test_filters_make_neighbours_alike_or_unlike(
    edit: Edit, grain: tuple[float, float], neighbours: tuple[float, float], rng: np.random.Generator
) -> None:
    found = looked_at(edit(frames(rng), rng))
    assert grain[0] < found.grain < grain[1]
    assert neighbours[0] < found.neighbours < neighbours[1]
    assert abs(found.waves) < 0.05


def test_waves_and_rows_reach_farther_than_filters(rng: np.random.Generator) -> None:
    pictures = frames(rng)
    assert abs(looked_at(beating(pictures, rng)).waves) > 0.1
    rows = np.clip(pictures + np.rint(rng.normal(0, 2, (*pictures.shape[:2], 1))), 0, 255).astype(np.uint8)
    assert looked_at(rows).waves == pytest.approx(0.5, abs=0.15)


@pytest.mark.parametrize("length", [5, 11, 40])
def test_waves_along_the_fringes_show_in_columns(length: float, rng: np.random.Generator) -> None:
    """Pixels along a fringe are then alike: no difference between them shows it."""
    pictures = frames(rng)
    u = np.arange(pictures.shape[2])
    waves = np.stack([1 + 0.03 * np.cos(2 * np.pi * u / length + rng.uniform(0, 6.28)) for _ in pictures])
    found = looked_at(np.clip(np.rint(pictures * waves[:, None]), 0, 255).astype(np.uint8))
    assert found.columns > 2
    assert found.grain == pytest.approx(1, abs=0.1)


def test_flicker_and_movement_are_no_waves(rng: np.random.Generator) -> None:
    """Every frame of another brightness on a textured skin, which moves by a tenth of a pixel."""
    texture = 1 + 0.1 * cv2.GaussianBlur(rng.normal(size=(400, 640)), (0, 0), 1.5)
    bright = 1 + rng.normal(0, 0.02, (12, 1, 1))
    moved = [ramp(400, 640, SIZE, 0.05) + shift for shift in rng.normal(0, 0.1, 12)]
    clean = np.stack([clean_frames(at, USUAL, SIZE, 110, 60, 1.4)[k] for k, at in enumerate(moved)])
    found = looked_at(recorded(clean * texture * bright, rng, 2.0)[0])
    assert found.columns == pytest.approx(1, abs=0.3)
    assert found.grain == pytest.approx(1, abs=0.1)


def test_harmonics_are_those_of_the_fringes_shape(rng: np.random.Generator) -> None:
    """(1 + cos φ)² has a second harmonic of a quarter of the first."""
    squared = looked_at(frames(rng, gamma=2.0)).harmonics
    # The part that four steps leave over has the second harmonic twice.
    assert np.abs(squared).max() / 2 == pytest.approx(0.25, abs=0.01)
    assert np.abs(looked_at(frames(rng)).harmonics).max() < 0.01


def test_nothing_is_said_of_little_noise_or_three_steps(rng: np.random.Generator) -> None:
    code = FringeCode("x", 3, (70, 64, 59))
    assert noise_texture(frames(rng, code), code, 254.0) is None
    assert noise_texture(frames(rng)[:, :30], USUAL, 254.0) is None


@pytest.mark.parametrize("bits", [8, 6, 4])
def test_the_step_between_levels_is_that_of_the_bits(bits: int, rng: np.random.Generator) -> None:
    step = 2 ** (8 - bits)
    assert level_step(frames(rng) // step * step) == step
    assert level_step(frames(rng).astype(np.uint16) // step * step * 256) == 256 * step

"""Frames that are not what the scene says: found on a coarse grid, named, told in which order they would fit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.decode import decode_phase
from metrology.frame_consistency import FrameConsistency, contradictory_share, frame_consistency
from metrology.frame_diagnosis import FrameDiagnosis, diagnose_frames
from metrology.frame_sample import sample_frames
from metrology.fringe import FringeCode, GrayCode
from metrology.noise import estimate_noise
from tests.support.rendered_fringes import clean_frames, ramp, recorded

SIZE = 1280
HEIGHT, WIDTH = 270, 400
USUAL = FringeCode("x", 4, (70, 64, 59))
RISING = np.array([1.0, 0.0])


def scan(code: FringeCode, gamma: float = 1.3, exposures: tuple[float, ...] = (1.0,)) -> NDArray[np.uint8]:
    """Sound frames (exposures, frames, h, w) of a textured skin."""
    rng = np.random.default_rng(7)
    along = ramp(HEIGHT, WIDTH, SIZE) if code.axis == "x" else ramp(WIDTH, HEIGHT, SIZE).T
    texture = 1 + 0.1 * rng.normal(0, 1, (HEIGHT // 5, WIDTH // 5)).repeat(5, 0).repeat(5, 1)
    return recorded(clean_frames(along, code, SIZE, 80 * texture, 60 * texture, gamma), rng, 2.0, exposures)


def look(frames: NDArray, code: FringeCode) -> tuple[list[FrameConsistency], FrameDiagnosis]:
    noise = estimate_noise(np.ascontiguousarray(frames[:, : code.fringe_frames]), code, 254.0)
    sample = sample_frames(frames, code, noise)
    found = [frame_consistency(sample, exposure) for exposure in range(len(frames))]
    if not any(judged.odd for judged in found):
        return found, FrameDiagnosis()
    finer = lambda rows: sample_frames(frames, code, noise, rows)  # noqa: E731
    return found, diagnose_frames(sample, found, finer, RISING if code.axis == "x" else RISING[::-1])


CODES = [
    USUAL,
    FringeCode("x", 5, (70, 64, 59)),
    FringeCode("x", 8, (37, 36, 35)),
    FringeCode("y", 4, (40, 36, 33)),
    FringeCode("x", 4, (16, 15)),
    FringeCode("x", 4, (64,), GrayCode(128, True)),
]


@pytest.mark.parametrize("share", [0.5, 0.63, 1.0])
@pytest.mark.parametrize("code", [FringeCode("y", 8, (16,), GrayCode(32)), FringeCode("y", 4, (16, 15))])
def test_where_the_light_ends_is_no_fault(code: FringeCode, share: float) -> None:
    """Beyond, noise looks like fringes in a few pixels; and a projector's gamma does not average out over part of a
    fringe.
    """
    frames, rng = scan(code, gamma=1.8), np.random.default_rng(8)
    dark = frames[..., round(share * HEIGHT) :, :]
    dark[...] = np.clip(np.rint(rng.normal(12, 2, dark.shape)), 0, 255)
    found, diagnosis = look(frames, code)
    assert not diagnosis.named
    assert found[0].judged > 1000
    assert found[0].deviation < 0.6
    assert not found[0].odd


@pytest.mark.parametrize("code", CODES)
@pytest.mark.parametrize("flicker", [0.0, 0.02])
def test_sound_frames_are_sound(code: FringeCode, flicker: float) -> None:
    light = 1 + flicker * np.sin(2.1 * np.arange(code.frames))
    frames = np.clip(np.rint(scan(code) * light[None, :, None, None]), 0, 255).astype(np.uint8)
    found, diagnosis = look(frames, code)
    assert not diagnosis.named
    assert found[0].judged > 1000
    assert found[0].contradictory < 0.01
    assert not found[0].odd


def test_the_usual_share_tells_sound_from_wrong() -> None:
    frames = scan(USUAL, gamma=1.0)
    assert contradictory_share(decode_phase(frames, USUAL, SIZE).flags) < 0.005
    frames[0, 2] = frames[0, 1]
    assert contradictory_share(decode_phase(frames, USUAL, SIZE).flags) > 0.2


@pytest.mark.parametrize("frame", range(USUAL.frames))
def test_each_frame_that_repeats_another_is_named(frame: int) -> None:
    frames = scan(USUAL)
    other = (frame + 5) % USUAL.frames
    frames[0, frame] = frames[0, other]
    faults = look(frames, USUAL)[1].faults
    assert [(fault.frame, fault.look, fault.other) for fault in faults] == [(frame, "same", other)]


def black(picture: NDArray) -> NDArray:
    return picture * 0 + 3


def bright(picture: NDArray) -> NDArray:
    return np.clip(picture * 1.4, 0, 255)


def dim(picture: NDArray) -> NDArray:
    return picture * 0.6


@pytest.mark.parametrize("code", CODES[:4])
@pytest.mark.parametrize(("change", "name"), [(black, "dark"), (bright, "brighter"), (dim, "darker")])
def test_a_frame_of_other_brightness_is_named(
    code: FringeCode, change: Callable[[NDArray], NDArray], name: str
) -> None:
    frames = scan(code)
    frames[0, code.steps + 1] = np.rint(change(frames[0, code.steps + 1].astype(float)))
    faults = look(frames, code)[1].faults
    assert [(fault.frame, fault.look, fault.rows) for fault in faults] == [(code.steps + 1, name, (None, None))]


@pytest.mark.parametrize("pixels", [0.4, 1.0, 130.0])
def test_a_frame_that_moved_is_neither_of_other_brightness_nor_without_fringes(pixels: float) -> None:
    frames = scan(USUAL)
    columns = np.arange(WIDTH)
    for row in frames[0, 5]:
        row[:] = np.rint(np.interp((columns - pixels) % (WIDTH - 1), columns, row))
    (fault,) = look(frames, USUAL)[1].faults
    assert (fault.frame, fault.look) == (5, "other")


@pytest.mark.parametrize("lit", [True, False])
def test_a_frame_that_shows_only_the_skin_or_nothing_has_no_fringes(lit: bool) -> None:
    frames = scan(USUAL)
    frames[0, 5] = frames[0, :4].mean(0) if lit else 90
    (fault,) = look(frames, USUAL)[1].faults
    assert (fault.frame, fault.look) == (5, "flat")


@pytest.mark.parametrize("code", CODES[:4])
@pytest.mark.parametrize("row", [60, 150, 250])
def test_a_torn_frame_is_named_with_its_row(code: FringeCode, row: int) -> None:
    frames = scan(code)
    frames[0, 3, row:] = frames[0, 4, row:]
    (fault,) = look(frames, code)[1].faults
    assert (fault.frame, fault.look, fault.other) == (3, "same", 4)
    assert fault.rows[1] is None
    # Along the fringes a phase changes by less than a quarter of a turn within some rows.
    assert fault.rows[0] == pytest.approx(row, abs=2 if code.axis == "x" else 8)


@pytest.mark.parametrize("code", CODES)
def test_a_frame_that_is_wrong_in_a_small_part_is_named_with_its_rows(code: FringeCode) -> None:
    frames = scan(code)
    lamp = np.zeros((HEIGHT, WIDTH))
    lamp[100:190, 195:275] = 50
    frames[0, 3] = np.clip(frames[0, 3] + lamp, 0, 255)
    found, diagnosis = look(frames, code)
    assert found[0].odd
    assert 3 in [fault.frame for fault in diagnosis.faults]
    assert diagnosis.either or len(diagnosis.faults) == 1


def test_a_wrong_frame_of_one_exposure_is_named() -> None:
    frames = scan(USUAL, exposures=(0.4, 1.0))
    frames[0, 7] = frames[1, 7]
    (fault,) = look(frames, USUAL)[1].faults
    assert (fault.frame, fault.look, fault.other) == (7, "same", 12 + 7)


def test_a_count_without_fringes_is_named() -> None:
    frames = scan(USUAL)
    frames[0, 4:8] = np.random.default_rng(2).integers(2, 5, frames[0, 4:8].shape)
    faults = look(frames, USUAL)[1].faults
    assert [(fault.frame, fault.look) for fault in faults] == [(p, "dark") for p in (4, 5, 6, 7)]


ORDERS = {
    "listed as text is sorted": sorted(range(12), key=lambda i: str(i + 1)),
    "listed as text is sorted (": sorted(range(12), key=str),
    "taken for the one before it: they are late by one": [0, *range(11)],
    "late by one": [11, *range(11)],
    "begins at frame 6": [(i + 5) % 12 for i in range(12)],
    "one was left out": [*range(1, 12), 11],
    "from frame 6 on: they are late": [0, 1, 2, 3, 4, 4, 5, 6, 7, 8, 9, 10],
    "counts in the order 64, 70, 59": [4, 5, 6, 7, 0, 1, 2, 3, 8, 9, 10, 11],
    "in reverse order": [3, 2, 1, 0, 7, 6, 5, 4, 11, 10, 9, 8],
    "beginning at step 2": [1, 2, 3, 0, 5, 6, 7, 4, 9, 10, 11, 8],
    "all counts of a step one after the other": [0, 4, 8, 1, 5, 9, 2, 6, 10, 3, 7, 11],
    "frame 4 and frame 8 of the list are exchanged": [0, 1, 2, 7, 4, 5, 6, 3, 8, 9, 10, 11],
}


@pytest.mark.parametrize("said", ORDERS)
def test_another_order_is_told(said: str) -> None:
    frames = scan(USUAL)[:, ORDERS[said]]
    order = look(frames, USUAL)[1].order
    assert order is not None
    assert said in order.what


@pytest.mark.parametrize("steps", [(0, 3, 2, 1), (1, 2, 3, 0)])
def test_steps_that_contradict_gray_code_are_told(steps: tuple[int, ...]) -> None:
    code = CODES[-1]
    frames = scan(code)
    frames[:, :4] = frames[:, list(steps)]
    found, diagnosis = look(frames, code)
    assert found[0].contradictory > 0.4
    assert diagnosis.order is not None
    assert "step" in diagnosis.order.what


def test_a_count_that_is_not_what_was_shown_contradicts_gray_code() -> None:
    shown, declared = CODES[-1], FringeCode("x", 4, (60,), GrayCode(128, True))
    found, diagnosis = look(scan(shown), declared)
    assert found[0].contradictory > 0.3
    assert not diagnosis.faults


def test_frames_of_noise_are_odd_and_not_named() -> None:
    frames = np.random.default_rng(3).integers(0, 200, (1, 12, HEIGHT, WIDTH), np.uint8)
    found, diagnosis = look(frames, USUAL)
    assert not diagnosis.named
    assert found[0].judged == 0 or found[0].odd


@pytest.mark.parametrize("level", [0, 3, 255])
def test_frames_of_one_level_say_nothing(level: int) -> None:
    frames = np.full((1, 12, HEIGHT, WIDTH), level, np.uint8)
    noise = estimate_noise(frames, USUAL, 254.0)
    sample = sample_frames(frames, USUAL, noise)
    found = frame_consistency(sample, 0)
    assert (found.judged, found.odd) == (0, False)
    assert not diagnose_frames(sample, [found]).named


def letters(v: NDArray, u: NDArray, shift: float) -> NDArray:
    inside = (v > 40) & (v < 56) & (u > 200) & (u < 260)
    return np.where(inside, 1 - 0.6 * np.cos(2 * np.pi * (u + shift) / 7), 1)


def end_along_rows(v: NDArray, _: NDArray, shift: float) -> NDArray:
    """A row of the grid lies wholly in the panel's blurred end."""
    return 1 / (1 + np.exp((v - 198.2 + 0.3 * shift) / 0.6))


@pytest.mark.parametrize("edge", [letters, end_along_rows])
def test_edges_that_shake_are_not_odd(edge: Callable[[NDArray, NDArray, float], NDArray]) -> None:
    """Pixels at edges tell of no wrong frame: few that scatter far, and a whole row of them."""
    rng = np.random.default_rng(11)
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    clean = clean_frames(ramp(HEIGHT, WIDTH, SIZE), USUAL, SIZE, np.full(u.shape, 80.0), np.full(u.shape, 60.0), 1.0)
    shifts = rng.normal(0, 0.4, USUAL.frames)
    shaken = np.stack([frame * edge(v, u, shift) for frame, shift in zip(np.asarray(clean), shifts, strict=True)])
    (found,), _ = look(recorded(shaken, rng, 2.0, (1.0,)), USUAL)
    print(found)
    assert not found.odd
    assert found.judged > 1000

"""What the frames of an unknown capture show."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from metrology.errors import SceneError
from metrology.frame_kinds import runs_of, sample
from metrology.fringe import FringeCode, GrayCode

SIDE = 256


def shown(*codes: FringeCode | str, gamma: float = 1.0, object_from: float = 0.15) -> list[NDArray[np.uint8]]:
    """Frames of an object that fills a part of the picture, the code's columns being the picture's.

    Of a code with fringes and Gray code, the frames with its stripes first.
    """
    rng = np.random.default_rng(4)
    levels: list[NDArray] = []
    for code in codes:
        if isinstance(code, str):
            levels.append(np.full((SIDE, SIDE), 1.0 if code == "white" else 0.0))
        else:
            patterns = list(np.broadcast_to(code.patterns(SIDE, SIDE), (code.frames, SIDE, SIDE)))
            levels += patterns[code.fringe_frames :] + patterns[: code.fringe_frames]
    there = np.zeros((SIDE, SIDE))
    there[40:220, int(object_from * SIDE) : 230] = np.linspace(0.5, 1.0, 230 - int(object_from * SIDE))
    return [
        np.clip(np.rint(5 + 200 * there * level**gamma + rng.normal(0, 1, there.shape)), 0, 255).astype(np.uint8)
        for level in levels
    ]


def told(frames: list[NDArray[np.uint8]]) -> list[tuple[object, ...]]:
    return [(run.kind, run.axis, run.frames, run.steps, run.inverse) for run in runs_of(sample(frames))]


@pytest.mark.parametrize("axis", ["x", "y"])
def test_print_on_the_object_is_no_stripe(axis: str) -> None:
    """Bands of print change more pixels than the borders of coarse bits do, and along the other axis."""
    code = FringeCode(axis, 4, (32,), GrayCode(64))
    frames = shown(code)
    bands = np.where(np.arange(SIDE) // 4 % 2, 1.0, 0.7)
    printed = [(frame * (bands[:, None] if axis == "x" else bands)).astype(np.uint8) for frame in frames]
    assert told(printed) == [("gray", axis, 6, (), False), ("fringes", axis, 4, (4,), False)]


@pytest.mark.parametrize("steps", [(4, 4, 4), (16, 8), (3, 3, 3), (12, 5, 4)])
def test_steps_are_told_by_the_sinusoids(steps: tuple[int, ...]) -> None:
    code = FringeCode("x", steps, (9, 8, 7)[: len(steps)])
    expected = [("fringes", "x", sum(steps), steps, False)]
    assert told(shown(code)) == expected
    assert told(shown(code, gamma=2.0)) == expected


def test_fringes_stripes_and_references_are_told_apart() -> None:
    both = ("white", None, 1, (), False), ("black", None, 1, (), False)
    code = FringeCode("x", 4, (16,), GrayCode(32))
    parts = ("gray", "x", 5, (), False), ("fringes", "x", 4, (4,), False)
    assert told(shown("white", "black", code)) == [*both, *parts]
    # Where the object is, the coarsest bits are all bright and all dark.
    assert told(shown(code, object_from=0.55)) == [*parts]
    inverse = [FringeCode(axis, 4, (), GrayCode(64, True)) for axis in ("x", "y")]
    assert told(shown(*inverse, "white", "black")) == [
        ("gray", "x", 12, (), True), ("gray", "y", 12, (), True), *both,
    ]  # fmt: skip


def blurred(frames: list[NDArray[np.uint8]], px: float) -> list[NDArray[np.uint8]]:
    return [np.rint(gaussian_filter(frame.astype(float), px)).astype(np.uint8) for frame in frames]


@pytest.mark.parametrize("px", [0.8, 1.5])
def test_the_finest_stripes_are_no_fringes_where_they_are_blurred(px: float) -> None:
    """Three frames always make a sinusoid, and three bits are three frames."""
    alone = FringeCode("x", 0, (), GrayCode(64))
    assert told(blurred(shown(alone), px)) == [("gray", "x", 6, (), False)]
    both = FringeCode("x", 4, (8,), GrayCode(64))
    assert told(blurred(shown(both), px)) == [("gray", "x", 6, (), False), ("fringes", "x", 4, (4,), False)]


def test_pictures_without_a_pattern_are_none() -> None:
    with pytest.raises(SceneError, match="change from frame to frame"):
        runs_of(sample([np.full((64, 64), 80, np.uint8)] * 5))

"""Gray code: with narrow and wide stripes, with and without inverse frames, blurred borders."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from metrology.decode import decode_phase
from metrology.errors import SceneError
from metrology.fringe import FringeCode, GrayCode
from tests.support.rendered_fringes import clean_frames, ramp, recorded

SIZE = 1280


@pytest.mark.parametrize("inverse", [True, False])
@pytest.mark.parametrize(("counts", "stripes"), [((64,), 128), ((64,), 64), ((40,), 80), ((40,), 40), ((60, 40), 1280)])
def test_orders_are_right_everywhere(
    counts: tuple[int, ...], stripes: int, inverse: bool, rng: np.random.Generator
) -> None:
    code = FringeCode("x", 4, counts, GrayCode(stripes, inverse))
    truth = ramp(60, 1400, SIZE)
    clean = clean_frames(truth, code, SIZE, 110, 80)
    # The lens blurs the stripes' borders over a few pixels.
    clean = np.stack([cv2.GaussianBlur(frame, (0, 0), 1.0) for frame in clean])
    view = decode_phase(recorded(clean, rng, 2.0), code, SIZE)
    error = view.coordinate[3:-3, 3:-3] - truth[3:-3, 3:-3]
    assert np.isfinite(error).all()
    assert np.abs(error).max() < SIZE / max(counts) / 2


def test_stripes_along_y_and_several_exposures(rng: np.random.Generator) -> None:
    code = FringeCode("y", 4, (32,), GrayCode(32, True))
    truth = ramp(60, 1400, SIZE).T
    times = (0.3, 1.0, 3.0)
    frames = recorded(clean_frames(truth, code, SIZE, 110, 80), rng, 2.0, times)
    view = decode_phase(frames, code, SIZE, times)
    assert np.abs(view.coordinate - truth).max() < 1.0


def test_patterns_follow_the_fringes() -> None:
    code = FringeCode("x", 4, (60, 40), GrayCode(120, True))
    patterns = code.patterns(SIZE, 8)
    assert patterns.shape == (code.frames, 8, SIZE) == (8 + 14, 8, SIZE)
    np.testing.assert_array_equal(patterns[8] + patterns[9], 1.0)
    # Neighbouring stripes differ in one bit only.
    assert np.abs(np.diff(patterns[8::2, 0], axis=1)).sum(0).max() == 1


def test_too_few_stripes_are_refused() -> None:
    with pytest.raises(SceneError, match="at least 64"):
        FringeCode("x", 4, (64,), GrayCode(32))

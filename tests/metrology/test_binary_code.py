"""Plain binary in place of Gray code: the same borders, whatever bits cross together."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from metrology.binary_code import binary_from_gray, gray_from_binary
from metrology.fringe import FringeCode, GrayCode
from metrology.gray import stripe_numbers

CODES = [
    FringeCode("x", 0, (), GrayCode(64, True)),
    FringeCode("x", 0, (), GrayCode(64, False, True)),
    FringeCode("x", 3, (32,), GrayCode(64)),
]


def levels(code: FringeCode, blur: float, sigma: float, binary: bool) -> np.ndarray:
    """(1, frames, 40, 640) levels of a projector of 640 pixels, one to one, blurred by a normal distribution."""
    fine = np.arange(6400) / 10 - 0.45
    lines = code.lines((fine + 0.5) / 640)
    lines = binary_from_gray(lines, code) if binary else lines
    reach = np.arange(-60, 61) / 10
    weight = np.diff(ndtr(np.append(reach, 6.1) / blur))
    seen = np.array([np.convolve(line, weight / weight.sum(), "same")[5::10] for line in lines])
    noise = np.random.default_rng(7).normal(0, sigma, (len(lines), 40, 640))
    return np.clip(np.rint(30 + 180 * seen[:, None] + noise), 0, 255).astype(np.uint8)[None]


@pytest.mark.parametrize("code", CODES)
def test_bits_count_plainly(code: FringeCode) -> None:
    lines = binary_from_gray(code.lines((np.arange(640) + 0.5) / 640), code)
    gray = code.gray
    assert gray is not None
    bits = lines[code.fringe_frames : code.fringe_frames + gray.stripe_frames : 2 if gray.inverse else 1]
    np.testing.assert_array_equal(2.0 ** np.arange(5, -1, -1) @ bits, np.arange(640) // 10)


@pytest.mark.parametrize("code", CODES)
def test_frames_become_those_of_gray_code(code: FringeCode) -> None:
    """Numbers are right but within a pixel of borders, where noise decides, and are off by one there."""
    gray = code.gray
    assert gray is not None
    turned = gray_from_binary(levels(code, 0.8, 2.0, True), code)[0].astype(float)
    first = code.fringe_frames
    stripes = turned[first : first + gray.stripe_frames]
    middle = turned[-2:].mean(0) if gray.references else turned[: code.fringe_frames].mean(0) if code.counts else None
    swing = stripes[::2] - stripes[1::2] if middle is None else stripes - middle
    number, true = stripe_numbers(swing > 0), np.arange(640) // 10
    assert np.abs(number - true)[:, 5:-5].max() <= 1
    clear = (np.arange(640) % 10 > 1) & (np.arange(640) % 10 < 8)
    np.testing.assert_array_equal(number[:, clear], np.broadcast_to(true, number.shape)[:, clear])


def test_borders_stay_where_they_are() -> None:
    """The bit that crosses alone in Gray code has the levels of the highest one that crosses in plain binary."""
    code = CODES[0]
    plain, turned = (f[0].astype(float) for f in (levels(code, 0.8, 0.0, False), levels(code, 0.8, 0.0, True)))
    found = gray_from_binary(turned[None].astype(np.uint8), code)[0].astype(float)
    swings = [0.5 * (f[::2] - f[1::2])[:, 0] for f in (plain, found)]
    border = np.abs(swings[0]) < 60  # where a bit of Gray code is crossing
    assert border.sum() > 60
    np.testing.assert_allclose(swings[1][border], swings[0][border], atol=1.0)

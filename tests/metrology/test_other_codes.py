"""Codes of other programs: phase offsets, other steps per count, stripes' borders anywhere, Gray code alone."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.decode import decode_phase
from metrology.errors import SceneError
from metrology.fringe import FringeCode, GrayCode
from metrology.reconstruct import coordinate_size, decode, triangulate
from metrology.robust import MAD
from tests.support.rendered_fringes import (
    PLANE_DISTANCE,
    PLANE_NORMAL,
    plane_depth,
    ramp,
    recorded,
    seen_coordinate,
    small_rig,
)

SIZE = 1280


def frames_of(
    code: FringeCode, coordinate: NDArray, size: int, rng: np.random.Generator, sigma: float = 1.5
) -> NDArray:
    """(1, frames, h, w) what a camera records: the patterns at a coordinate, taken between the projector's pixels."""
    fine = 8
    shown = FringeCode(
        code.axis, code.steps, code.counts, code.gray, code.phase_offsets_rad, (code.size_px or size) * fine
    )
    lines = shown.patterns(size * fine, 1)[:, 0] if code.axis == "x" else shown.patterns(1, size * fine)[:, :, 0]
    places = np.clip(np.rint((coordinate + 0.5) * fine - 0.5).astype(int), 0, size * fine - 1)
    levels = 30 + 160 * lines[:, places]
    return recorded(np.stack([cv2.GaussianBlur(frame, (0, 0), 0.7) for frame in levels]), rng, sigma)


@pytest.mark.parametrize(
    "code",
    [
        FringeCode("x", 4, (70, 64, 59), None, (0.5, 0.5, 0.5)),
        FringeCode("x", 4, (70, 64, 59), None, (0.3, 1.7, -2.0)),
        FringeCode("x", (3, 4, 12), (1, 8, 64)),
        FringeCode("x", (12, 4, 3), (70, 64, 59), None, (-np.pi / 2,) * 3),
        FringeCode("x", 4, (84, 72, 67), None, (), 1400),
        FringeCode("x", 4, (64,), GrayCode(64, shift=0.25), (1.0,)),
        FringeCode("x", 4, (64,), GrayCode(64, True, shift=0.5)),
        FringeCode("x", 8, (64,), GrayCode(128, references=True, shift=-0.3), (0.7,)),
    ],
    ids=str,
)
def test_the_coordinate_is_right_everywhere(code: FringeCode, rng: np.random.Generator) -> None:
    truth = ramp(40, 1400, SIZE)
    view = decode_phase(frames_of(code, truth, SIZE, rng), code, code.size_px or SIZE)
    inner = np.s_[3:-3, 3:-3]
    error = (view.coordinate - truth)[inner]
    assert np.isfinite(error).mean() > 0.995
    assert np.nanmax(np.abs(error)) < SIZE / max(code.counts) / 2
    assert np.nanstd(error) < 0.2


@pytest.mark.parametrize("gray", [GrayCode(320, True), GrayCode(320, False, True), GrayCode(320, True, True)], ids=str)
@pytest.mark.parametrize("turned", [False, True])
def test_gray_code_alone_tells_parts_of_a_stripe(gray: GrayCode, turned: bool, rng: np.random.Generator) -> None:
    code = FringeCode("y" if turned else "x", 0, (), gray)
    truth = ramp(60, 1400, SIZE)
    truth = truth.T if turned else truth
    view = decode_phase(frames_of(code, truth, SIZE, rng), code, SIZE)
    inner = np.s_[:, 8:-8] if not turned else np.s_[8:-8]
    error, sigma = (view.coordinate - truth)[inner], view.sigma[inner]
    assert np.isfinite(error).all()
    assert np.abs(error).max() < SIZE / gray.stripes  # a stripe
    assert np.sqrt(np.mean(error**2)) < 0.1 * SIZE / gray.stripes
    assert 0.5 < np.median(sigma) / np.sqrt(np.mean(error**2)) < 2.0


@pytest.mark.parametrize(
    "code",
    [
        FringeCode("x", 4, (7, 6, 5), None, (0.4, 0.4, 0.4)),
        FringeCode("x", (3, 4, 8), (1, 5, 20)),
        FringeCode("x", 4, (16,), GrayCode(16, True, shift=0.4)),
        FringeCode("x", 0, (), GrayCode(160, True)),
    ],
    ids=str,
)
def test_a_rig_without_a_projector_measures_the_same_plane(code: FringeCode, rng: np.random.Generator) -> None:
    whole = small_rig()
    rig = type(whole)(whole.id, whole.calibrated_at, whole.left, whole.right)
    views = []
    for device in (rig.left, rig.right):
        seen = seen_coordinate(whole, plane_depth(device, PLANE_NORMAL, PLANE_DISTANCE), "x")
        lit = np.isfinite(seen)
        frames = frames_of(code, np.where(lit, seen, 0), whole.with_projector().width, rng)
        views.append(decode(np.where(lit, frames, 4).astype(np.uint8), code, coordinate_size(rig, code)))
    found = triangulate(views[0], views[1], rig)
    off = (found.points @ PLANE_NORMAL - PLANE_DISTANCE)[found.flags == 0]
    assert len(off) > 0.3 * found.flags.size
    assert abs(np.median(off)) < 0.1
    assert np.quantile(np.abs(off), 0.99) < (3.0 if not code.counts else 1.5)


@pytest.mark.parametrize(
    "gray", [GrayCode(80, True), GrayCode(320, True), GrayCode(160), GrayCode(160, False, True)], ids=str
)
@pytest.mark.parametrize("noise", [1.0, 4.0])
def test_sigma_of_gray_code_alone_is_what_is_observed(gray: GrayCode, noise: float, rng: np.random.Generator) -> None:
    """On a bent surface, with borders sharper than the camera's pixels: course and pixels must not count as noise."""
    code = FringeCode("x", 0, (), gray)
    u = np.arange(620.0) * np.ones((90, 1))
    truth = 20 + 0.45 * u + 1.5e-4 * (u - 300) ** 2 + 0.02 * np.arange(90.0)[:, None]
    lines = replace(code, size_px=320 * 32).patterns(320 * 32, 1)[:, 0]
    blurred = cv2.GaussianBlur(lines, (0, 0), sigmaX=0.7 * 0.45 * 32, sigmaY=1e-6)  # by the lens, before pixels see it
    places = np.rint((truth + 0.5) * 32 - 0.5).astype(int)
    view = decode_phase(recorded(30 + 160 * blurred[:, places], rng, noise), code, 320)
    normal = ((view.coordinate - truth) / view.sigma)[8:-8, 40:-40]
    normal = normal[np.isfinite(normal)]
    assert 0.75 < MAD * np.median(np.abs(normal)) < 1.25
    assert view.noise is not None
    assert view.noise.sigma(100) == pytest.approx(noise, rel=0.15)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("x", (4, 4), (7, 6, 5)), "found 2 of them, expected one or 3"),
        (("x", (4, 2, 4), (7, 6, 5)), "found 2, expected at least 3"),
        (("x", 4, (7, 6, 5), None, (0.1, 0.2)), "phase offsets"),
        (("x", 0, ()), "fringe counts"),
        (("x", 4, (7, 6), None, (), 0), "fringe size"),
    ],
)
def test_codes_that_contradict_themselves_are_refused(arguments: tuple, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        FringeCode(*arguments)

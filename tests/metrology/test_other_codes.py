"""Codes of other programs: phase offsets, other steps per count, stripes' borders anywhere, Gray code alone."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.code_guess import guess_code
from metrology.decode import decode_phase
from metrology.errors import SceneError
from metrology.fringe import FringeCode, GrayCode
from metrology.reconstruct import coordinate_size, decode, triangulate
from metrology.rig import Device, Rig
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


def larger(device: Device, times: int) -> Device:
    K = device.K.copy()
    K[:2] *= times
    return replace(device, width=device.width * times, height=device.height * times, K=K)


def stripes_on_the_plane(
    rig: Rig, gray: GrayCode, rng: np.random.Generator, native: int | None = None
) -> Reconstruction:
    """The plane in both cameras under Gray code alone, blurred; `native`: columns that the projector really has."""
    assert rig.projector is not None
    code, fine, size = FringeCode("x", 0, (), gray), 32, rig.projector.width
    lines = replace(code, size_px=size * fine).patterns(size * fine, 1)[:, 0]
    if native:
        nearest = ((np.arange(native) + 0.5) * size / native * fine).astype(int)
        lines = np.repeat(lines[:, nearest], size * fine // native, 1)
    views = []
    for device in (rig.left, rig.with_right()):
        seen = seen_coordinate(rig, plane_depth(device, PLANE_NORMAL, PLANE_DISTANCE), "x")
        pitch = float(np.nanmedian(np.diff(seen, axis=1)))
        blurred = cv2.GaussianBlur(lines.astype(np.float32), (0, 0), sigmaX=0.7 * pitch * fine, sigmaY=1e-6)
        places = np.rint((np.nan_to_num(seen) + 0.5) * fine - 0.5).astype(int)
        levels = np.where(np.isfinite(seen), 30 + 160 * blurred[:, np.clip(places, 0, lines.shape[1] - 1)], 4)
        views.append(decode(recorded(levels, rng, 0.5), code, coordinate_size(rig, code)))
    return triangulate(views[0], views[1], rig)


@pytest.mark.parametrize("gray", [GrayCode(960, True), GrayCode(120)], ids=str)
def test_depths_of_gray_code_alone_scatter_as_sigma_says(gray: GrayCode, rng: np.random.Generator) -> None:
    """Little noise, so that the pixels' grid rules; and stripes narrower than pixels, of which the finest bit goes."""
    small = small_rig()
    rig = replace(small, left=larger(small.left, 2), right=larger(small.with_right(), 2),
                  projector=larger(small.with_projector(), 3))  # fmt: skip
    found = stripes_on_the_plane(rig, gray, rng)
    good = found.flags == 0
    assert good.mean() > 0.9
    error = found.points[..., 2] - plane_depth(rig.left, PLANE_NORMAL, PLANE_DISTANCE)[..., 2]
    assert 0.9 < MAD * np.median(np.abs(error[good] / found.sigma_z[good])) < 1.1


def test_borders_that_the_projector_displaces_are_no_error_of_the_depth(rng: np.random.Generator) -> None:
    """A pattern of 960 columns on a projector of 640: stripes of 3, 3 and 2 of its pixels."""
    small = small_rig()
    rig = replace(small, left=larger(small.left, 2), right=larger(small.with_right(), 2),
                  projector=larger(small.with_projector(), 3))  # fmt: skip
    found = stripes_on_the_plane(rig, GrayCode(240, True), rng, native=640)
    good = found.flags == 0
    error = found.points[..., 2] - plane_depth(rig.left, PLANE_NORMAL, PLANE_DISTANCE)[..., 2]
    normal = error[good] / found.sigma_z[good]
    assert 0.7 < np.std(normal) < 1.4


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


def test_offsets_are_no_better_told_than_the_pixels_agree() -> None:
    """Counts 40 and 41 multiply errors of a phase by 40; fractions that differ by so much say no odd offset."""
    v, u = np.mgrid[:40, :400]
    place = (u + 0.5) / 400

    def frames(off: float, wave: float) -> NDArray[np.uint8]:
        error = off + wave * np.sin(2 * np.pi * v / 20)  # turns
        levels = []
        for count, steps, moved in ((40, 16, 0.0), (41, 8, error)):
            for step in range(steps):
                levels.append(100 + 80 * np.cos(2 * np.pi * (count * place + moved + step / steps)))
        return np.rint(levels).astype(np.uint8)

    code = FringeCode("x", (16, 8), (40, 41))
    rough, smooth = (guess_code(frames(0.0012, wave), code, 250) for wave in (0.0028, 0.0))
    assert rough.code.phase_offsets_rad == ()
    assert not rough.others
    assert smooth.code.phase_offsets_rad != ()
    assert rough.agreement < 0.92 < smooth.agreement


def test_bits_of_gray_code_are_no_fringes_of_one_stripe_each() -> None:
    """Of eight bits, the finest three taken for three steps of as many fringes as the coarse ones have stripes."""
    bits = FringeCode("x", 0, (), GrayCode(256)).patterns(1024, 1).reshape(8, 1, -1)
    frames = np.rint(20 + 200 * np.broadcast_to(bits, (8, 64, 1024))).astype(np.uint8)
    taken = np.concatenate([frames[5:], frames[:5]])
    with pytest.raises(SceneError, match="do not fit each other"):
        guess_code(taken, FringeCode("x", 3, (32,), GrayCode(32)), 250)


def test_white_and_black_that_are_exchanged_are_refused() -> None:
    code = FringeCode("x", 0, (), GrayCode(32, False, True))
    shown = np.broadcast_to(code.patterns(640, 1).reshape(7, 1, -1), (7, 64, 640))
    frames = np.rint(20 + 200 * shown).astype(np.uint8)
    assert guess_code(frames, code, 250).agreement == pytest.approx(1)
    with pytest.raises(SceneError, match="darker than the all-black one"):
        guess_code(frames[[0, 1, 2, 3, 4, 6, 5]], code, 250)

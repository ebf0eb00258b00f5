"""Decoding one view: agreement with a plain numpy twin, the Cramér-Rao bound, order slips, saturation, invariances."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.cloud import PixelFlag
from metrology.decode import decode_phase
from metrology.errors import SceneError
from metrology.fringe import FringeCode
from metrology.noise import NoiseModel
from metrology.reconstruction_settings import ReconstructionSettings
from metrology.saturation import saturation_level
from tests.support.rendered_fringes import USUAL, clean_frames, ramp, recorded

SIZE = 1280


def twin(frames: NDArray, code: FringeCode, exposures: tuple[float, ...], noise: NoiseModel) -> tuple[NDArray, NDArray]:
    """Coordinate and σ of every pixel by least squares over the unsaturated samples and exhaustive search of orders."""
    step = 2 * np.pi * np.arange(code.steps) / code.steps
    design = np.stack([np.cos(step), -np.sin(step)])
    count = len(code.counts)
    samples = frames.reshape(len(exposures), count, code.steps, -1).astype(float)
    used = samples < 254.0
    phase, weight = [], []
    for k in range(count):
        matrix, right = 0.0, 0.0
        for e, time in enumerate(exposures):
            mask = used[e, k]
            number = np.maximum(mask.sum(0), 1)
            mean = (samples[e, k] * mask).sum(0) / number
            d = (design[:, :, None] - (design[:, :, None] * mask).sum(1, keepdims=True) / number) * mask
            variance = noise.read_variance + noise.gain * mean
            matrix = matrix + np.einsum("p,isp,jsp->pij", time**2 / variance, d, d)
            right = right + np.einsum("p,isp,sp->pi", time / variance, d, samples[e, k] - mean)
        phasor = np.linalg.solve(matrix, right[..., None])[..., 0]
        across = np.stack([-phasor[:, 1], phasor[:, 0]], -1)
        power = (phasor**2).sum(-1)
        spread = np.einsum("pi,pij,pj->p", across, np.linalg.inv(matrix), across) / power**2
        phase.append(np.arctan2(phasor[:, 1], phasor[:, 0]) / (2 * np.pi) % 1.0)
        weight.append(1.0 / ((2 * np.pi) ** -2 * spread))
    q, w = np.stack(phase), np.stack(weight)
    f = np.array(code.counts, float)[:, None]
    best, position = np.full(q.shape[1], np.inf), np.zeros(q.shape[1])
    finest = int(np.argmax(code.counts))
    for order in range(code.counts[finest]):
        start = (q[finest] + order) / f[finest]
        whole = q + np.rint(f * start - q)
        # The orthogonal distance, as the lattice has it: all phases alike.
        along = (f * whole).sum(0) / (f**2).sum()
        whole = q + np.rint(f * along - q)
        along = (f * whole).sum(0) / (f**2).sum()
        distance = ((whole - f * along) ** 2).sum(0)
        fused = (w * f * whole).sum(0) / (w * f**2).sum(0)
        better = distance < best
        best[better], position[better] = distance[better], fused[better]
    sigma = SIZE / np.sqrt((w * f**2).sum(0))
    shape = frames.shape[2:]
    return (position.reshape(shape) % 1.0) * SIZE - 0.5, sigma.reshape(shape)


@pytest.mark.parametrize(
    ("steps", "counts", "exposures"),
    [
        (4, (70, 64, 59), (1.0,)),
        (4, (70, 64, 59), (0.25, 1.0, 4.0)),
        (3, (70, 64, 59), (1.0,)),
        (5, (9, 8), (1.0, 2.0)),
        (8, (1, 8, 31, 64), (1.0,)),
        (4, (1,), (1.0,)),
    ],
)
def test_kernel_agrees_with_the_numpy_twin(
    steps: int, counts: tuple[int, ...], exposures: tuple[float, ...], rng: np.random.Generator
) -> None:
    code = FringeCode("x", steps, counts)
    brightness = np.linspace(0.4, 1.3, 12)[:, None]
    clean = clean_frames(ramp(12, 300, SIZE), code, SIZE, 100 * brightness, 80 * brightness)
    frames = recorded(clean, rng, 1.5, exposures)
    noise = NoiseModel(1.5, 0.01)
    view = decode_phase(frames, code, SIZE, exposures, noise=noise)
    good = (view.flags & ~np.uint16(PixelFlag.SATURATED_SAMPLES)) == 0
    assert good.mean() > 0.95
    coordinate, sigma = twin(frames, code, exposures, noise)
    # float32 along the way; counts of one share a saturated pixel's level estimate, hence the tolerance of σ.
    assert np.abs(view.coordinate - coordinate)[good].max() < 2e-3 * max(1.0, 20 / max(counts))
    np.testing.assert_allclose(view.sigma[good], sigma[good], rtol=0.02)


def test_usual_scan_agrees_with_the_general_kernel(rng: np.random.Generator) -> None:
    frames = recorded(clean_frames(ramp(40, 700, SIZE), USUAL, SIZE, 110, 60), rng, 2.0)
    noise = NoiseModel(4.0, 0.0)
    usual = decode_phase(frames, USUAL, SIZE, noise=noise)
    # A second exposure that is saturated throughout adds nothing but takes the general way.
    blown = np.full_like(frames, 255)
    general = decode_phase(np.concatenate([frames, blown]), USUAL, SIZE, (1.0, 10.0), noise=noise)
    np.testing.assert_allclose(usual.coordinate, general.coordinate, atol=5e-4)
    np.testing.assert_allclose(usual.sigma, general.sigma, rtol=0.03)
    np.testing.assert_allclose(usual.modulation, general.modulation, rtol=1e-4)


@pytest.mark.parametrize("modulation", [100.0, 60.0, 40.0])
def test_phase_noise_reaches_the_cramer_rao_bound(modulation: float, rng: np.random.Generator) -> None:
    truth = ramp(400, 700, SIZE)
    view = decode_phase(recorded(clean_frames(truth, USUAL, SIZE, 120, modulation), rng, 2.0), USUAL, SIZE)
    variance = 2.0**2 + 1 / 12
    information = 4 / 2 * modulation**2 / variance * (2 * np.pi / SIZE) ** 2 * sum(n**2 for n in USUAL.counts)
    rms = np.sqrt(np.nanmean((view.coordinate - truth) ** 2))
    assert rms <= 1.02 / np.sqrt(information)
    assert np.nanmean(view.sigma) == pytest.approx(rms, rel=0.03)


@pytest.mark.parametrize(("modulation", "most"), [(30.0, 0.0), (20.0, 3e-4)])
def test_order_slips_are_rare(modulation: float, most: float, rng: np.random.Generator) -> None:
    truth = ramp(900, 1100, SIZE)
    view = decode_phase(recorded(clean_frames(truth, USUAL, SIZE, 60, modulation), rng, 2.0), USUAL, SIZE)
    slipped = np.abs(view.coordinate - truth) > SIZE / 140
    assert slipped.mean() <= most
    assert np.isfinite(view.coordinate).mean() > 0.99


def test_heterodyne_slips_more_often_than_the_lattice(rng: np.random.Generator) -> None:
    truth = ramp(300, 700, SIZE)
    frames = recorded(clean_frames(truth, USUAL, SIZE, 60, 20.0), rng, 2.0)
    slips = {}
    for method in ("ml", "heterodyne"):
        view = decode_phase(frames, USUAL, SIZE, settings=ReconstructionSettings(unwrapping=method))
        slips[method] = float((~(np.abs(view.coordinate - truth) < SIZE / 140)).mean())
    assert slips["ml"] < 0.5 * slips["heterodyne"]


def test_whole_fringes_shift_the_order_and_nothing_else() -> None:
    truth = ramp(20, 500, SIZE)[:, :300]
    fringe = SIZE / 70
    views = [
        decode_phase(recorded(clean_frames(truth + m * fringe, USUAL, SIZE, 120, 90), None), USUAL, SIZE)
        for m in (0, 1, 7)
    ]
    for m, view in zip((1, 7), views[1:], strict=True):
        # Rounding to grey levels differs in the other counts: a hundredth of a pixel.
        np.testing.assert_allclose(view.coordinate - views[0].coordinate, m * fringe, atol=0.03)


def test_order_of_exposures_does_not_matter(rng: np.random.Generator) -> None:
    times = (0.2, 1.0, 5.0)
    frames = recorded(clean_frames(ramp(30, 300, SIZE), USUAL, SIZE, 70, 50), rng, 1.5, times)
    one = decode_phase(frames, USUAL, SIZE, times)
    other = decode_phase(frames[[2, 0, 1]], USUAL, SIZE, (5.0, 0.2, 1.0))
    np.testing.assert_allclose(one.coordinate, other.coordinate, atol=3e-4)
    np.testing.assert_array_equal(one.flags, other.flags)


def test_ambient_light_does_not_bias_the_coordinate() -> None:
    truth = ramp(20, 500, SIZE)
    dark = decode_phase(recorded(clean_frames(truth, USUAL, SIZE, 90, 70), None), USUAL, SIZE)
    bright = decode_phase(recorded(clean_frames(truth, USUAL, SIZE, 130, 70), None), USUAL, SIZE)
    np.testing.assert_allclose(dark.coordinate, bright.coordinate, atol=1e-3)


def test_some_saturated_steps_leave_an_unbiased_coordinate(rng: np.random.Generator) -> None:
    truth = ramp(200, 600, SIZE)
    view = decode_phase(recorded(clean_frames(truth, USUAL, SIZE, 190, 100), rng, 1.0), USUAL, SIZE)
    partial = (view.flags & PixelFlag.SATURATED_SAMPLES) != 0
    usable = partial & np.isfinite(view.coordinate)
    assert partial.mean() > 0.9
    assert usable.sum() > 0.5 * partial.sum()
    error = (view.coordinate - truth)[usable]
    assert abs(np.mean(error)) < 2e-3
    assert np.std(error / view.sigma[usable]) == pytest.approx(1.0, abs=0.12)
    assert ((view.flags[~np.isfinite(view.coordinate)] & PixelFlag.SATURATED) != 0).mean() > 0.9


def test_longer_exposures_rescue_dark_pixels_and_shorter_ones_bright_pixels(rng: np.random.Generator) -> None:
    brightness = np.geomspace(0.1, 8.0, 600)
    truth = ramp(60, 600, SIZE)
    clean = clean_frames(truth, USUAL, SIZE, 60 * brightness, 45 * brightness)
    times = (0.2, 1.0, 5.0)
    fused = decode_phase(recorded(clean, rng, 1.5, times), USUAL, SIZE, times)
    single = decode_phase(recorded(clean, rng, 1.5), USUAL, SIZE)
    assert np.isfinite(fused.coordinate).mean() > 0.99
    assert np.isfinite(single.coordinate).mean() < 0.7
    error = (fused.coordinate - truth) / fused.sigma
    assert np.nanstd(error) == pytest.approx(1.0, abs=0.1)


def test_black_frames_have_no_phase() -> None:
    view = decode_phase(np.zeros((1, 12, 20, 30), np.uint8), USUAL, SIZE)
    assert not np.isfinite(view.coordinate).any()
    assert (view.flags == PixelFlag.LOW_MODULATION).all()


def test_blown_frames_are_saturated() -> None:
    view = decode_phase(np.full((1, 12, 20, 30), 255, np.uint8), USUAL, SIZE)
    assert not np.isfinite(view.coordinate).any()
    assert ((view.flags & PixelFlag.SATURATED) != 0).all()


def test_phases_that_contradict_each_other_are_flagged(rng: np.random.Generator) -> None:
    truth = ramp(40, 400, SIZE)
    frames = recorded(clean_frames(truth, USUAL, SIZE, 120, 90), rng, 1.0)
    # The third count's phase is off by a fifth of a fringe: no position explains all three.
    shifted = clean_frames(truth + 0.05 * SIZE / 59, USUAL, SIZE, 120, 90)
    frames[0, 8:] = recorded(shifted, rng, 1.0)[0, 8:]
    view = decode_phase(frames, USUAL, SIZE)
    assert ((view.flags & PixelFlag.ORDER_RESIDUAL) != 0).mean() > 0.95


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_sixteen_bit_frames(bits: int, rng: np.random.Generator) -> None:
    truth = ramp(30, 400, SIZE)
    scale = 2**bits / 256
    levels = clean_frames(truth, USUAL, SIZE, 120, 90) * scale + rng.normal(0, 0.5 * scale, (12, *truth.shape))
    levels[:, 0, 0] = 2**bits - 1
    frames = np.rint(levels).astype(np.uint16)[None]
    assert saturation_level(frames) == pytest.approx((2**bits - 1) * 254 / 255)
    view = decode_phase(frames, USUAL, SIZE)
    assert np.nanstd((view.coordinate - truth) / view.sigma) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("shape", [(1, 11, 8, 9), (12, 8, 9)])
def test_frames_of_the_wrong_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(SceneError, match="expected"):
        decode_phase(np.zeros(shape, np.uint8), USUAL, SIZE)


def test_samples_of_the_wrong_kind_are_refused() -> None:
    with pytest.raises(SceneError, match="uint8 or uint16"):
        decode_phase(np.zeros((1, 12, 8, 9), np.float32), USUAL, SIZE)

"""Skin lines smoothed by their neighbours: less noise in the step, honest where slopes change unevenly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrology.results import SeamStation
from metrology.seams.skins.neighbours import smoothed, smoothed_sections
from metrology.seams.skins.sections import Section, SkinLine
from metrology.seams.skins.skin_lines import CLUMPING_MEDIAN
from metrology.seams.skins.step import step_gradient, step_height, with_unresolved_bends
from metrology.surfaces import Frame

HALF_LENGTH = 2.0
S = np.arange(0.0, 160.0, 4.0)
STEP = 0.2


def own_covariance() -> np.ndarray:
    """(5, 5) of both skin lines fitted to points 2 to 14 mm from the seam's middle, 600 on each side, σ 0.01 mm."""
    x = np.linspace(2.0, 14.0, 600)
    a = np.stack([np.ones_like(x), -x, 0 * x, 0 * x, x * x], axis=1)
    b = np.stack([0 * x, 0 * x, np.ones_like(x), x, x * x], axis=1)
    design = np.concatenate([a, b])
    return np.linalg.inv(design.T @ design) * 0.01**2


def seam(
    slopes: np.ndarray, rng: np.random.Generator, rolls: np.ndarray | None = None, step: np.ndarray | float = STEP
) -> list[Section]:
    """Sections of a seam with a step, a kink and a bend; `slopes` (n,) of both skins in a fixed frame.

    Each section's own frame is rolled about the seam, so that it sees the slopes less its roll.
    """
    covariance = own_covariance()
    rolls = np.zeros(len(S)) if rolls is None else rolls
    sections = []
    for s, slope, roll, height in zip(S, slopes, rolls, np.broadcast_to(step, S.shape), strict=True):
        truth = np.array([0.0, slope - roll, height, slope - roll + 0.004, 3e-4])
        line = rng.multivariate_normal(truth, covariance)
        axes = np.array([[1.0, 0, roll], [0, 1, 0], [-roll, 0, 1]]) / np.array([[np.hypot(1, roll)], [1], [1]])
        axes[2] /= np.hypot(1, roll)
        frame = Frame(np.array([0.0, s, 700.0]), axes)
        sections.append(
            Section(frame, SkinLine(line[[0, 1, 4]], 600), SkinLine(line[2:], 600), covariance, 1.0)
        )  # fmt: skip
    return sections


def steps(sections: list[Section]) -> np.ndarray:
    return np.array([step_height(section, -1.0, 1.0) for section in sections])


def sigmas(sections: list[Section]) -> np.ndarray:
    gradient = step_gradient(-1.0, 1.0)
    return np.sqrt([gradient @ section.covariance @ gradient for section in sections])


def errors(
    slopes: np.ndarray, rng: np.random.Generator, step: np.ndarray | float = STEP
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of the step before and after, and after in units of what is stated, of ten seams."""
    before, after, stated = [], [], []
    for _ in range(10):
        own = seam(slopes, rng, step=step)
        better = smoothed(own, S, HALF_LENGTH)
        before.append(steps(own) - step)
        after.append(steps(better) - step)
        stated.append(after[-1] / sigmas(better))
    return np.concatenate(before), np.concatenate(after), np.concatenate(stated)


def test_evenly_changing_slopes_leave_little_but_the_heights_noise(rng):
    before, after, stated = errors(0.01 + 2e-5 * S, rng)
    # Heights alone are known to √(1/6) of the whole; the prediction adds some.
    assert after.std() < 0.62 * before.std()
    assert np.abs(stated).mean() == pytest.approx(np.sqrt(2 / np.pi), rel=0.12)
    assert 0.92 < np.mean(np.abs(stated) < 1.96) < 0.98


def test_waves_that_all_sections_share_are_in_the_step_s_uncertainty(rng):
    # A station's step errs as its own noise lets it, but all in a row by the same amount: residuals hold none of it.
    own = [
        replace(section, clumping=CLUMPING_MEDIAN, stretches=rng.normal(0, 1, 8))
        for section in seam(0.01 + 2e-5 * S, rng, step=STEP)
    ]
    alone = smoothed(own, S, HALF_LENGTH)
    kept, free = (sigmas(found) / sigmas(own) for found in (smoothed_sections(own, S, HALF_LENGTH), alone))
    assert kept**2 == pytest.approx(0.9 * free**2 + 0.1, rel=0.02)


@pytest.mark.parametrize("period_mm", [12.0, 25.0, 50.0])
def test_uneven_slopes_are_left_to_the_station_s_own_points(period_mm, rng):
    # Ten times as uneven as a station's own slope is uncertain.
    wave = 10 * np.sqrt(own_covariance()[1, 1] / 2) * np.sin(2 * np.pi * S / period_mm)
    before, after, stated = errors(wave, rng)
    assert after.std() < 1.05 * before.std()
    assert np.mean(np.abs(stated) < 1.96) > 0.92


def test_an_evenly_changing_step_is_known_better_than_from_a_station_s_own_heights(rng):
    before, after, stated = errors(0.01 + 2e-5 * S, rng, STEP + 5e-4 * S)
    # √(1/6) of the whole is what a station's own heights leave, were all slopes known; with neighbours on both sides:
    inner = np.tile((S > 16) & (S < 140), 10)
    assert after[inner].std() < np.sqrt(1 / 6) * before[inner].std()
    assert np.mean(np.abs(stated) < 1.96) > 0.92


@pytest.mark.parametrize("period_mm", [12.0, 25.0, 50.0])
def test_a_waving_step_is_left_to_the_station_s_own_points(period_mm, rng):
    wave = 10 * sigmas(seam(0 * S, rng))[0] * np.sin(2 * np.pi * S / period_mm)
    _, level, _ = errors(0 * S, rng, STEP + 0 * S)
    _, after, stated = errors(0 * S, rng, STEP + wave)
    # No more than with slopes from the neighbours and heights from the station's own points alone.
    assert after.std() < 2.0 * level.std()
    assert np.mean(np.abs(stated) < 1.96) > 0.92


def test_a_dent_stays_where_it_is(rng):
    dent, dented = 0.01, 20
    step = np.where(np.arange(len(S)) == dented, STEP - dent, STEP)
    after, sigma = [], 0.0
    for _ in range(40):
        better = smoothed(seam(0 * S, rng, step=step), S, HALF_LENGTH)
        after.append(steps(better) - step)
        sigma = max(sigma, sigmas(better)[dented])
    off = np.abs(np.mean(after, axis=0))
    noise = np.std(after, axis=0) / np.sqrt(len(after))
    # Of the dent's depth as little is lost as σ²/|m| says, and what lies around it does not sink with it.
    assert off[dented] < sigma**2 / dent + 3 * noise[dented]
    assert (np.delete(off, dented) < 0.02 * dent + 3.5 * np.delete(noise, dented)).all()


def test_frames_of_their_own_change_nothing(rng):
    slopes, seed = 0.01 + 2e-5 * S, int(rng.integers(1000))
    straight = seam(slopes, np.random.default_rng(seed))
    rolled = seam(slopes, np.random.default_rng(seed), rng.uniform(-0.01, 0.01, len(S)))
    # To second order: 0.2 mm times half the square of a slope of 0.02.
    assert steps(smoothed(rolled, S, HALF_LENGTH)) == pytest.approx(steps(smoothed(straight, S, HALF_LENGTH)), abs=4e-5)


def test_without_neighbours_a_section_stays_as_it_is(rng):
    own = seam(np.zeros(len(S)), rng)
    assert smoothed(own[:3], S[:3], HALF_LENGTH) == own[:3]
    lonely = [section if k == 20 or k < 4 else None for k, section in enumerate(own)]
    better = smoothed(lonely, S, HALF_LENGTH)
    assert [section is None for section in better] == [section is None for section in lonely]
    assert better[20] is own[20]


def test_an_end_without_much_skin_takes_its_slopes_from_the_seam(rng):
    # Side A of the first station shows 3 mm of skin only.
    x_a, x_b = -np.linspace(2.0, 5.0, 150), np.linspace(2.0, 14.0, 600)
    design = np.concatenate([
        np.stack([np.ones_like(x_a), x_a, 0 * x_a, 0 * x_a, x_a * x_a], axis=1),
        np.stack([0 * x_b, 0 * x_b, np.ones_like(x_b), x_b, x_b * x_b], axis=1),
    ])  # fmt: skip
    covariance = np.linalg.inv(design.T @ design) * 0.01**2
    before, after = [], []
    for _ in range(60):
        own = seam(np.full(len(S), 0.01), rng)
        line = rng.multivariate_normal([0.0, 0.01, 0.2, 0.014, 3e-4], covariance)
        own[0] = replace(own[0], a=SkinLine(line[[0, 1, 4]], 150), b=SkinLine(line[2:], 600), covariance=covariance)
        before.append(steps(own[:1])[0])
        after.append(steps(smoothed(own, S, HALF_LENGTH)[:1])[0])
    assert np.std(after) < 0.6 * np.std(before)


def test_a_bent_step_is_uncertain_by_what_the_strip_s_mean_misses():
    s = 2.0 * np.arange(9)
    # Its mean over ±2 mm misses nothing of a slope, and ε_d²/3 of a parabola's factor.
    for step, off in ((0.1 + 0.01 * s, 0.0), (0.1 + 0.002 * s**2, 0.002 * HALF_LENGTH**2 / 3)):
        rows = [
            SeamStation("S01", place, x_mm=0, y_mm=0, z_mm=0, u_px=0, v_px=0, step_mm=value, step_u95_mm=0.001)
            for place, value in zip(s, step, strict=True)
        ]
        rows[0] = replace(rows[0], step_mm=None, step_u95_mm=None)
        u95 = [row.step_u95_mm for row in with_unresolved_bends(rows, 2.0, HALF_LENGTH)]
        assert u95[0] is None
        assert u95[3:7] == pytest.approx([np.hypot(0.001, 1.96 * off)] * 4)
        # Nothing is known of the bend where a neighbour is missing.
        assert u95[1:3] == [0.001, 0.001]
        assert u95[7:] == [0.001, 0.001]

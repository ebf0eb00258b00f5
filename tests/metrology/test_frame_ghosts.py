"""A second picture of the fringes is told by counts that miss each other."""

from __future__ import annotations

import numpy as np
import pytest

from metrology.arrays import Array
from metrology.frame_consistency import frame_consistency
from metrology.frame_sample import sample_frames
from metrology.fringe import FringeCode
from metrology.noise import NoiseModel

WIDE = 1280.0  # projector pixels along the fringe axis
CODE = FringeCode(axis="x", steps=4, counts=(70, 64, 59))


def disagreement(ghost: float, apart: float, noise: float, moved: Array, code: FringeCode = CODE) -> float | None:
    """Of frames of a slanted skin, a displaced ghost of this share, and a skin moved in each frame."""
    rng = np.random.default_rng(3)
    u, v = np.meshgrid(np.arange(600.0), np.arange(400.0))
    at = 120 + 1.6 * u + 0.05 * v + 2e-4 * (u - 300) ** 2

    def lit(frame: int, coordinate: Array) -> Array:
        turns = code.counts[code.count_of[frame]] * coordinate / WIDE
        return np.asarray(110 + 70 * np.cos(2 * np.pi * turns + code.step_angles[frame]))

    frames = [
        lit(k, at + moved[k]) + ghost * lit(k, at + moved[k] + apart) + rng.normal(0, noise, at.shape)
        for k in range(code.frames)
    ]
    levels = np.clip(np.rint(frames), 0, 255).astype(np.uint8)[None]
    return frame_consistency(sample_frames(levels, code, NoiseModel(noise**2, 0.0)), 0).disagreement_rad


def test_a_ghost_leaves_what_its_phasors_add() -> None:
    still = np.zeros(CODE.frames)
    found = disagreement(0.02, 30.0, 1.5, still)
    # Each count's phase is off by ε sin(2π f Δ/W); what no common position explains is what is left.
    counts = np.array(CODE.counts)
    off = 0.02 * np.sin(2 * np.pi * counts * 30.0 / WIDE)
    missed = off - counts * (counts @ off) / (counts @ counts)
    assert found == pytest.approx(np.abs(missed).max(), rel=0.1)


@pytest.mark.parametrize("noise", [0.3, 1.5, 5.0])
def test_sound_frames_and_movement_leave_nothing(noise: float) -> None:
    rng = np.random.default_rng(9)
    assert disagreement(0.0, 0.0, noise, np.zeros(CODE.frames)) == 0
    # 15 µm of the skin's movement are some 0.02 projector pixels from frame to frame.
    moved = disagreement(0.0, 0.0, noise, rng.normal(0, 0.02, CODE.frames))
    assert moved is not None
    assert moved < 0.005


def test_counts_too_coarse_for_a_block_are_not_judged() -> None:
    code = FringeCode(axis="x", steps=4, counts=(64, 8, 1))
    assert disagreement(0.05, 30.0, 1.5, np.zeros(code.frames), code) is None

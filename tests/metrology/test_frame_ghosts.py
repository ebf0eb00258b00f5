"""A second picture of the fringes is told by counts that miss each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrology.arrays import Array
from metrology.frame_consistency import frame_consistency
from metrology.frame_ghosts import Disagreement, beyond_movement, moved_by
from metrology.frame_sample import sample_frames
from metrology.fringe import FringeCode
from metrology.noise import NoiseModel
from simulator.rig import aim_frame, virtual_rig

WIDE = 1280.0  # projector pixels along the fringe axis
CODE = FringeCode(axis="x", steps=4, counts=(70, 64, 59))


def disagreement(
    ghost: float, apart: float, noise: float, moved: Array, code: FringeCode = CODE, lamp: Array | None = None
) -> float | None:
    """What remains beyond noise."""
    found = seen(ghost, apart, noise, moved, code, lamp)
    return None if found is None else found.beyond_noise()


def seen(
    ghost: float, apart: float, noise: float, moved: Array, code: FringeCode = CODE, lamp: Array | None = None
) -> Disagreement | None:
    """Of frames of a slanted skin, a displaced ghost of this share, a skin moved in each frame, an uneven lamp."""
    rng = np.random.default_rng(3)
    u, v = np.meshgrid(np.arange(600.0), np.arange(400.0))
    at = 120 + 1.6 * u + 0.05 * v + 2e-4 * (u - 300) ** 2

    def lit(frame: int, coordinate: Array) -> Array:
        turns = code.counts[code.count_of[frame]] * coordinate / WIDE
        return np.asarray(110 + 70 * np.cos(2 * np.pi * turns + code.step_angles[frame]))

    bright = np.ones(code.frames) if lamp is None else lamp
    frames = [
        bright[k] * (lit(k, at + moved[k]) + ghost * lit(k, at + moved[k] + apart)) + rng.normal(0, noise, at.shape)
        for k in range(code.frames)
    ]
    levels = np.clip(np.rint(frames), 0, 255).astype(np.uint8)[None]
    return frame_consistency(sample_frames(levels, code, NoiseModel(noise**2, 0.0)), 0).disagreement


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


def test_a_lamp_that_flickers_leaves_nothing_and_hides_no_ghost() -> None:
    still, rng = np.zeros(CODE.frames), np.random.default_rng(4)
    for _ in range(5):
        lamp = 1 + rng.normal(0, 0.035, CODE.frames)
        assert disagreement(0.0, 0.0, 0.7, still, lamp=lamp) == 0
        assert disagreement(0.02, 30.0, 0.7, still, lamp=lamp) == pytest.approx(
            disagreement(0.02, 30.0, 0.7, still), rel=0.1
        )


def test_movement_is_what_both_cameras_see() -> None:
    rng = np.random.default_rng(6)
    rig = virtual_rig(rng)
    moved = moved_by(rig, "x")
    assert moved is not None
    nearer_mm = 0.05 * np.repeat([1.0, -1.0, 0.3], 4)
    quiet = [seen(0.0, 0.0, 0.5, share * nearer_mm) for share in moved]
    ghost = seen(0.02, 30.0, 0.5, moved[0] * nearer_mm)
    left, right = quiet
    assert left is not None
    assert right is not None
    assert ghost is not None
    assert min(left.beyond_noise(), right.beyond_noise()) > 0.005
    assert max(beyond_movement(left, right, moved)) < 0.001
    alone = disagreement(0.02, 30.0, 0.5, np.zeros(CODE.frames))
    assert beyond_movement(ghost, right, moved)[0] == pytest.approx(alone, rel=0.2)


def test_what_a_camera_sees_of_a_movement_is_what_its_ray_meets() -> None:
    rig = virtual_rig(np.random.default_rng(2))
    turn, place = aim_frame(rig)
    # A skin that faces the cameras, a tenth of a millimetre nearer: where the same pixel sees it.
    for camera, share in zip((rig.left, rig.with_right()), moved_by(rig, "x") or (), strict=True):
        ray = place - camera.centre
        normal = turn[:, 2]
        nearer = place + ray * (0.1 / (ray @ normal))
        before, after = rig.with_projector().project(np.stack([place, nearer]))[:, 0]
        assert share == pytest.approx((after - before) / 0.1, rel=0.02)


def test_parallel_cameras_see_a_movement_too() -> None:
    rig = virtual_rig(np.random.default_rng(2))
    right = replace(rig.with_right(), R=np.eye(3), t=np.array([-200.0, 0.0, 0.0]))
    moved = moved_by(replace(rig, right=right), "x")
    assert moved is not None
    assert np.isfinite(moved).all()
    assert min(np.abs(moved)) > 0


def test_a_movement_that_no_camera_sees_takes_nothing_off() -> None:
    alone = seen(0.02, 30.0, 0.7, np.zeros(CODE.frames))
    assert alone is not None
    assert beyond_movement(alone, alone, (0.0, 0.0)) == (alone.beyond_noise(alone.mean),) * 2

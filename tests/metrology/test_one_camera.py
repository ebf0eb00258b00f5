"""One camera against the projector: depth, σ, and what the projector's gamma would make of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrology.cloud import Reconstruction
from metrology.errors import RigError
from metrology.fringe import FringeCode
from metrology.one_camera import triangulate_one
from metrology.reconstruct import decode
from tests.support.rendered_fringes import PLANE_DISTANCE, PLANE_NORMAL, plane_scan, small_rig

CODE = FringeCode("x", 4, (20, 18, 17))


def measured(code: FringeCode, gamma: float, sigma: float = 1.0) -> Reconstruction:
    rig, lens = small_rig(), np.array([-0.06, 0.05, 2e-4, -3e-4, 0.0])
    rig = replace(rig, projector=replace(rig.with_projector(), distortion=lens))
    frames, _ = plane_scan(rig, code, np.random.default_rng(4), sigma, gamma=gamma)
    size = code.size(320, 240)
    return triangulate_one(decode(frames, code, size), replace(rig, right=None), code, size)


def deviations(found: Reconstruction) -> tuple[np.ndarray, np.ndarray]:
    """Errors of depth at plain pixels, and their σ, mm."""
    good = found.flags == 0
    assert good.mean() > 0.4
    points = found.points[good].astype(float)
    off = (points @ PLANE_NORMAL - PLANE_DISTANCE) / (points @ PLANE_NORMAL) * points[:, 2]
    return off, found.sigma_z[good].astype(float)


@pytest.mark.parametrize(("steps", "gamma"), [(3, 1.0), (3, 1.1), (4, 1.0), (4, 1.6), (8, 1.0), (8, 1.6)])
def test_depths_scatter_as_sigma_says_whatever_the_gamma(steps: int, gamma: float) -> None:
    off, sigma = deviations(measured(replace(CODE, steps=steps), gamma))
    assert np.std(off / sigma) == pytest.approx(1.0, abs=0.12)
    assert abs(np.median(off)) < 0.1 * np.median(sigma)
    # Nothing of the ripple is left: blocks of a quarter fringe scatter as their pixels' noise does.
    assert np.mean(np.abs(off) < 1.96 * sigma) > 0.93


def test_gamma_costs_no_more_than_its_lost_contrast() -> None:
    plain, curved = (np.std(deviations(measured(CODE, gamma))[0]) for gamma in (1.0, 1.6))
    assert curved < 1.3 * plain


def test_fringes_along_the_baseline_are_refused() -> None:
    rig = small_rig()
    beside = rig.with_projector()
    rig = replace(rig, right=None, projector=replace(beside, t=-beside.R @ np.array([150.0, 2.0, 20.0])))
    code = replace(CODE, axis="y")
    frames, _ = plane_scan(small_rig(), code, np.random.default_rng(4))
    with pytest.raises(RigError, match="found fringes along the line from the camera to the projector"):
        triangulate_one(decode(frames, code, 240), rig, code, 240)


def test_flicker_leaves_no_ripple() -> None:
    """Light that changes by a hundredth from frame to frame ripples the coordinate with the phase and twice of it."""
    rig, rng = small_rig(), np.random.default_rng(4)
    frames, _ = plane_scan(rig, CODE, rng, 0.5)
    bright = np.clip(1 + 0.01 * rng.standard_normal(CODE.frames), 0.97, 1.03)[None, :, None, None]
    uneven = np.rint(frames * bright).clip(0, 255).astype(np.uint8)
    one = replace(rig, right=None)
    steady, _ = deviations(triangulate_one(decode(frames, CODE, 320), one, CODE, 320))
    off, sigma = deviations(triangulate_one(decode(uneven, CODE, 320), one, CODE, 320))
    assert np.std(off) < 1.15 * np.std(steady)
    assert np.std(off / sigma) < 1.2

"""σ of depths where they scatter farther than the frames' noise makes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrology.depth_scatter import raised_sigma
from metrology.reconstruct import triangulate
from metrology.robust import MAD
from tests.support.grained_plane import NORMAL, THROUGH, both_views, half_size_rig


def in_sigmas(extra_px: float) -> float:
    """What depths of a plane err, in their σ, where the right camera's coordinate has errors that no frame tells."""
    left, right = both_views()
    noise = np.random.default_rng(8).normal(0, extra_px, right.coordinate.shape) if extra_px else 0.0
    found = triangulate(left, replace(right, coordinate=(right.coordinate + noise).astype(np.float32)), half_size_rig())
    good = found.flags == 0
    points = found.points[good].astype(float)
    off = (points - THROUGH) @ NORMAL / (points @ NORMAL) * points[:, 2]  # along z
    return float(MAD * np.median(np.abs(off / found.sigma_z[good])))


def test_errors_that_are_no_noise_raise_sigma() -> None:
    assert in_sigmas(0.0) == pytest.approx(1.0, abs=0.1)
    assert in_sigmas(0.05) == pytest.approx(1.0, abs=0.1)  # 1.22 of what the frames tell


@pytest.mark.parametrize("along_rows", [True, False])
def test_bent_surfaces_do_not_raise_sigma(along_rows: bool) -> None:
    rng = np.random.default_rng(2)
    v, u = np.mgrid[:200, :240]
    x = u if along_rows else v
    depth = 600 + 12 * np.sin(x / 60) + rng.normal(0, 0.02, x.shape)
    points = np.stack([u * 0.1, v * 0.1, depth], -1).astype(np.float32)
    sigma, flags = np.full(x.shape, 0.02, np.float32), np.zeros(x.shape, np.uint16)
    assert (raised_sigma(points, sigma, flags, along_rows) == sigma).all()
    three = raised_sigma(points, sigma / 3, flags, along_rows)
    assert np.median(three) == pytest.approx(0.02, rel=0.1)
    assert three.shape == sigma.shape

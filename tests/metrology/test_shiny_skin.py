"""Three exposures of a shiny skin: valid where lit, as flat in the highlight as elsewhere."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.cloud import PixelFlag, Reconstruction
from metrology.epipolar import epipolar_geometry
from metrology.reconstruct import reconstruct
from storage.rig import load_rig
from storage.scene import load_scene

# Mean level at exposure 1 from which the eight bits of that exposure saturate at the fringes' crests.
HIGHLIGHT = 150.0


def smooth_depth(scan: Reconstruction) -> NDArray[np.float64]:
    """(h, w) depth of a smooth skin through the cloud: a polynomial of degree 5 in 1/z, on lit and unlit pixels."""
    x, y = np.moveaxis(epipolar_geometry(scan.rig).left.xy.astype(float), -1, 0)
    powers = [(i, j) for i in range(6) for j in range(6 - i)]
    clear = scan.valid & ((scan.flags & PixelFlag.EDGE) == 0)
    clear[np.arange(clear.shape[0]) % 6 != 0] = False
    inverse = 1.0 / scan.points[..., 2][clear].astype(float)
    design = np.stack([x[clear] ** i * y[clear] ** j for i, j in powers], axis=-1)
    kept = np.full(inverse.size, True)
    for _ in range(3):
        weights = np.linalg.lstsq(design[kept], inverse[kept], rcond=None)[0]
        rest = np.abs(inverse - design @ weights)
        kept = rest < 4 * 1.4826 * np.median(rest)
    coefficients = np.zeros((6, 6))
    for (i, j), weight in zip(powers, weights, strict=True):
        coefficients[i, j] = weight
    return 1.0 / np.polynomial.polynomial.polyval2d(x, y, coefficients)


def local_mean(values: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Mean of the finite values in a window."""
    known = np.isfinite(values)
    total = cv2.boxFilter(np.where(known, values, 0.0), -1, (size, size))
    return total / np.maximum(cv2.boxFilter(known.astype(float), -1, (size, size)), 1e-9)


@pytest.mark.slow
def test_highlights_are_measured_as_well_as_the_rest(shared: Path) -> None:
    scene = load_scene(shared / "scenes" / "skin-shiny")
    rig = load_rig(shared / "scenes" / "rig.json")
    scan = reconstruct(scene.frames("left"), scene.frames("right"), rig, scene.code, scene.exposures)
    depth = smooth_depth(scan)
    points = np.dstack([epipolar_geometry(rig).left.xy * depth[..., None], depth])
    lit = rig.right.inside(rig.right.project(points)) & rig.projector.inside(rig.projector.project(points))
    lit = cv2.erode(lit.astype(np.uint8), np.ones((9, 9))) > 0
    assert scan.valid[lit].mean() >= 0.97

    clear = lit & scan.valid & ((scan.flags & PixelFlag.EDGE) == 0)
    rest = np.where(clear, scan.points[..., 2] - depth, np.nan)
    rest = np.where(clear, rest - local_mean(rest, 61), np.nan)
    bright = clear & (scan.left.texture > HIGHLIGHT)
    assert bright.sum() > 50_000
    assert np.nanstd(rest[bright]) <= 1.5 * np.nanstd(rest[clear & ~bright])
    # What is stated holds in the highlight too.
    noise = np.where(clear, rest - local_mean(rest, 9), np.nan) / scan.sigma_z
    assert abs(np.nanstd(noise[bright]) / np.sqrt(1 - 1 / 81) - 1) < 0.1

"""Matching and triangulation on a plane of known place: bias, noise against the bound, stated σ, invariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.cloud import PixelFlag, Reconstruction
from metrology.epipolar import check_axis, epipolar_geometry
from metrology.errors import RigError
from metrology.fringe import FringeCode, GrayCode
from metrology.reconstruct import ReconstructionSettings, reconstruct
from metrology.rig import Device, Rig
from metrology.robust import MAD
from tests.support.rendered_fringes import (
    PLANE_DISTANCE,
    PLANE_NORMAL,
    USUAL,
    clean_frames,
    plane_depth,
    plane_scan,
    recorded,
    seen_coordinate,
    small_rig,
)

SIGMA = 2.0
# With a focal length of 800 pixels perspective bends the coordinate by 3e-4 pixels across a fit window, which the
# fitted plane leaves in: 1 µm here, a twentieth of that at 3600 pixels.
BEND_MM = 2e-3


def depth_error(scan: Reconstruction, scale: float = 1.0) -> NDArray[np.float64]:
    """(h, w) z less the plane's, mm; NaN where there is no point or it is flagged EDGE."""
    truth = plane_depth(scan.rig.left, PLANE_NORMAL, PLANE_DISTANCE * scale)[..., 2]
    return np.where((scan.flags & PixelFlag.EDGE) == 0, scan.points[..., 2] - truth, np.nan)


def depth_bound(rig: Rig, modulation: NDArray | float, code: FringeCode, spread: float) -> NDArray[np.float64]:
    """(h, w) Cramér-Rao bound of z, mm, from the cameras' noise alone.

    The left pixel's phase noise and `spread` times its variance from the right view, carried to z by moving a point
    along its viewing ray and reading the plane's coordinate where the right camera then sees it.
    """
    size = code.size(rig.projector.width, rig.projector.height)
    information = code.steps / 2 * (2 * np.pi / size) ** 2 * sum(n**2 for n in code.counts)
    variance = (SIGMA**2 + 1 / 12) / (np.asarray(modulation, float) ** 2 * information)
    points = plane_depth(rig.left, PLANE_NORMAL, PLANE_DISTANCE)

    def read(moved: NDArray) -> NDArray:
        rays = rig.right.rays(rig.right.project(moved))
        reach = (PLANE_DISTANCE - rig.right.centre @ PLANE_NORMAL) / (rays @ PLANE_NORMAL)
        return seen_coordinate(rig, rig.right.centre + reach[..., None] * rays, code.axis)

    rate = (read(points * (1 + 1e-5)) - read(points * (1 - 1e-5))) / (2e-5 * points[..., 2])
    return np.sqrt(variance * (1 + spread)) / np.abs(rate)


def test_plane_is_found_without_bias_at_the_noise_limit(rng: np.random.Generator) -> None:
    rig = small_rig()
    modulation = np.linspace(25, 110, 320) * np.ones((240, 1))
    frames = plane_scan(rig, USUAL, rng, SIGMA, mean=120, modulation=modulation)
    scan = reconstruct(*frames, rig, USUAL)
    error = depth_error(scan)
    good = np.isfinite(error)
    assert good.mean() > 0.8
    assert abs(np.mean(error[good])) < BEND_MM
    # The right view's window has 15 pixels and is used up to half a pixel from its centre.
    bound = depth_bound(rig, modulation, USUAL, 1 / 15 + (1 / 30 + 1 / 10) / 12)
    assert np.sqrt(np.mean((error[good] / bound[good]) ** 2)) < 1.05


def test_a_thin_prism_bends_no_plane(rng: np.random.Generator) -> None:
    rig = small_rig()
    prism = [0, 0, 0, 8e-3, 4e-3, -6e-3, 3e-3]
    lenses = {name: np.concatenate([device.distortion, sign * np.array(prism)])
              for name, device, sign in (("left", rig.left, 1), ("right", rig.right, -1))}  # fmt: skip
    rig = replace(rig, **{name: replace(getattr(rig, name), distortion=lens) for name, lens in lenses.items()})
    error = depth_error(reconstruct(*plane_scan(rig, USUAL, rng, SIGMA), rig, USUAL))
    parts = error[:, :160], error[:, 160:], error[:120], error[120:]
    assert np.isfinite(error).mean() > 0.8
    assert max(abs(np.nanmean(part)) for part in parts) < 2 * BEND_MM


def test_stated_sigma_is_what_is_observed_at_every_modulation(rng: np.random.Generator) -> None:
    rig = small_rig()
    modulation = np.linspace(25, 110, 320) * np.ones((240, 1))
    scan = reconstruct(*plane_scan(rig, USUAL, rng, SIGMA, mean=120, modulation=modulation), rig, USUAL)
    ratio = depth_error(scan) / scan.sigma_z
    for low in range(30, 100, 10):
        within = np.isfinite(ratio) & (scan.left.modulation >= low) & (scan.left.modulation < low + 10)
        assert within.sum() > 1000
        assert np.std(ratio[within]) == pytest.approx(1.0, abs=0.1)


def test_covariance_lies_along_the_viewing_ray(rng: np.random.Generator) -> None:
    rig = small_rig()
    scan = reconstruct(*plane_scan(rig, USUAL, rng), rig, USUAL)
    v, u = np.argwhere(scan.valid)[::5000].T
    covariance = scan.covariance(v, u)
    points = scan.points[v, u].astype(float)
    np.testing.assert_allclose(np.sqrt(covariance[:, 2, 2]), scan.sigma_z[v, u], rtol=1e-5)
    across = np.cross(points, [0.0, 1.0, 0.0])
    np.testing.assert_allclose(np.einsum("pi,pij,pj->p", across, covariance, across), 0, atol=1e-9)


def test_points_belong_to_their_raw_left_pixels(rng: np.random.Generator) -> None:
    rig = small_rig()
    scan = reconstruct(*plane_scan(rig, USUAL, rng), rig, USUAL)
    v, u = np.nonzero(scan.valid)
    pixels = rig.left.project(scan.points[v, u].astype(float))
    assert np.abs(pixels - np.column_stack([u, v])).max() < 1e-3


def test_cameras_swapped_see_the_same_plane(rng: np.random.Generator) -> None:
    rig = small_rig()
    frames = plane_scan(rig, USUAL, rng)
    R, t = rig.right.R, rig.right.t

    def seen_from_right(device: Device) -> Device:
        turned = device.R @ R.T
        return Device(device.width, device.height, device.K, device.distortion, turned, device.t - turned @ t)

    swapped = Rig("swapped", "", seen_from_right(rig.right), seen_from_right(rig.left), seen_from_right(rig.projector))
    scan = reconstruct(frames[1], frames[0], swapped, USUAL)
    points = (scan.points[scan.valid & ((scan.flags & PixelFlag.EDGE) == 0)].astype(float) - t) @ R
    error = points @ PLANE_NORMAL - PLANE_DISTANCE
    assert scan.valid.mean() > 0.8
    assert abs(error.mean()) < BEND_MM
    direct = reconstruct(*frames, rig, USUAL)
    assert error.std() == pytest.approx(np.nanstd(depth_error(direct) * PLANE_NORMAL[2]), rel=0.15)


def test_a_rig_twice_as_large_measures_twice_as_large(rng: np.random.Generator) -> None:
    frames = plane_scan(small_rig(), USUAL, rng)
    once, twice = reconstruct(*frames, small_rig(), USUAL), reconstruct(*frames, small_rig(2.0), USUAL)
    np.testing.assert_allclose(twice.points, 2 * once.points, rtol=1e-5)
    np.testing.assert_allclose(twice.sigma_z, 2 * once.sigma_z, rtol=1e-4)
    np.testing.assert_array_equal(twice.flags, once.flags)


def test_projector_gamma_does_not_bias_depth() -> None:
    rig = small_rig()
    straight = reconstruct(*plane_scan(rig, USUAL, None), rig, USUAL)
    bent = reconstruct(*plane_scan(rig, USUAL, None, gamma=1.6), rig, USUAL)
    difference = depth_error(bent) - depth_error(straight)
    assert abs(np.nanmean(difference)) < 2e-3
    assert np.nanpercentile(np.abs(difference), 95) < 0.05


def test_fringes_along_y_serve_cameras_above_each_other(rng: np.random.Generator) -> None:
    rig = small_rig(upright=True)
    code = FringeCode("y", 4, (50, 47, 43))
    scan = reconstruct(*plane_scan(rig, code, rng), rig, code)
    error = depth_error(scan)
    assert np.isfinite(error).mean() > 0.7
    assert abs(np.nanmean(error)) < BEND_MM
    assert np.nanstd(error / scan.sigma_z) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("upright", "axis"), [(False, "y"), (True, "x")])
def test_fringes_along_the_epipolar_lines_are_refused(upright: bool, axis: str) -> None:
    with pytest.raises(RigError, match="epipolar"):
        check_axis(small_rig(upright=upright), axis)


def test_same_epipolar_plane_has_the_same_row_in_both_cameras(rng: np.random.Generator) -> None:
    rig = small_rig()
    geometry = epipolar_geometry(rig)
    points = np.column_stack([rng.uniform(-60, 60, 200), rng.uniform(-40, 40, 200), rng.uniform(640, 760, 200)])
    rows = []
    for device, maps in ((rig.left, geometry.left), (rig.right, geometry.right)):
        u, v = np.rint(device.project(points)).astype(int).T
        inside = (u >= 0) & (u < 320) & (v >= 0) & (v < 240)
        rows.append(np.where(inside, maps.row[np.clip(v, 0, 239), np.clip(u, 0, 319)], np.nan))
    # Rounding to whole pixels leaves half a row each.
    assert np.nanmax(np.abs(rows[0] - rows[1])) < 1.2


def test_a_step_and_its_shadow_do_not_disturb_either_side(rng: np.random.Generator) -> None:
    rig = small_rig()
    size = rig.projector.width
    step = 8.0
    views = []
    for device in (rig.left, rig.right):
        far = plane_depth(device, PLANE_NORMAL, PLANE_DISTANCE)
        near = plane_depth(device, PLANE_NORMAL, PLANE_DISTANCE + step)
        raised = near[..., 0] < 0
        points = np.where(raised[..., None], near, far)
        coordinate = seen_coordinate(rig, points, "x")
        # Beams to the lower side that cross the raised one on their way leave a shadow.
        to_projector = rig.projector.centre - points
        crossing = (
            points
            + to_projector
            * ((PLANE_DISTANCE + step - points @ PLANE_NORMAL) / (to_projector @ PLANE_NORMAL))[..., None]
        )
        lit = np.isfinite(coordinate) & (raised | (crossing[..., 0] > 0))
        frames = clean_frames(np.where(lit, coordinate, 0), USUAL, size, 110, 80)
        views.append(recorded(np.where(lit, frames, 4.0), rng, 1.0))
    scan = reconstruct(*views, rig, USUAL)
    height = scan.points.astype(float) @ PLANE_NORMAL - PLANE_DISTANCE
    kept = scan.valid & ((scan.flags & PixelFlag.EDGE) == 0)
    raised = scan.points[..., 0] < 0
    spread = 6 * np.nanmax(scan.sigma_z)
    assert (kept & raised).sum() > 10000
    assert (kept & ~raised).sum() > 10000
    assert np.abs(height[kept & raised] - step).max() < spread
    assert np.abs(height[kept & ~raised]).max() < spread


def test_depths_out_of_range_are_flagged(rng: np.random.Generator) -> None:
    rig = small_rig()
    frames = plane_scan(rig, USUAL, rng)
    scan = reconstruct(*frames, rig, USUAL, settings=ReconstructionSettings(depth_range_mm=(600.0, 690.0)))
    assert ((scan.flags & PixelFlag.SLOPE) != 0).mean() > 0.2
    assert np.nanmax(scan.points[..., 2]) <= 690.0


def test_every_missing_point_says_why(rng: np.random.Generator) -> None:
    rig = small_rig()
    scan = reconstruct(*plane_scan(rig, USUAL, rng), rig, USUAL)
    assert ((scan.flags[~scan.valid] & ~np.uint16(PixelFlag.EDGE | PixelFlag.SATURATED_SAMPLES)) != 0).all()


def test_coarse_fringes_in_noise_leave_no_holes(rng: np.random.Generator) -> None:
    """Noise that moves coordinates by whole camera pixels makes points worse, and does not take them away."""
    code, rig = FringeCode("x", 4, (4,), GrayCode(8, True)), small_rig()
    scan = reconstruct(*plane_scan(rig, code, rng, 5.0), rig, code)
    both = np.isfinite(scan.left.coordinate)
    both[:, :40] = both[:, -40:] = both[:8] = both[-8:] = False
    seen = both & (rig.right.inside(rig.right.project(plane_depth(rig.left, PLANE_NORMAL, PLANE_DISTANCE))))
    slope = np.nanmedian(np.abs(np.diff(scan.left.coordinate[::4, ::20], axis=1))) / 20
    assert np.nanmedian(scan.left.sigma) > 0.5 * slope
    assert scan.valid[seen].mean() > 0.95
    assert 0.8 < MAD * np.nanmedian(np.abs(depth_error(scan) / scan.sigma_z)) < 1.2


def test_frames_that_do_not_fit_the_rig_are_refused() -> None:
    frames = np.zeros((1, 12, 100, 120), np.uint8)
    with pytest.raises(RigError, match="320×240"):
        reconstruct(frames, frames, small_rig(), USUAL)

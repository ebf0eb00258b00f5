"""Another scanner's cloud: how much it scatters, whose pixels it lies on, and how it is laid on some."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from metrology.camera_fit import fit_camera
from metrology.cloud import PixelFlag, Reconstruction
from metrology.cloud_noise import estimate_sigma
from metrology.gridding import grid_points
from metrology.scanned_cloud import ray_health, scanned
from tests.support.cloud_files import riveted
from tests.support.rivet_scan import rig_of


@cache
def scan(correlated_px: float = 0.0) -> Reconstruction:
    return riveted(correlated_px)


def as_cloud(found: Reconstruction, sigma: float | None = None) -> Reconstruction:
    known = None if sigma is None else np.full(found.flags.shape, sigma, np.float32)
    return scanned(found.points, found.left.texture, known, 254.0, found.rig)


@pytest.mark.parametrize("correlated_px", [0.0, 2.0])
def test_sigma_is_that_of_the_points_also_where_neighbours_share_it(correlated_px: float) -> None:
    found = scan(correlated_px)
    plain = np.isfinite(found.points[..., 2])
    sigma = estimate_sigma(found.points, plain)
    assert np.median(sigma) == pytest.approx(0.012, rel=0.1)
    assert np.quantile(sigma, [0.05, 0.95]) == pytest.approx(0.012, rel=0.35)


def test_sigma_follows_the_part_of_the_field() -> None:
    points = scan().points.copy()
    rng = np.random.default_rng(1)
    points[:, 320:, 2] += rng.normal(0, 0.05, points[:, 320:, 2].shape)
    sigma = estimate_sigma(points, np.isfinite(points[..., 2]))
    assert np.median(sigma[:, :280]) == pytest.approx(0.012, rel=0.1)
    assert np.median(sigma[:, 360:]) == pytest.approx(np.hypot(0.012, 0.05), rel=0.1)


def test_rings_and_holes_are_edges_and_plain_skin_is_not() -> None:
    found = scan()
    points = found.points.copy()
    points[200:210, 300:310] = np.nan
    cloud = scanned(points, found.left.texture, None, 254.0, found.rig)
    edge = (cloud.flags & PixelFlag.EDGE) != 0
    assert edge[198:212, 298:300].all()
    assert edge.mean() < 0.1
    assert ((cloud.flags[200:210, 300:310] & PixelFlag.UNMATCHED) != 0).all()
    assert np.isnan(cloud.sigma_z[205, 305])
    assert cloud.right is None


@pytest.mark.parametrize(
    "turn",
    [np.eye(3), np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])],
    ids=["z forward", "z backward, y up", "turned by 180°"],
)
def test_the_camera_is_found_in_its_own_frame(turn: np.ndarray) -> None:
    points = scan().points.astype(float)
    camera = fit_camera(points @ turn, 2.0)
    assert camera is not None
    assert camera.rms_px < 0.02
    np.testing.assert_allclose(camera.R, turn.T)
    # A nearly flat skin at one distance tells f and distance but weakly apart; rays are what is needed.
    seen = camera.device.project(points[::40, ::40].reshape(-1, 3))
    np.testing.assert_allclose(seen, rig_of().left.project(points[::40, ::40].reshape(-1, 3)), atol=0.05)


def test_the_camera_is_found_from_any_frame() -> None:
    points = scan().points.astype(float)
    R = Rotation.from_rotvec([0.4, -0.9, 0.3]).as_matrix()
    moved = (points - [120.0, 40.0, 300.0]) @ R
    camera = fit_camera(moved, 2.0)
    assert camera is not None
    assert camera.rms_px < 0.1
    back = moved @ camera.R.T + camera.t
    assert np.linalg.norm(back - points, axis=-1).std() < 1.0
    lengths = [np.linalg.norm(p[0, 0] - p[-1, -1]) for p in (back, points)]
    assert lengths[0] == pytest.approx(lengths[1], rel=1e-6)


def test_a_height_map_lies_on_the_pixels_of_a_camera_far_away() -> None:
    x, y = np.meshgrid(np.arange(200) * 0.5, np.arange(150) * 0.5)
    camera = fit_camera(np.stack([x, y, 0.5 * np.sin(x / 9)], axis=-1), 2.0)
    assert camera is not None
    assert camera.rms_px < 0.05
    assert camera.t[2] > 500


def test_points_in_no_order_lie_on_no_camera_s_pixels() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (60, 80, 3)) * [40, 30, 2] + [0, 0, 500]
    assert fit_camera(points, 2.0) is None


def test_points_without_an_order_lie_on_the_surface_where_they_are_gridded() -> None:
    rng = np.random.default_rng(8)
    xy = rng.uniform(-30, 30, (90_000, 2))
    xy = xy[np.hypot(*xy.T) > 4]  # a hole, which stays one
    height = xy @ [0.1, -0.05] + (xy**2).sum(1) / 3000
    grey = rng.integers(0, 255, len(xy)).astype(np.uint8)
    made = grid_points(np.column_stack([xy, height + 500.0]), grey)
    laid = (made.points.reshape(-1, 3).astype(float) - made.t) @ made.R
    laid = laid[np.isfinite(laid[:, 2])]
    assert len(laid) > 0.7 * len(xy)
    expected = laid[:, :2] @ [0.1, -0.05] + (laid[:, :2] ** 2).sum(1) / 3000 + 500.0
    assert np.abs(laid[:, 2] - expected).max() < 5e-3
    assert np.abs(laid[:, 2] - expected).mean() < 2e-4
    assert np.hypot(*laid[:, :2].T).min() > 3.3
    v, u = np.nonzero(np.isfinite(made.points[..., 2]))
    np.testing.assert_allclose(made.device.project(made.points[v, u]), np.stack([u, v], 1), atol=1e-3)


def test_points_off_the_rays_of_their_pixels_are_no_picture_s() -> None:
    cloud = as_cloud(scan(), 0.012)
    assert ray_health(cloud).verdict == "ok"
    for shift, verdict in ((1.0, "warning"), (9.0, "refused")):
        moved = scanned(
            cloud.points + np.float32([shift * 0.2, 0, 0]), cloud.left.texture, cloud.sigma_z, 254.0, cloud.rig
        )
        assert ray_health(moved).verdict == verdict

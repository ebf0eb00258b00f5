"""Dots and corners to a few hundredths of a pixel, where their centres are, and which is which."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.calibration.blobs import elliptic_outlines, printed_blobs
from metrology.calibration.corner_edge import fit_corner
from metrology.calibration.dot_edge import DotFit, fit_dot
from metrology.calibration.eccentricity import eccentricity, ellipse_centres, rim
from metrology.calibration.homography import apply_homography
from metrology.calibration.lattice import diagonal_to_grid, label_lattice, turned
from tests.support.calibration_bench import BOARD, PATTERN

# A strongly tilted plane: plane units about pixels.
TILTED = np.array([[1.0, 0.12, 60.0], [-0.08, 0.85, 55.0], [9e-4, -7e-4, 1.0]])
NOISE = 1.5


def picture(value: Callable[[NDArray[np.float64]], NDArray[np.float64]], shape: tuple[int, int]) -> NDArray[np.float64]:
    """A function of pixels seen through pixel areas (8 × 8 samples each) and a lens blur of 0.7 px."""
    fine = 8
    v, u = (np.mgrid[: shape[0] * fine, : shape[1] * fine] + 0.5) / fine - 0.5
    image = value(np.stack([u, v], -1)).reshape(shape[0], fine, shape[1], fine).mean((1, 3))
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.7))


def tilted_disc(centre: tuple[float, float], radius: float) -> NDArray[np.float64]:
    inverse = np.linalg.inv(TILTED)

    def value(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        plane = apply_homography(inverse, pixels.reshape(-1, 2))
        inside = np.hypot(*(plane - centre).T) < radius
        return np.where(inside, 20.0, 130.0 + 0.2 * pixels[..., 0].ravel()).reshape(pixels.shape[:2])

    return picture(value, (120, 130))


def fitted(image: NDArray[np.float64], weight: NDArray[np.float64] | None = None) -> DotFit:
    outline = max(elliptic_outlines(image < 80), key=cv2.contourArea)
    fit = fit_dot(image, np.ones_like(image) if weight is None else weight, outline)
    assert fit is not None
    return fit


def test_a_tilted_dots_centre_is_found_once_its_eccentricity_is_removed() -> None:
    rng = np.random.default_rng(1)
    centre = (5.3, 2.6)
    clean = tilted_disc(centre, 25.0)
    known = np.array([centre])
    offset = eccentricity(lambda points: apply_homography(TILTED, points), known, 25.0)[0]
    truth = apply_homography(TILTED, known)[0]
    fits = [fitted(clean + rng.normal(0, NOISE, clean.shape)) for _ in range(12)]
    errors = np.array([fit.centre - offset - truth for fit in fits])
    assert np.linalg.norm(offset) > 0.2
    assert np.abs(errors).max() < 0.03
    # The fit's own residual tells the scatter.
    assert errors.std(0).mean() == pytest.approx(np.mean([fit.sigma_px for fit in fits]), rel=0.6)
    assert np.mean([fit.blur_px for fit in fits]) == pytest.approx(np.hypot(0.7, 1 / np.sqrt(12)), abs=0.08)


def test_a_dot_partly_hidden_keeps_its_centre() -> None:
    image = tilted_disc((5.3, 2.6), 25.0) + np.random.default_rng(2).normal(0, NOISE, (120, 130))
    whole = fitted(image)
    weight = np.ones_like(image)
    weight[:, : int(whole.centre[0]) - 12] = 0
    part = fitted(image, weight)
    assert part.rim_fraction < 0.85
    assert part.centre == pytest.approx(whole.centre, abs=0.04)
    assert part.sigma_px > whole.sigma_px


def test_ellipse_centres_of_circles_are_their_centres() -> None:
    centres = np.array([[3.0, -200.0], [1000.0, 40.0]])
    assert ellipse_centres(rim(centres, np.array([1.0, 30.0]))) == pytest.approx(centres, abs=1e-9)


def test_a_frontal_disc_has_no_eccentricity() -> None:
    def scale(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return 3 * points + 7

    assert eccentricity(scale, np.array([[1.0, 2.0]]), 4.0) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("angles_deg", [(8.0, 95.0), (40.0, 118.0)])
def test_a_corner_is_where_its_edges_cross(angles_deg: tuple[float, float]) -> None:
    rng = np.random.default_rng(3)
    truth = np.array([40.27, 38.61])
    normals = np.array([[-np.sin(a), np.cos(a)] for a in np.radians(angles_deg)])
    directions = np.array([[np.cos(a), np.sin(a)] for a in np.radians(np.array(angles_deg) + 3)])

    def value(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        sides = np.sign((pixels - truth) @ normals.T).prod(-1)
        return np.asarray(90 + 70 * sides)

    clean = picture(value, (80, 80))
    fits = [fit_corner(clean + rng.normal(0, NOISE, clean.shape), truth + 0.6, directions, 18.0) for _ in range(8)]
    errors = np.array([fit.centre - truth for fit in fits if fit is not None])
    assert len(errors) == 8
    assert np.abs(errors).max() < 0.03


def test_markers_beside_the_edges_are_left_out() -> None:
    """As on a ChArUco board of 29 px a square: markers of two opposite squares begin 3.6 px from the edges."""
    rng, truth, gap = np.random.default_rng(3), np.array([40.27, 38.61]), 3.6

    def value(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        offset = pixels - truth
        marker = (np.abs(offset).min(-1) > gap) & (offset.prod(-1) > 0) & (np.sin(0.9 * offset).prod(-1) > 0)
        return np.asarray(90 + 70 * np.where(marker, -1, np.sign(offset).prod(-1)))

    shown = picture(value, (80, 80))
    frames = [shown + rng.normal(0, NOISE, shown.shape) for _ in range(8)]
    fits = [fit_corner(frame, truth + 0.3, np.eye(2), 13.0, gap) for frame in frames]
    assert np.abs([fit.centre - truth for fit in fits if fit is not None]).max() < 0.03
    assert all(fits)
    disturbed = [fit_corner(frame, truth + 0.3, np.eye(2), 13.0) for frame in frames]
    assert all(fit is None or fit.sigma_px > 2 * fits[0].sigma_px for fit in disturbed if fits[0])


def test_a_flat_patch_has_no_corner() -> None:
    flat = 100 + np.random.default_rng(4).normal(0, NOISE, (60, 60))
    assert fit_corner(flat, np.array([30.0, 30.0]), np.eye(2), 15.0) is None


def test_lattice_places_follow_perspective_though_dots_are_missing_and_some_are_false() -> None:
    rng = np.random.default_rng(5)
    grid = PATTERN.grid
    homography = np.array([[40.0, 6.0, 90.0], [-5.0, 34.0, 120.0], [9e-3, 4e-3, 1.0]])
    keep = rng.uniform(size=len(grid)) > 0.2
    pixels = apply_homography(homography, grid[keep]) + rng.normal(0, 0.3, (keep.sum(), 2))
    false = rng.uniform(pixels.min(0), pixels.max(0), (6, 2))
    index, labels = label_lattice(np.concatenate([pixels, false]))
    real = index < keep.sum()
    assert real.sum() > 0.95 * keep.sum()
    places = diagonal_to_grid(labels[real])
    true = grid[keep][index[real]]
    # Up to a shift and a quarter turn, and never mirrored.
    shifts = [np.unique(turned(places, k) - true, axis=0) for k in range(4)]
    assert any(len(shift) == 1 for shift in shifts)


def test_too_few_points_make_no_lattice() -> None:
    index, labels = label_lattice(np.zeros((3, 2)))
    assert len(index) == len(labels) == 0


def test_printed_dots_are_found_on_an_unevenly_lit_board() -> None:
    scale = 4.0
    points = BOARD.points[:, :2] * scale + 80

    def value(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        lit = 60 + 0.1 * pixels[..., 0]
        image = lit.copy()
        for x, y in points:
            image[np.hypot(pixels[..., 0] - x, pixels[..., 1] - y) < 4 * scale] *= 0.1
        return image

    v, u = np.mgrid[:760, :1000].astype(float)
    assert len(printed_blobs(value(np.stack([u, v], -1)))) == len(points)

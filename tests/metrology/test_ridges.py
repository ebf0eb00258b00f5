"""The ridge detector against exact lines and against a plain numpy twin."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from metrology.errors import UsageError
from metrology.ridges import (
    bar_curvature,
    curvature_noise,
    gaussian_derivatives,
    gaussian_kernels,
    ridge_points,
)

SIZE = 96


def bar_image(width_px, contrast, angle_deg, offset_px, blur_px=0.5):
    """A dark bar through the middle on grey 100, and the signed distance of every pixel from its centre line."""
    v, u = np.mgrid[:SIZE, :SIZE] - (SIZE - 1) / 2
    angle = np.deg2rad(angle_deg)
    distance = -u * np.sin(angle) + v * np.cos(angle) - offset_px
    scale = np.sqrt(2) * blur_px
    profile = 0.5 * (erf((distance + width_px / 2) / scale) - erf((distance - width_px / 2) / scale))
    return 100 - contrast * profile, distance


def numpy_twin(image, sigma_px, threshold, sign):
    """Steger's points with numpy's eigen-decomposition, pixel by pixel."""
    d = gaussian_derivatives(image, sigma_px)
    hessian = np.stack([np.stack([d.uu, d.uv], -1), np.stack([d.uv, d.vv], -1)], -2).astype(float)
    values, vectors = np.linalg.eigh(hessian)
    which = np.abs(values).argmax(-1)[..., None]
    curvature = np.take_along_axis(values, which, -1)[..., 0]
    normal = np.take_along_axis(vectors, which[..., None], -1)[..., 0]
    t = -(d.u * normal[..., 0] + d.v * normal[..., 1]) / curvature
    inside = np.all(np.abs(t[..., None] * normal) <= 0.6, axis=-1)
    found = inside & (sign * curvature > threshold)
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    return found, np.abs(curvature), u + t * normal[..., 0], v + t * normal[..., 1]


def test_kernel_agrees_with_numpy_twin():
    rng = np.random.default_rng(1)
    image = bar_image(4, 40, 33, 0.3)[0] + rng.normal(0, 2, (SIZE, SIZE))
    for polarity, sign in (("dark", 1), ("bright", -1)):
        ridges = ridge_points(image, 1.5, 0.5, polarity)
        found, strength, u, v = numpy_twin(image, 1.5, 0.5, sign)
        agree = (ridges.strength > 0) == found
        assert agree.mean() > 0.9995  # single precision may decide the odd borderline pixel otherwise
        both = found & (ridges.strength > 0)
        assert np.allclose(ridges.strength[both], strength[both], rtol=1e-3)
        assert np.abs(ridges.u[both] - u[both]).max() < 0.01
        assert np.abs(ridges.v[both] - v[both]).max() < 0.01


@pytest.mark.parametrize("angle_deg", [0, 22.5, 45, 67.5, 90, 135])
def test_centre_line_and_normal_of_a_bar(angle_deg):
    image, _ = bar_image(5, 50, angle_deg, 0.37)
    ridges = ridge_points(image, 2.0, bar_curvature(5, 25, 2.0))
    rows, columns = np.nonzero(ridges.strength[10:-10, 10:-10])
    assert len(rows) >= SIZE - 21  # at least one point per pixel of length
    angle = np.deg2rad(angle_deg)
    normal = np.array([-np.sin(angle), np.cos(angle)])
    u, v = (field[10:-10, 10:-10][rows, columns] - (SIZE - 1) / 2 for field in (ridges.u, ridges.v))
    assert np.abs(u * normal[0] + v * normal[1] - 0.37).max() < 0.03
    across = ridges.normal_u[10:-10, 10:-10] * normal[0] + ridges.normal_v[10:-10, 10:-10] * normal[1]
    assert np.abs(across[rows, columns]).min() > 0.999


def test_polarity():
    image, _ = bar_image(4, 40, 60, 0.0)
    assert not ridge_points(image, 1.5, 3.0, "bright").strength.any()
    assert not ridge_points(200 - image, 1.5, 3.0, "dark").strength.any()
    assert (ridge_points(image, 1.5, 3.0, "both").strength >= 0).all()
    bright = ridge_points(200 - image, 1.5, 3.0, "both").strength
    assert (bright <= 0).all()
    assert bright.any()


def test_strength_is_the_bar_s_curvature():
    width = 5.0
    sigma = width / (2 * np.sqrt(3)) + 0.5
    image, _ = bar_image(width, 50, 0, 0.5, blur_px=0.05)
    ridges = ridge_points(image, sigma, 1.0)
    # The bar's sampled pixels and the Gaussian's sampled kernel each differ a little from the continuous ones.
    assert ridges.strength.max() == pytest.approx(bar_curvature(width, 50, sigma), rel=0.06)


def test_noise_of_the_second_derivative():
    noise = np.random.default_rng(2).normal(0, 3, (256, 256))
    for sigma in (1.0, 2.0):
        assert gaussian_derivatives(noise, sigma).uu.std() == pytest.approx(3 * curvature_noise(sigma), rel=0.05)


def test_derivatives_of_a_quadratic_are_exact():
    v, u = np.mgrid[:40, :40].astype(float)
    d = gaussian_derivatives(2 * u + 0.05 * u**2 + 0.03 * u * v - 0.02 * v**2, 1.7)
    centre = np.s_[12:-12, 12:-12]
    assert np.allclose(d.u[centre], (2 + 0.1 * u + 0.03 * v)[centre], atol=1e-3)
    assert np.allclose(d.uu[centre], 0.1, atol=1e-4)
    assert np.allclose(d.uv[centre], 0.03, atol=1e-4)
    assert np.allclose(d.vv[centre], -0.04, atol=1e-4)


def test_threads_do_not_change_the_result():
    image = bar_image(4, 40, 33, 0.3)[0]
    one, many = ridge_points(image, 1.5, 0.5, threads=1), ridge_points(image, 1.5, 0.5, threads=2)
    assert np.array_equal(one.strength, many.strength)


def test_flat_image_has_no_lines():
    assert not ridge_points(np.full((50, 60), 77.0), 1.5, 0.0).strength.any()


def test_settings_out_of_range():
    with pytest.raises(UsageError, match="scale"):
        gaussian_kernels(0)
    with pytest.raises(UsageError, match="polarity"):
        ridge_points(np.zeros((9, 9)), 1, 1, "grey")  # type: ignore[arg-type]

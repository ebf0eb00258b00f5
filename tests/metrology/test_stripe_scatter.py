"""Gray code alone in two cameras: σ of depths is what they err, on even surfaces and on relief."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.fringe import FringeCode, GrayCode
from metrology.reconstruct import coordinate_size, decode, triangulate
from metrology.rig import Device, Rig
from metrology.robust import MAD
from tests.support.rendered_fringes import recorded, seen_coordinate, small_rig

Surface = Callable[[NDArray, NDArray], NDArray]
FINE = 32  # places within a projector's column


def larger(device: Device, times: int) -> Device:
    K = device.K.copy()
    K[:2] *= times
    return replace(device, width=device.width * times, height=device.height * times, K=K)


def sharp_rig() -> Rig:
    """The small rig with cameras of four times, and a projector of nine times the pixels."""
    small = small_rig()
    left, right = larger(small.left, 2), larger(small.with_right(), 2)
    return replace(small, left=left, right=right, projector=larger(small.with_projector(), 3))


def relief(rng: np.random.Generator, wave_mm: float, height_mm: float) -> Surface:
    """A surface 700 mm away, of ten waves in all directions."""
    waves, phases = rng.normal(0, 1 / wave_mm, (10, 2)), rng.uniform(0, 2 * np.pi, 10)

    def depth(x: NDArray, y: NDArray) -> NDArray:
        waving = sum(np.sin(k[0] * x + k[1] * y + phase) for k, phase in zip(waves, phases, strict=True))
        return np.asarray(700 + height_mm * waving / np.sqrt(5))

    return depth


def points_on(device: Device, surface: Surface) -> NDArray[np.float64]:
    """(h, w, 3) where the camera's pixels see it."""
    v, u = np.mgrid[: device.height, : device.width].astype(float)
    rays = device.rays(np.stack([u, v], axis=-1))
    reach = (700 - device.centre[2]) / rays[..., 2]
    for _ in range(20):
        at = device.centre + reach[..., None] * rays
        reach = reach + 0.7 * (surface(at[..., 0], at[..., 1]) - at[..., 2]) / rays[..., 2]
    return np.asarray(device.centre + reach[..., None] * rays)


def errors_in_sigmas(surface: Surface, gray: GrayCode, noise: float, rng: np.random.Generator) -> NDArray[np.float64]:
    rig, code = sharp_rig(), FringeCode("x", 0, (), gray)
    size = rig.with_projector().width
    lines = replace(code, size_px=size * FINE).patterns(size * FINE, 1)[:, 0].astype(np.float32)
    views, true = [], []
    for device in (rig.left, rig.with_right()):
        true.append(points_on(device, surface))
        seen = seen_coordinate(rig, true[-1], "x")
        pitch = float(np.nanmedian(np.diff(seen, axis=1)))
        blurred = cv2.GaussianBlur(lines, (0, 0), sigmaX=0.7 * pitch * FINE, sigmaY=1e-6)
        places = np.rint((np.nan_to_num(seen) + 0.5) * FINE - 0.5).astype(int).clip(0, size * FINE - 1)
        levels = np.where(np.isfinite(seen), 30 + 160 * blurred[:, places], 4)
        views.append(decode(recorded(levels, rng, noise), code, coordinate_size(rig, code)))
    found = triangulate(views[0], views[1], rig)
    good = found.flags == 0
    assert good.mean() > 0.8
    assert np.isfinite(found.sigma_z[good]).all()
    return np.asarray((found.points[..., 2] - true[0][..., 2])[good] / found.sigma_z[good])


@pytest.mark.parametrize("gray", [GrayCode(120), GrayCode(240, True)], ids=str)
@pytest.mark.parametrize(("noise", "tilt"), [(0.5, 0.0), (3.0, 0.4)])
def test_sigma_on_an_even_plate(gray: GrayCode, noise: float, tilt: float, rng: np.random.Generator) -> None:
    normal = errors_in_sigmas(lambda x, y: 700 + tilt * x + 0.1 * y, gray, noise, rng)
    assert MAD * np.median(np.abs(normal)) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("gray", [GrayCode(120), GrayCode(240, True)], ids=str)
@pytest.mark.parametrize(("noise", "wave_mm", "height_mm"), [(1.0, 6.0, 2.0), (4.0, 15.0, 6.0)])
def test_relief_does_not_count_as_scatter(
    gray: GrayCode, noise: float, wave_mm: float, height_mm: float, rng: np.random.Generator
) -> None:
    """Depths five stripes apart differ by a hundred times their errors."""
    normal = errors_in_sigmas(relief(rng, wave_mm, height_mm), gray, noise, rng)
    assert MAD * np.median(np.abs(normal)) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize(("gray", "least"), [(GrayCode(240, True), 0.8), (GrayCode(960, True), 0.5)], ids=str)
def test_gentle_waves_do_not_count_as_scatter_where_bits_cross_their_inverses(
    gray: GrayCode, least: float, rng: np.random.Generator
) -> None:
    """Waves of 60 and 70 mm: far lines scatter less than far stripes, and both a hundred times as far as depths err."""

    def waves(x: NDArray, y: NDArray) -> NDArray:
        return np.asarray(700 + 0.1 * x + 4 * np.sin(2 * np.pi * x / 60) * np.cos(2 * np.pi * y / 70))

    normal = errors_in_sigmas(waves, gray, 0.5, rng)
    assert least < MAD * np.median(np.abs(normal)) < 1.2

"""Rings in images: the joint fit returns the truth within its own covariance, detection finds all and nothing else."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from metrology.errors import UsageError
from metrology.rivets import RivetSettings, detect_ellipses
from metrology.rivets.alike import _quarters, _ring_sums, rings_alike
from metrology.rivets.ellipse import Ellipse, ellipse_of_shape
from metrology.rivets.ellipse_detection import _verified
from metrology.rivets.ring import fit_ring
from metrology.rivets.shapes import CircleShapes, log_shape, shapes_of
from tests.support.painted_texture import paint_texture
from tests.support.texture_spec import TextureSpec

LIMITS = np.array([7.0, 4.0, 60.0, 0.5, 0.5, 3.0])


def painted_ring(
    ellipse: Ellipse, amplitude: float, sigma: float = 1.0, step: float = 0.0, size: tuple[int, int] = (120, 120)
) -> np.ndarray:
    """A ring exactly as the model has it (distance along the normal to first order)."""
    v, u = np.mgrid[: size[0], : size[1]].astype(float)
    inverse = np.linalg.inv(ellipse.shape)
    d = np.stack([u - ellipse.u, v - ellipse.v], axis=-1)
    f = np.sqrt(np.einsum("...i,ij,...j", d, inverse, d)) + 1e-12
    slope = np.linalg.norm(d @ inverse, axis=-1) / f
    rho = (f - 1) / slope
    image = 100 + 0.1 * u - 0.05 * v + amplitude * np.exp(-0.5 * (rho / sigma) ** 2)
    return image + step / (1 + np.exp(np.clip(1.702 * rho / sigma, -50, 50)))


def uncorrected(found: Ellipse, sigma: float) -> Ellipse:
    """The ridge itself, without the shift of a blurred curved line that the fit takes off."""
    radius = found.radius
    r = radius / 2 + np.sqrt(radius**2 / 4 - sigma**2 / 2)
    return Ellipse(found.u, found.v, found.a * r / radius, found.b * r / radius, found.angle)


@pytest.mark.parametrize("amplitude", [-30.0, 25.0])
@pytest.mark.parametrize("step", [0.0, 8.0])
def test_fit_returns_the_ellipse_of_a_clean_ring(amplitude: float, step: float) -> None:
    truth = Ellipse(58.3, 61.7, 24.0, 19.0, 0.6)
    start = Ellipse(59.2, 60.9, 23.2, 20.1, 0.5)
    ring = fit_ring(painted_ring(truth, amplitude, step=step).astype(np.float32), start, 1.2, LIMITS)
    assert ring is not None
    ridge = uncorrected(ring.ellipse, ring.sigma_px)
    assert ridge.parameters == pytest.approx(truth.parameters, abs=0.04)
    assert ring.sigma_px == pytest.approx(1.0, abs=0.06)
    assert ring.amplitude == pytest.approx(amplitude, rel=0.1)


def test_fit_follows_a_turned_image() -> None:
    """Turning the image by 90° turns the ellipse and changes nothing else."""
    truth = Ellipse(50.2, 61.4, 22.0, 17.0, 0.4)
    image = painted_ring(truth, -20).astype(np.float32)
    turned = np.ascontiguousarray(np.rot90(image))
    upright = fit_ring(image, truth, 1.0, LIMITS)
    lying = fit_ring(turned, Ellipse(truth.v, 119 - truth.u, 22.0, 17.0, 0.4 + np.pi / 2), 1.0, LIMITS)
    assert upright is not None
    assert lying is not None
    assert (lying.ellipse.u, lying.ellipse.v) == pytest.approx((upright.ellipse.v, 119 - upright.ellipse.u), abs=0.02)
    assert lying.ellipse.a == pytest.approx(upright.ellipse.a, abs=0.02)


def test_gain_and_offset_change_amplitude_and_nothing_else(rng: np.random.Generator) -> None:
    truth = Ellipse(60.2, 58.6, 20.0, 18.0, 1.0)
    image = painted_ring(truth, -12) + rng.normal(0, 1.5, (120, 120))
    plain = fit_ring(image.astype(np.float32), truth, 1.0, LIMITS)
    bright = fit_ring((3 * image + 40).astype(np.float32), truth, 1.0, LIMITS)
    assert plain is not None
    assert bright is not None
    assert bright.ellipse.parameters == pytest.approx(plain.ellipse.parameters, abs=5e-3)
    assert bright.amplitude == pytest.approx(3 * plain.amplitude, rel=0.01)
    assert bright.score == pytest.approx(plain.score, rel=0.02)


def test_covariance_predicts_the_scatter_of_the_centre(rng: np.random.Generator) -> None:
    truth = Ellipse(60.2, 58.6, 18.0, 15.0, 0.7)
    clean = painted_ring(truth, -8)
    errors, predicted = [], []
    for _ in range(150):
        ring = fit_ring((clean + rng.normal(0, 2, clean.shape)).astype(np.float32), truth, 1.0, LIMITS)
        assert ring is not None
        errors.append([ring.ellipse.u - truth.u, ring.ellipse.v - truth.v])
        predicted.append(np.sqrt(np.diag(ring.covariance)[:2]))
    ratio = np.std(errors) / np.mean(predicted)
    assert ratio == pytest.approx(1.0, abs=0.2)
    assert np.abs(np.mean(errors, axis=0)).max() < 4 * np.mean(predicted) / np.sqrt(150)


def test_a_glint_on_the_rim_moves_the_centre_little(rng: np.random.Generator) -> None:
    truth = Ellipse(60.2, 58.6, 20.0, 18.0, 0.3)
    v, u = np.mgrid[:120, :120]
    glint = 120 * np.exp(-0.5 * (((u - 78) / 2.5) ** 2 + ((v - 52) / 3.0) ** 2))
    image = painted_ring(truth, -10) + glint + rng.normal(0, 2, (120, 120))
    ring = fit_ring(image.astype(np.float32), Ellipse(60.8, 58.0, 20.5, 17.5, 0.2), 1.0, LIMITS)
    assert ring is not None
    assert np.hypot(ring.ellipse.u - truth.u, ring.ellipse.v - truth.v) < 0.25


def test_a_glint_on_a_slope_of_light_hides_no_rim(rng: np.random.Generator) -> None:
    """Beside a highlight the light differs round the rim by as much as the glint does: what departs from it counts."""
    truth = Ellipse(60.2, 59.5, 16.5, 16.0, 0.4)
    v, u = np.mgrid[:120, :120].astype(float)
    shown = np.abs(np.arctan2(v - truth.v, u - truth.u) + 2.2) > 0.7
    light = 110 * np.exp(-0.5 * ((u - 66) ** 2 + (v - 14) ** 2) / 20**2)
    glint = 120 * np.exp(-0.5 * (((u - 60) / 5) ** 2 + ((v - 71) / 2.5) ** 2))
    image = (
        np.where(shown, painted_ring(truth, -10), painted_ring(truth, 0)) + light + glint + rng.normal(0, 2, u.shape)
    )
    ring = fit_ring(np.clip(image, 0, 255).astype(np.float32), truth, 1.0, LIMITS, truth.shape)
    assert ring is not None
    assert (ring.ellipse.u, ring.ellipse.v) == pytest.approx((truth.u, truth.v), abs=0.5)


def test_a_start_far_off_finds_the_whole_of_a_small_ring(rng: np.random.Generator) -> None:
    """A recess' shadow beside it holds the fit to the part that is seen first."""
    truth = Ellipse(60.2, 58.6, 9.4, 9.2, 0.3)
    v, u = np.mgrid[:120, :120]
    recess = 30 * np.exp(-(((np.hypot(u - truth.u, v - truth.v) - 4) / 1.2) ** 2)) * (u > truth.u)
    image = (painted_ring(truth, -40, sigma=0.8) - recess + rng.normal(0, 0.6, (120, 120))).astype(np.float32)
    found = []
    for turn in np.arange(0, 2 * np.pi, 0.2):
        start = Ellipse(truth.u + 3 * np.cos(turn), truth.v + 3 * np.sin(turn), 8.0, 7.9, 0.0)
        found.append(_verified(image, start, None, (4.0, 35.0), RivetSettings()))
    rings = [ring for ring in found if ring and ring.ellipse.radius > 8]
    assert len(rings) > 20
    assert min(ring.fit.coverage for ring in rings) > 0.85


def test_known_shape_steadies_half_a_ring(rng: np.random.Generator) -> None:
    """With the shape from the surface an arc of 200° gives the centre several times better."""
    truth = Ellipse(60.2, 58.6, 20.0, 16.0, 0.3)
    v, u = np.mgrid[:120, :120]
    background = painted_ring(truth, 0)
    shown = np.abs(np.arctan2(v - truth.v, u - truth.u)) < np.radians(100)
    errors = {"free": [], "known": []}
    for _ in range(25):
        image = np.where(shown, painted_ring(truth, -8), background) + rng.normal(0, 2, (120, 120))
        for name, shape in (("free", None), ("known", truth.shape)):
            ring = fit_ring(image.astype(np.float32), truth, 1.0, LIMITS, shape, shape_sd=0.02)
            if ring is not None:
                errors[name].append(np.hypot(ring.ellipse.u - truth.u, ring.ellipse.v - truth.v))
    assert len(errors["known"]) > 20
    assert np.median(errors["known"]) < 0.6 * np.median(errors["free"])


def test_shape_matrix_and_ellipse_are_each_others_inverse() -> None:
    for angle in np.linspace(0, np.pi, 7, endpoint=False):
        e = Ellipse.of([3.0, 4.0, 12.0, 7.0, angle])
        back = ellipse_of_shape(3.0, 4.0, e.shape)
        assert back.shape == pytest.approx(e.shape)
        assert e.level(*e.points(16).T) == pytest.approx(np.ones(16))


def test_shapes_are_learnt_from_rings_of_one_panel_and_outliers_left_out() -> None:
    rings = [Ellipse(100 + 150 * k, 80 + 90 * k, 20.0, 16.0 + 0.05 * k, 0.5) for k in range(9)]
    shapes = shapes_of([*rings, Ellipse(500, 300, 20, 12, 2.0)], (1000, 1500))
    assert shapes is not None
    for ring in rings:
        expected = shapes.ellipse(ring.u, ring.v, ring.radius)
        assert np.linalg.norm(log_shape(expected) - log_shape(ring)) < 0.01
    assert shapes_of(rings[:3], (1000, 1500)) is None


@pytest.fixture(scope="module")
def textures() -> list:
    spec = TextureSpec(width=900, height=700, rivets=(8, 10), contrast=(6, 30), seams=1, glints=0.15)
    return [paint_texture(spec, np.random.default_rng(seed)) for seed in range(4)]


def test_every_rim_is_found_and_nothing_else(textures: list) -> None:
    missed = extra = rims = 0
    errors = []
    for texture in textures:
        rings = detect_ellipses(texture.image.astype(np.float32))
        distance = np.array([[np.hypot(r.ellipse.u - t.u, r.ellipse.v - t.v) for r in rings] for t in texture.rims])
        rims += len(texture.rims)
        missed += int((distance.min(axis=1) > 3).sum())
        extra += len(rings) - int((distance.min(axis=0) < 3).sum())
        errors += list(distance.min(axis=1)[distance.min(axis=1) < 3])
    assert missed <= 0.03 * rims
    assert extra == 0
    assert np.median(errors) < 0.08


def test_no_rim_no_ring() -> None:
    spec = TextureSpec(width=900, height=700, rivets=(0, 0), stickers=5, holes=4, scratches=25)
    for seed in range(3):
        image = paint_texture(spec, np.random.default_rng(100 + seed)).image
        assert detect_ellipses(image.astype(np.float32)) == []


def test_detection_does_not_depend_on_brightness(textures: list) -> None:
    """The same scene at another exposure: noise and contrast scale alike."""
    image = textures[0].image.astype(np.float32)
    once = detect_ellipses(image)
    dim = detect_ellipses(0.05 * image)
    assert len(dim) == len(once)
    for a, b in zip(once, dim, strict=True):
        assert b.ellipse.parameters[:4] == pytest.approx(a.ellipse.parameters[:4], abs=0.02)


@pytest.mark.parametrize(
    "wrong",
    [{"min_diameter_mm": 9.0, "max_diameter_mm": 3.0}, {"reference": "sphere"}, {"outer_radii": (2.0, 1.5)}],
)
def test_settings_refuse_what_makes_no_sense(wrong: dict) -> None:
    with pytest.raises(UsageError, match="found"):
        RivetSettings(**wrong)


def test_faint_rings_as_large_as_others_show_in_their_sums(rng: np.random.Generator) -> None:
    """A ring of 1.2 standard deviations of streaks along the image, in which no arc of it can be followed."""
    faint = [Ellipse(90.3, 80.2, 11.0, 10.0, 0.3), Ellipse(210.4, 189.7, 15.0, 13.6, 0.3)]
    image = 100 + 3 * cv2.GaussianBlur(rng.normal(size=(260, 300)), (0, 0), sigmaX=6, sigmaY=0.6)
    image += rng.normal(size=image.shape)
    for ellipse in faint:
        image += painted_ring(ellipse, -2.5, size=(260, 300)) - painted_ring(ellipse, 0.0, size=(260, 300))
    shapes = shapes_of([Ellipse(0.0, 0.0, 11.0, 10.0, 0.3)] * 4, image.shape)
    assert shapes is not None
    sizes = [Ellipse(50.0, 200.0, 10.5, 9.5, 0.3), Ellipse(260.0, 40.0, 16.0, 14.5, 0.3)]
    found = rings_alike(image.astype(np.float32), sizes, True, shapes)
    for ellipse in faint:
        near = [f for f in found if np.hypot(f.u - ellipse.u, f.v - ellipse.v) < 2.5]
        assert min(abs(f.radius / ellipse.radius - 1) for f in near) < 0.1  # from where the fit leads to it
    assert len(found) < 60
    assert not rings_alike(image.astype(np.float32), [Ellipse(0.0, 0.0, 30.0, 27.0, 0.3)], True, shapes)


def test_sums_along_circles_are_those_of_plain_numpy(rng: np.random.Generator) -> None:
    counts = rng.integers(-60, 60, (61, 84), dtype=np.int8)
    shapes, radius, margin = CircleShapes.round(), 9.0, 8
    sums = _ring_sums(_quarters(counts, margin), margin, radius, shapes)
    padded = np.pad(counts.astype(int), 20)
    steps = round(2 * np.pi * radius / 1.5)
    offsets = np.round(Ellipse(0.0, 0.0, radius, radius, 0.0).points(steps)).astype(int)
    for i, j in ((0, 0), (3, 40), (15, 21), (30, 41)):
        around = [padded[2 * i + dv + 20, 2 * j + du + 20] for du, dv in offsets]
        assert sums[i, j] == pytest.approx(np.mean(around), abs=1e-4)

"""The ray caster against closed forms and against a patient march along each ray."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.lens import moved, pack_device, pixel, ray
from simulator.pack import evaluate, pack
from simulator.panel import Hole, Panel, Rivet, Seam, Skin, Slot
from simulator.random_panel import Variety, random_panel
from simulator.relief import BACKGROUND, COURSE, HEAD, R_OUTER, R_RING_X, R_RING_Y, STEP, WIDTH, Relief
from simulator.rig import RigDesign, aim_frame, virtual_rig
from simulator.survey import plate_heights, seen, sides_at
from tests.support.random_seams import crossing_seams
from tests.support.whole_panel import meet, surface_heights

EYE = np.array([-140.0, 20.0, 690.0])


def rays_to(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit directions from EYE to places on z = 0."""
    d = np.stack([x, y, np.zeros_like(x)], axis=1) - EYE
    return d / np.linalg.norm(d, axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("skin", "implicit"),
    [
        (Skin(), lambda p: p[:, 2]),
        (Skin(900, 900), lambda p: np.linalg.norm(p - [0, 0, -900], axis=1) - 900),
        (Skin(-900, -900), lambda p: 900 - np.linalg.norm(p - [0, 0, 900], axis=1)),
        (Skin(700, math.inf), lambda p: np.hypot(p[:, 0], p[:, 2] + 700) - 700),
        (Skin(700, math.inf, 90.0), lambda p: np.hypot(p[:, 1], p[:, 2] + 700) - 700),
        # Torus about an axis along y through z = −1500, tube radius 600.
        (Skin(1500, 600), lambda p: np.hypot(np.hypot(p[:, 0], p[:, 2] + 1500) - 900, p[:, 1]) - 600),
    ],
    ids=["plane", "sphere", "bowl", "cylinder", "turned cylinder", "torus"],
)
def test_rays_meet_the_skin_exactly(skin, implicit, rng):
    x, y = rng.uniform(-130, 130, 500), rng.uniform(-90, 90, 500)
    points, kinds = meet(pack(Panel(skin=skin)), EYE, rays_to(x, y))
    inside = kinds != BACKGROUND
    assert inside.sum() > 400
    assert np.abs(implicit(points[inside])).max() < 1e-8


def everything(rng: np.random.Generator) -> Relief:
    seams = crossing_seams(rng, "T")
    base = random_panel(rng, Variety(rivets=(14, 14), slots=0.5, partial_rings=0.5, holes=2, cables=1), seams)
    return pack(base)


def near_features(relief: Relief, rng: np.random.Generator, n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places on the whole panel and around, half of them near a seam or a rim."""
    x, y = rng.uniform(-152, 152, n), rng.uniform(-107, 107, n)
    quarter = n // 4
    seams = rng.integers(0, len(relief.seams), quarter)
    xi, eta = rng.uniform(0, 250, quarter), rng.uniform(-4, 4, quarter)
    row = relief.seams[seams]
    x[:quarter] = row[:, 0] + xi * row[:, 2] - eta * row[:, 3]
    y[:quarter] = row[:, 1] + xi * row[:, 3] + eta * row[:, 2]
    rivets = relief.rivets[rng.integers(0, len(relief.rivets), quarter)]
    angle, rho = rng.uniform(0, 2 * np.pi, quarter), rivets[:, R_OUTER] * rng.uniform(0.8, 1.2, quarter)
    x[quarter : 2 * quarter] = rivets[:, R_RING_X] + rho * np.cos(angle)
    y[quarter : 2 * quarter] = rivets[:, R_RING_Y] + rho * np.sin(angle)
    return x, y


def march(relief: Relief, start: NDArray[np.float64], end: NDArray[np.float64], n: int = 6000) -> NDArray[np.float64]:
    """(rays,) least height above the panel on the way from start to end, both ends left out."""
    share = np.linspace(0, 1, n)[1:-1]
    points = start[:, None, :] + share[None, :, None] * (end - start)[:, None, :]
    flat = points.reshape(-1, 3)
    z, _ = surface_heights(relief, flat[:, 0].copy(), flat[:, 1].copy())
    return (flat[:, 2] - z).reshape(len(start), -1).min(axis=1)


def test_hits_lie_on_the_surface_and_nothing_is_in_front_of_them(rng):
    relief = everything(rng)
    directions = rays_to(*near_features(relief, rng, 2000))
    points, kinds = meet(relief, EYE, directions)
    floor = kinds >= 0
    z, _ = surface_heights(relief, points[floor, 0].copy(), points[floor, 1].copy())
    assert np.abs(points[floor, 2] - z).max() < 1e-8
    assert (kinds == -1).sum() > 5, "some rays should meet walls"
    # From 60 mm before the hit to 1 nm before it.
    clearance = march(relief, points - 60 * directions, points - 1e-6 * directions, 1000)
    assert clearance.min() > -1e-5


def test_walls_stand_on_the_borders_of_pieces(rng):
    relief = everything(rng)
    points, kinds = meet(relief, EYE, rays_to(*near_features(relief, rng, 8000)))
    walls = points[kinds == -1]
    d = (walls - EYE) / np.linalg.norm(walls - EYE, axis=1, keepdims=True)
    before, after = walls - 1e-5 * d, walls + 1e-5 * d
    above = before[:, 2] - surface_heights(relief, before[:, 0].copy(), before[:, 1].copy())[0]
    below = after[:, 2] - surface_heights(relief, after[:, 0].copy(), after[:, 1].copy())[0]
    assert len(walls) > 50
    assert (above > 0).all()
    assert (below < 0).all()


def test_shadows_agree_with_a_march_towards_the_light(rng):
    relief = everything(rng)
    points, kinds = meet(relief, EYE, rays_to(*near_features(relief, rng, 2500)))
    # A march of 12 mm leaves every gap; from the background it would have to be longer.
    points = points[(kinds >= 0) & (kinds != BACKGROUND)] + [0, 0, 1e-4]
    light = np.array([60.0, 120.0, 680.0])
    lit = seen(relief, points, light)
    towards = (light - points) / np.linalg.norm(light - points, axis=1, keepdims=True)
    clearance = march(relief, points, points + 12 * towards, 1200)
    sure = np.abs(clearance) > 2e-3
    dark = ~lit & (clearance < -2e-3)
    assert dark.sum() > 10
    np.testing.assert_array_equal(lit[sure & (clearance < 0)], False)
    assert lit[clearance > 0].mean() > 0.99


def test_panel_casts_its_shadow_on_the_background():
    relief = pack(Panel(background_mm=40.0))
    light = np.array([0.0, 0.0, 700.0])
    # By similar triangles the border at x = 150 throws its shadow to 150 · 740 / 700.
    edge = 150 * 740 / 700
    points = np.array([[edge - 0.01, 0.0, -40 + 1e-6], [edge + 0.01, 0.0, -40 + 1e-6]])
    np.testing.assert_array_equal(seen(relief, points, light), [False, True])


def test_head_is_a_flat_disc_of_its_diameter_height_and_tilt():
    rivet = Rivet("R", 40.0, -30.0, 9.0, 0.2, 1.5, 70.0)
    relief = pack(Panel(skin=Skin(800, 1200, 30), rivets=(rivet,)))
    x, y = np.meshgrid(np.linspace(35, 45, 801), np.linspace(-35, -25, 801))
    z, kinds = surface_heights(relief, x.ravel(), y.ravel())
    head = np.stack([x.ravel(), y.ravel(), z], axis=1)[kinds == HEAD]
    centre = head.mean(axis=0)
    normal = np.linalg.svd(head - centre, full_matrices=False)[2][2]
    assert np.abs((head - centre) @ normal).max() < 1e-9
    radii = np.linalg.norm(head - centre, axis=1)
    assert radii.max() == pytest.approx(4.5, abs=0.01)
    side = sides_at(relief, np.array([40.0]), np.array([-30.0]))
    h = 1e-3
    grid = [plate_heights(relief, np.array([40.0 + a]), np.array([-30.0 + b]), side)[0]
            for a, b in ((0, 0), (h, 0), (-h, 0), (0, h), (0, -h))]  # fmt: skip
    skin = np.array([-(grid[1] - grid[2]) / 2 / h, -(grid[3] - grid[4]) / 2 / h, 1.0])
    skin /= np.linalg.norm(skin)
    assert math.degrees(math.acos(abs(skin @ normal))) == pytest.approx(1.5, abs=1e-4)
    assert (centre - [40.0, -30.0, grid[0]]) @ skin == pytest.approx(0.2, abs=1e-4)


def test_crown_and_slot_shape_the_head():
    rivet = Rivet("R", 0.0, 0.0, 8.0, 0.1, crown_mm=0.3, slot=Slot(5.0, 1.0, 0.4))
    relief = pack(Panel(rivets=(rivet,)))
    # Rim at 0.1 − 0.3/2; just inside it; in the slot; beside it.
    x, y = np.array([3.9999999, 0.0, 0.0]), np.array([0.0, 0.2, 2.0])
    z, _ = surface_heights(relief, x, y)
    assert z[0] == pytest.approx(-0.05, abs=1e-6)
    assert z[1] == pytest.approx(-0.05 - 0.4)
    assert z[2] == pytest.approx(-0.05 + 0.3 * (1 - 0.25))


def test_tables_in_kernels_agree_with_numpy(rng):
    seam = Seam("J", ((-60.0, -110.0), (-50.0, 0.0), (-58.0, 110.0)), (0.8, 1.4, 1.1), (0.1, -0.2, 0.3))
    relief = pack(Panel(seams=(seam,)))
    xi = rng.uniform(15, 200, 200)
    slope = evaluate(relief, 0, COURSE, xi, 1)
    row, scale = relief.seams[0], np.sqrt(1 + slope**2)
    for sign, side in ((1, 1), (-1, 0)):
        t = sign * (0.5 * evaluate(relief, 0, WIDTH, xi) + 0.5)
        along, across = xi - t * slope / scale, evaluate(relief, 0, COURSE, xi) + t / scale
        x = row[0] + along * row[2] - across * row[3]
        y = row[1] + along * row[3] + across * row[2]
        z, _ = surface_heights(relief, x, y)
        np.testing.assert_array_equal(sides_at(relief, x, y), side)
        np.testing.assert_allclose(z, sign * 0.5 * evaluate(relief, 0, STEP, along), atol=1e-12)


def test_a_seam_ends_where_another_begins():
    trunk = Seam("A", ((0.0, -110.0), (0.0, 110.0)), (2.0,))
    branch = Seam("B", ((10.0, 0.0), (160.0, 0.0)), (1.0,), (0.4,), starts_at="A")
    relief = pack(Panel(seams=(trunk, branch)))
    z, _ = surface_heights(relief, np.array([50.0, 50.0, -50.0, -50.0]), np.array([20.0, -20.0, 20.0, -20.0]))
    np.testing.assert_allclose(z, [0.2, -0.2, 0.0, 0.0], atol=1e-12)
    z, _ = surface_heights(relief, np.array([30.0, 3.0, -30.0]), np.zeros(3))
    np.testing.assert_allclose(z, [-3.0, -3.0, 0.0], atol=1e-12)


def test_hole_is_as_deep_as_it_is_said_to_be():
    z, _ = surface_heights(
        pack(Panel(holes=(Hole(10.0, 5.0, 4.0, 2.5),))), np.array([10.0, 13.0]), np.array([5.0, 5.0])
    )
    np.testing.assert_allclose(z, [-2.5, 0.0])


def test_lens_kernels_agree_with_the_rig_model(rng):
    rig = virtual_rig(rng, RigDesign(spread=3.0))
    R, t = aim_frame(rig)
    for device in (rig.left, rig.right, rig.projector):
        posed = moved(device, R, t)
        packed = pack_device(posed)
        uv = rng.uniform(0, 1, (50, 2)) * (device.width, device.height)
        out = np.empty(3)
        for k, direction in enumerate(device.rays(uv)):
            ray.py_func(packed, *uv[k], out)
            np.testing.assert_allclose(out, direction @ R, atol=1e-11)
        points = rng.uniform(-80, 80, (50, 3))
        expected = device.project(points @ R.T + t)
        got = np.array([pixel.py_func(packed, p) for p in points])
        np.testing.assert_allclose(got, expected, atol=1e-8)

"""The closed loop: the overlay, drawn with a calibrated rig, is projected by the true one and looked at.

Where a ring lies on the simulated panel is measured in the left camera's picture and held against the head it belongs
to. The rig is calibrated from sightings of a board as noisy as real ones, so it is not the one that projects.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from metrology.arrays import Array
from metrology.calibration.calibrate import calibrate_sightings
from metrology.calibration.observations import Sighting
from metrology.cloud import DecodedView, Reconstruction
from metrology.overlay import OverlaySettings, draw_overlay
from metrology.overlay.marks import circle_points
from metrology.results import Rivet, Severity
from metrology.rig import Device, Rig
from simulator.panel import Panel, Skin
from simulator.panel import Rivet as PanelRivet
from simulator.rig import RigDesign
from simulator.scene import Stage, make_rig, set_up
from simulator.spec import Camera, Placement, RigSpec, SceneKeys, SimulationSpec
from simulator.survey import plate_heights, plate_normals
from tests.support.rows import rivet_at
from tests.support.shown_image import look_at_image

DESIGN = RigDesign(camera_width=609, camera_height=463, camera_focal_px=1365.0)
SPOTS = [(x, y) for x in (-105.0, -35.0, 35.0, 105.0) for y in (-60.0, 0.0, 60.0)]


def spec(skin: Skin) -> SimulationSpec:
    rivets = tuple(PanelRivet(f"R{k:02d}", x, y, (5.0, 8.0)[k % 2], 0.05) for k, (x, y) in enumerate(SPOTS, 1))
    return SimulationSpec(
        "flushline-simulation/1",
        SceneKeys("MSN-1", "P1", "S1", "2026-11-20T08:15:00Z"),
        Panel(skin=skin, rivets=rivets),
        RigSpec(design=DESIGN),
        (Placement((2.0, -3.0, 5.0), (4.0, -6.0, 2.0)),),
        camera=Camera(samples=16),
    )


def calibrated(true: Rig, rng: np.random.Generator) -> Rig:
    """The rig as calibrated from six poses of a board: 0.02 px noise in the cameras, 0.1 px in the projector."""
    x, y = np.meshgrid(np.arange(9) * 24.0, np.arange(6) * 26.0)
    board = np.column_stack([x.ravel(), y.ravel()])
    solid = np.column_stack([board - board.mean(0), np.zeros(len(board))])
    sightings = []
    for pose in range(6):
        turn = Rotation.from_euler(
            "xyz", [18.0 * (pose % 3 - 1), 18.0 * (pose // 3 - 1) + 8, 10.0 * pose], degrees=True
        )
        points = solid @ turn.as_matrix().T + [-5.0, 5.0, 700.0 + 15 * (pose % 4)] + [150.0 * 700 / 716, 0, 0]
        for name, sigma in (("left", 0.02), ("right", 0.02), ("projector", 0.1)):
            device: Device = getattr(true, name)
            pixels = device.project(points)
            seen = np.flatnonzero(device.inside(pixels))
            noisy = pixels[seen] + rng.normal(0, sigma, (len(seen), 2))
            sightings.append(Sighting("board", name, pose, seen, board[seen], np.zeros(len(seen)), noisy, sigma))
    sizes = {name: (getattr(true, name).width, getattr(true, name).height) for name in ("left", "right", "projector")}
    return calibrate_sightings(sightings, sizes).rig("calibrated", "2026-11-01T08:00:00Z")


def triangulated(rig: Rig, left: Array, right: Array) -> Array:
    """(n, 3) points nearest to both cameras' rays through pixels (n, 2)."""
    a, b = rig.left.rays(left), rig.right.rays(right)
    base = rig.right.centre
    ab = (a * b).sum(1)
    s = ((a * base).sum(1) - ab * (b * base).sum(1)) / (1 - ab**2)
    t = ab * s - (b * base).sum(1)
    return np.asarray((s[:, None] * a + base + t[:, None] * b) / 2)


def heads(stage: Stage) -> list[tuple[str, Array, float]]:
    """Visible rivets: id, centre in the true rig's frame, diameter."""
    return [(r.id, np.array(r.xyz_mm), r.diameter_mm) for r in stage.truth.rivets if r.visible]


def cloud(stage: Stage, rig: Rig, rng: np.random.Generator) -> Reconstruction:
    """The skin as it is measured with the calibrated rig, every second pixel."""
    true = stage.rig
    size = true.left.height, true.left.width
    v, u = np.mgrid[: size[0] : 2, : size[1] : 2].reshape(2, -1).astype(float)
    rays = true.left.rays(np.column_stack([u, v])) @ stage.pose.R
    eye = stage.pose.to_panel(np.zeros(3))
    reach = -eye[2] / rays[:, 2]
    for _ in range(8):  # the skin is nearly level along a ray's last millimetres
        at = eye + reach[:, None] * rays
        above = at[:, 2] - plate_heights(stage.relief, at[:, 0], at[:, 1], np.zeros(len(at), np.int64))
        reach = reach - above / rays[:, 2]
    surface = stage.pose.to_rig(eye + reach[:, None] * rays)
    right = true.right.project(surface) + rng.normal(0, 0.01, (len(surface), 2))
    points = np.full((*size, 3), np.nan, np.float32)
    points[v.astype(int), u.astype(int)] = triangulated(rig, np.column_stack([u, v]), right)
    blank, flags = np.zeros(size, np.float32), np.zeros(size, np.uint16)
    view = DecodedView(blank, blank, blank, blank, flags)
    return Reconstruction(rig, view, view, points, blank, flags)


def measured(stage: Stage, rig: Rig, severity: Severity, rng: np.random.Generator) -> list[Rivet]:
    """The heads as found in both pictures to 0.05 px and placed with the calibrated rig."""
    rivets = []
    for name, centre, diameter in heads(stage):
        left, right = (d.project(centre) + rng.normal(0, 0.05, 2) for d in (stage.rig.left, stage.rig.right))
        x, y, z = triangulated(rig, left[None], right[None])[0]
        size = diameter * rig.left.K[0, 0] / z
        rivets.append(
            rivet_at(
                name, (x, y, z), left, diameter, size, u_right_px=right[0], v_right_px=right[1],
                height_mean_mm=0.05, severity=severity,
            )
        )  # fmt: skip
    return rivets


def landed(stage: Stage, light: Array, centre: Array, diameter: float) -> Array:
    """(2,) where a projected ring lies beside its head along the skin, mm.

    Centre of gravity of the ring's light in the left picture, held against that of a ring of the head's own size.
    """
    left = stage.rig.left
    at = stage.pose.to_panel(centre)
    normal = stage.pose.R @ plate_normals(stage.relief, at[:1], at[1:2], np.zeros(1, np.int64))[0]
    rim = circle_points(centre, normal, diameter / 2, left.project, 256)
    middle = rim.mean(0)
    v, u = np.mgrid[: left.height, : left.width]
    away = np.stack([u, v], -1) - middle
    radius = np.linalg.norm(rim - middle, axis=1).mean()
    distance = np.hypot(away[..., 0], away[..., 1])
    near = (distance > 0.5 * radius) & (distance < radius + 1.0 * left.K[0, 0] / centre[2])
    weight = light * near
    shift = (weight[..., None] * away).sum((0, 1)) / weight.sum()
    # Millimetres along the skin per pixel, from the rim itself.
    first = np.cross(normal, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(normal, first)])
    jacobian = (left.project(centre + axes) - left.project(centre - axes)).T / 2
    return np.asarray(np.linalg.solve(jacobian, shift))


@pytest.fixture(scope="module")
def rigs() -> tuple[Rig, Rig]:
    """The true rig and the calibrated one."""
    true = make_rig(spec(Skin()))
    rig = calibrated(true, np.random.default_rng(5))
    assert not np.allclose(rig.projector.K, true.projector.K, rtol=1e-6)
    return true, rig


@pytest.mark.slow
def test_marks_land_on_their_rivets(rigs: tuple[Rig, Rig]) -> None:
    rng = np.random.default_rng(5)
    panel = spec(Skin(radius_1_mm=900.0, radius_2_mm=2500.0, direction_deg=20.0))
    true, rig = rigs
    stage = set_up(panel, true, panel.placements[0])
    overlay = draw_overlay(
        {"rivet": measured(stage, rig, "green", rng), "seam station": []},
        cloud(stage, rig, rng),
        ["MSN-1 P1 S1"],
        OverlaySettings(background=0),
    )
    shown = look_at_image(stage, panel, overlay.image()[..., 1])["left"]
    white = look_at_image(stage, panel, np.full((true.projector.height, true.projector.width), 255, np.uint8))["left"]
    dark = look_at_image(stage, panel, np.zeros((true.projector.height, true.projector.width), np.uint8))["left"]
    light = (shown - dark) / np.maximum(white - dark, 1.0)
    off = np.array([landed(stage, light, centre, diameter) for _, centre, diameter in heads(stage)])
    assert len(off) == len(SPOTS)
    rms = math.sqrt((off**2).sum(1).mean())
    print(f"marks land {rms:.3f} mm RMS from their rivets, the worst {np.hypot(*off.T).max():.3f} mm")
    assert rms <= 0.15

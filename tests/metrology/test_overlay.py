"""The overlay lands on what it marks, stays legible and says what it cannot show."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from metrology.cloud import DecodedView, Reconstruction
from metrology.errors import UsageError
from metrology.overlay import Overlay, OverlaySettings, draw_overlay
from metrology.overlay.marks import COLOURS
from metrology.overlay.paint import text_size
from metrology.results import Rivet, SeamStation, Severity
from metrology.rig import Device, Rig

SIZE = (320, 240)


def device(width: int, height: int, f: float, yaw: float, centre: tuple[float, float, float]) -> Device:
    K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1.0]])
    cos, sin = np.cos(yaw), np.sin(yaw)
    R = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    return Device(width, height, K, np.array([-0.05, 0.02, 1e-4, -1e-4]), R, -R @ np.array(centre))


@pytest.fixture
def scene() -> Reconstruction:
    """A tilted plane seen by a small rig: z = 700 + 0.1 x."""
    left = device(*SIZE, 720.0, 0.0, (0, 0, 0))
    rig = Rig("r", "", left, device(*SIZE, 720.0, 0.4, (290, 0, 60)), device(1280, 800, 2560.0, 0.21, (150, -20, 20)))
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    xy = left.normalized(np.stack([u, v], -1).astype(float))
    z = 700 / (1 - 0.1 * xy[..., 0])
    points = np.dstack([xy * z[..., None], z]).astype(np.float32)
    blank = np.zeros(SIZE[::-1], np.float32)
    flags = np.zeros(SIZE[::-1], np.uint16)
    view = DecodedView(blank, blank, blank, blank, flags)
    return Reconstruction(rig, view, view, points, blank, flags)


def rivet(name: str, x: float, y: float, severity: Severity | None, rig: Rig) -> Rivet:
    centre = (x, y, 700 + 0.1 * x)
    u, v = rig.left.project(centre)
    return Rivet(name, *centre, u, v, None, None, 8.0, 8.2, 8.0, 0.0, 1.0, height_mean_mm=0.123, severity=severity)


def station(s: float, severity: Severity | None, rig: Rig) -> SeamStation:
    point = (20.0, s, 702.0)
    u, v = rig.left.project(point)
    return SeamStation("S01", s, *point, u, v, step_mm=0.1, width_mm=2.0, severity=severity)


def test_rings_lie_on_the_rim_as_the_projector_sees_it(scene: Reconstruction) -> None:
    overlay = draw_overlay([rivet("R01", -30, 10, "green", scene.rig)], [], scene, [])
    (ring,) = overlay.strokes
    normal = np.array([0.1, 0, -1]) / np.hypot(0.1, 1)
    along = np.array([1, 0, 0.1]) / np.hypot(0.1, 1)
    turn = np.linspace(0, 2 * np.pi, 720)[:, None]
    rim = np.array([-30, 10, 697]) + 4.0 * (np.cos(turn) * along + np.sin(turn) * np.cross(normal, along))
    expected = scene.rig.projector.project(rim)
    away = np.linalg.norm(ring.points[:, None] - expected[None], axis=2).min(1)
    assert away.max() < 0.1
    painted = np.argwhere((overlay.image() == COLOURS["green"]).all(-1))[:, ::-1]
    near = np.linalg.norm(painted[:, None] - expected[None], axis=2).min(1)
    assert np.quantile(near, 0.4) < 2.0


def test_severities_differ_in_shape_as_well_as_colour(scene: Reconstruction) -> None:
    grades: list[Severity | None] = ["green", "blue", "red", None]
    shapes = [draw_overlay([rivet("R", 0, 0, s, scene.rig)], [], scene, []).strokes for s in grades]
    assert len({tuple((len(x.points), x.closed, x.width) for x in shape) for shape in shapes}) == 4


def boxes(overlay: Overlay) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(x.centre, np.array(text_size(x.text, x.height)) / 2) for x in overlay.labels]


def test_values_do_not_cover_each_other_or_the_rivets(scene: Reconstruction) -> None:
    rivets = [rivet(f"R{i}{j}", 25.0 * i, 24.0 * j, "red", scene.rig) for i in range(-4, 5) for j in range(-2, 3)]
    overlay = draw_overlay(rivets, [], scene, ["MSN-1 P1 S1", "2026-11-20"])
    values = boxes(overlay)[: len(rivets)]
    for k, (centre, half) in enumerate(values):
        for other, reach in values[k + 1 :]:
            assert (np.abs(centre - other) > half + reach - 1).any()
        for item in rivets:
            pixel = scene.rig.projector.project((item.x_mm, item.y_mm, item.z_mm))
            assert (np.abs(centre - pixel) > half).any()
        assert scene.rig.projector.inside(centre - half)
        assert scene.rig.projector.inside(centre + half)


def test_every_rivet_has_its_value_and_title_lines_are_there(scene: Reconstruction) -> None:
    overlay = draw_overlay([rivet("R01", 0, 0, "blue", scene.rig)], [], scene, ["MSN-1 P1 S1"])
    texts = [x.text for x in overlay.labels]
    assert "+0.12" in texts
    assert "MSN-1 P1 S1" in texts


def test_seam_marks_follow_severity(scene: Reconstruction) -> None:
    grades: list[Severity | None] = ["green"] * 5 + ["red"] * 3 + [None] * 2
    stations = [station(2.0 * k, grade, scene.rig) for k, grade in enumerate(grades)]
    overlay = draw_overlay([], stations, scene, [])
    colours = [x.colour for x in overlay.strokes]
    assert colours.count(COLOURS["green"]) == 2  # one line on each side
    assert colours.count(COLOURS["red"]) == 6  # a bar on each side of each station
    assert colours.count(COLOURS[None]) == 4
    assert "+0.10 | 2.00" in [x.text for x in overlay.labels]


def test_what_the_projector_does_not_reach_is_listed(scene: Reconstruction) -> None:
    overlay = draw_overlay(
        [rivet("R01", 0, 0, "green", scene.rig), rivet("R02", 900, 0, "red", scene.rig)], [], scene, []
    )
    assert overlay.outside == ("R02",)


def test_unmeasured_rivet_is_marked_and_one_without_position_is_not(scene: Reconstruction) -> None:
    nowhere = Rivet("R01", None, None, None, 10, 10, None, None, None, 8, 8, 0, 1, reason="no points")
    overlay = draw_overlay([nowhere], [], scene, [])
    assert overlay.strokes == ()


def test_svg_is_well_formed_and_has_the_projector_size(scene: Reconstruction) -> None:
    root = ET.fromstring(draw_overlay([rivet("R01", 0, 0, "red", scene.rig)], [], scene, ["A & B"]).svg())
    assert (root.get("width"), root.get("height")) == ("1280", "800")


def test_background_can_be_dimmed(scene: Reconstruction) -> None:
    image = draw_overlay([], [], scene, [], OverlaySettings(background=7)).image()
    assert image.shape == (800, 1280, 3)
    assert np.median(image) == 7
    with pytest.raises(UsageError, match="0 … 255"):
        OverlaySettings(background=300)

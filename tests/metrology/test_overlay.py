"""The overlay lands on what it marks, stays legible and says what it cannot show."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from metrology.cloud import DecodedView, Reconstruction
from metrology.defects.row import Defect, DefectKind
from metrology.errors import UsageError
from metrology.holes.verdict import hole_note
from metrology.overlay import OverlaySettings, Words, draw_overlay
from metrology.overlay.marks import COLOURS, Label, arrow_marks
from metrology.overlay.paint import text_size
from metrology.results import Hole, HoleKind, Rivet, SeamStation, Severity
from metrology.rig import Device, Rig
from tests.support.rows import rivet_at, station_at

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
    return rivet_at(name, centre, (u, v), 8.0, 8.2, minor_px=8.0, height_mean_mm=0.123, severity=severity)


def station(s: float, severity: Severity | None, rig: Rig) -> SeamStation:
    point = (20.0, s, 702.0)
    u, v = rig.left.project(point)
    return station_at("S01", s, point, (u, v), step_mm=0.1, width_mm=2.0, severity=severity)


def test_all_that_stands_beside_values_has_words() -> None:
    blank = Words(text=lambda _: "-", decimal=",")
    hole = Hole("H1", x_mm=0.0, y_mm=0.0, z_mm=700.0, u_px=1.0, v_px=2.0, kind="open hole", fastener_id="R04")
    notes = [hole_note(replace(hole, kind=kind)) for kind in get_args(HoleKind)]
    for note in (*notes, *(kind.upper() for kind in get_args(DefectKind))):
        assert re.fullmatch(r"-( R04)?", blank.note(note)), note
    assert blank.note("AT LEAST DENT") == "- -"
    assert blank.note("SIZE 5.0") == "- 5,0"


@pytest.mark.parametrize("minor_px", [10.0, 19.0], ids=["long", "round"])
def test_a_defect_has_its_outline_and_an_arrow_along_its_length(scene: Reconstruction, minor_px: float) -> None:
    u, v = (float(x) for x in scene.rig.left.project((-10.0, 5.0, 699.0)))
    defect = Defect(
        "D01", x_mm=-10.0, y_mm=5.0, z_mm=699.0, u_px=u, v_px=v, kind="dent", depth_mm=0.2, length_mm=20.0,
        major_px=20.0, minor_px=minor_px, direction_deg=30.0, severity="green",
    )  # fmt: skip
    overlay = draw_overlay({"defect": [defect]}, scene, [])
    rim, *arrow = [x for x in overlay.strokes if x.feature == "D01"]
    # Points on the skin under the ellipse's ends in the left image, as the projector sees them.
    along = np.array([np.cos(np.radians(30)), np.sin(np.radians(30))])
    ends = scene.rig.left.rays(np.array([u, v]) + np.array([[10.0], [-10.0]]) * along)
    places = scene.rig.projector.project(ends * (700 / (ends[:, 2] - 0.1 * ends[:, 0]))[:, None])
    assert np.linalg.norm(rim.points[[0, len(rim.points) // 2]] - places, axis=1).max() < 0.2
    if minor_px > 15.0:
        assert arrow == []
        return
    shaft = arrow[0].points[1] - arrow[0].points[0]
    way = places[0] - places[1]
    assert abs(shaft @ way) / np.linalg.norm(shaft) / np.linalg.norm(way) == pytest.approx(1.0, abs=1e-3)


def test_rings_lie_on_the_rim_as_the_projector_sees_it(scene: Reconstruction) -> None:
    overlay = draw_overlay({"rivet": [rivet("R01", -30, 10, "green", scene.rig)], "seam station": []}, scene, [])
    (ring,) = [x for x in overlay.strokes if x.feature == "R01"]
    normal = np.array([0.1, 0, -1]) / np.hypot(0.1, 1)
    along = np.array([1, 0, 0.1]) / np.hypot(0.1, 1)
    turn = np.linspace(0, 2 * np.pi, 720)[:, None]
    rim = np.array([-30, 10, 697]) + 4.0 * (np.cos(turn) * along + np.sin(turn) * np.cross(normal, along))
    expected = scene.rig.projector.project(rim)
    away = np.linalg.norm(ring.points[:, None] - expected[None], axis=2).min(1)
    assert away.max() < 0.1
    # As painted: what lights up around the rivet has the rim's middle as its centre of gravity.
    image = draw_overlay(
        {"rivet": [rivet("R01", -30, 10, "green", scene.rig)], "seam station": []}, scene, [], OverlaySettings(0)
    ).image()
    centre = expected.mean(0)
    columns, rows = np.meshgrid(np.arange(1280), np.arange(800))
    near = np.hypot(columns - centre[0], rows - centre[1]) < 1.2 * np.ptp(expected[:, 0]) / 2
    light = image[..., 1] * near
    painted = np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()
    np.testing.assert_allclose(painted, centre, atol=0.1)


def test_severities_differ_in_shape_as_well_as_colour(scene: Reconstruction) -> None:
    grades: list[Severity | None] = ["green", "blue", "red", None]
    rivets = [draw_overlay({"rivet": [rivet("R", 0, 0, s, scene.rig)], "seam station": []}, scene, []) for s in grades]
    seams = [
        draw_overlay({"rivet": [], "seam station": [station(2.0 * k, s, scene.rig) for k in range(9)]}, scene, [])
        for s in grades
    ]
    for drawn in (rivets, seams):
        shapes = {tuple((len(x.points), x.closed, x.width) for x in o.strokes if x.feature) for o in drawn}
        assert len(shapes) == 4


def boxes(labels: Iterable[Label]) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(x.centre, np.array(text_size(x.text, x.height)) / 2) for x in labels]


def test_values_do_not_cover_each_other_or_the_rivets(scene: Reconstruction) -> None:
    rivets = [rivet(f"R{i}{j}", 25.0 * i, 24.0 * j, "red", scene.rig) for i in range(-4, 5) for j in range(-2, 3)]
    overlay = draw_overlay({"rivet": rivets, "seam station": []}, scene, ["MSN-1 P1 S1", "2026-11-20"])
    assert [x.text for x in overlay.labels].count("+0.12") == len(rivets)
    everything = boxes(overlay.labels)
    for k, (centre, half) in enumerate(everything):
        for other, reach in everything[k + 1 :]:
            assert (np.abs(centre - other) > half + reach - 1).any()
        for item in rivets:
            pixel = scene.rig.projector.project((item.x_mm, item.y_mm, item.z_mm))
            assert (np.abs(centre - pixel) > half).any()
        assert scene.rig.projector.inside(centre - half)
        assert scene.rig.projector.inside(centre + half)


def test_every_rivet_has_its_value_and_title_lines_are_there(scene: Reconstruction) -> None:
    overlay = draw_overlay(
        {"rivet": [rivet("R01", 0, 0, "blue", scene.rig)], "seam station": []}, scene, ["MSN-1 P1 S1"]
    )
    texts = [x.text for x in overlay.labels]
    assert "+0.12" in texts
    assert "MSN-1 P1 S1" in texts


def test_a_value_that_rounds_to_nothing_has_no_minus(scene: Reconstruction) -> None:
    flush = replace(rivet("R01", 0, 0, "green", scene.rig), height_mean_mm=-0.0029)
    assert "+0.00" in [x.text for x in draw_overlay({"rivet": [flush], "seam station": []}, scene, []).labels]


def test_seam_marks_follow_severity(scene: Reconstruction) -> None:
    grades: list[Severity | None] = ["green"] * 5 + ["red"] * 3 + [None] * 2
    stations = [station(2.0 * k, grade, scene.rig) for k, grade in enumerate(grades)]
    overlay = draw_overlay({"rivet": [], "seam station": stations}, scene, [])
    colours = [x.colour for x in overlay.strokes if x.feature == "S01" and x.width > 1]
    assert colours.count(COLOURS["green"]) == 2  # one line on each side
    assert colours.count(COLOURS["red"]) == 2 * 2 * 2  # on each side a bar and its crossbar, at both ends of the run
    assert colours.count(COLOURS[None]) == 2 * 2 * 2  # two dots on each side of both stations
    assert "+0.10 | 2.00" in [x.text for x in overlay.labels]


def test_what_the_projector_does_not_reach_is_listed(scene: Reconstruction) -> None:
    overlay = draw_overlay(
        {"rivet": [rivet("R01", 0, 0, "green", scene.rig), rivet("R02", 900, 0, "red", scene.rig)], "seam station": []},
        scene,
        [],
    )
    assert overlay.outside == ("R02",)


def test_unmeasured_rivet_is_marked_and_one_without_position_is_not(scene: Reconstruction) -> None:
    nowhere = rivet_at("R01", (None, None, None), (10, 10), None, 8.0, reason="no points")
    overlay = draw_overlay({"rivet": [nowhere], "seam station": []}, scene, [])
    assert not any(x.feature for x in (*overlay.strokes, *overlay.labels))


def test_svg_is_well_formed_and_has_the_projector_size(scene: Reconstruction) -> None:
    root = ET.fromstring(
        draw_overlay({"rivet": [rivet("R01", 0, 0, "red", scene.rig)], "seam station": []}, scene, ["A & B"]).svg()
    )
    assert (root.get("width"), root.get("height")) == ("1280", "800")


def test_background_can_be_dimmed(scene: Reconstruction) -> None:
    image = draw_overlay({"rivet": [], "seam station": []}, scene, [], OverlaySettings(background=7)).image()
    assert image.shape == (800, 1280, 3)
    assert np.median(image) == 7
    with pytest.raises(UsageError, match="0 … 255"):
        OverlaySettings(background=300)


def px_per_mm_down(scene: Reconstruction, at: np.ndarray) -> float:
    """Projector pixels per millimetre down the skin (the plane is level in y)."""
    ahead = scene.rig.projector.project(np.stack([at, at + np.array([0, 1.0, 0])]))
    return float(np.linalg.norm(ahead[1] - ahead[0]))


def test_capital_letters_are_at_least_four_millimetres_on_the_skin(scene: Reconstruction) -> None:
    grid = [(x, y) for x in (-90, 0, 90) for y in (-60, 0, 60)]
    rivets = [rivet(f"R{k}", x, y, "blue", scene.rig) for k, (x, y) in enumerate(grid)]
    overlay = draw_overlay({"rivet": rivets, "seam station": []}, scene, ["H", "MSN-1"])
    for label in overlay.labels:
        assert label.height > 3.95 * px_per_mm_down(scene, np.array([0, 0, 700.0]))
    # As painted: the title's H.
    title = next(x for x in overlay.labels if x.text == "H")
    image = replace(overlay, labels=(replace(title, angle=0.0),), strokes=(), background=0).image()
    rows = np.flatnonzero(image.max((1, 2)) > 127)
    assert rows[-1] - rows[0] == pytest.approx(title.height, abs=1.1)


def test_text_stays_on_the_skin_and_in_the_picture(scene: Reconstruction) -> None:
    # The panel ends at the left camera's column 200: beyond it light falls on something else.
    points = scene.points.copy()
    points[:, 200:] = np.nan
    cut = replace(scene, points=points)
    rivets = [rivet(f"R{y}", x, y, "red", scene.rig) for x in (25, 34) for y in range(-60, 61, 30)]
    overlay = draw_overlay({"rivet": rivets, "seam station": []}, cut, ["MSN-1 P1 S1", "2026-11-20"])
    edge = scene.rig.projector.project((38.0, 0.0, 704.0))[0]
    for centre, half in boxes(overlay.labels):
        assert centre[0] + half[0] < edge + 10
        assert (centre - half > 0).all()
        assert (centre + half < (1280, 800)).all()


def test_text_keeps_off_what_stands_behind_the_panel(scene: Reconstruction) -> None:
    points = scene.points.copy()
    points[:, 200:] *= 1.15  # a wall, measured like the panel
    overlay = draw_overlay(
        {"rivet": [rivet("R", 34, 0, "red", scene.rig)], "seam station": []}, replace(scene, points=points), ["T"]
    )
    edge = scene.rig.projector.project((38.0, 0.0, 704.0))[0]
    assert all(centre[0] + half[0] < edge + 10 for centre, half in boxes(overlay.labels))


def test_rivets_cut_by_the_edge_are_drawn_and_listed(scene: Reconstruction) -> None:
    edge = next(x for x in range(400) if scene.rig.projector.project((float(x), 0.0, 700 + 0.1 * x))[0] > 1279)
    overlay = draw_overlay({"rivet": [rivet("R01", edge, 0, "red", scene.rig)], "seam station": []}, scene, ["T"])
    assert overlay.outside == ("R01",)
    texts = [x.text for x in overlay.labels]
    assert "beyond the picture: R01" in texts
    assert "+0.12" in texts
    for centre, half in boxes(overlay.labels):
        assert (centre + half < (1281, 801)).all()


def test_a_missing_rivet_is_shown_where_it_should_be(scene: Reconstruction) -> None:
    row = rivet("R07", 10, 10, None, scene.rig)
    row = replace(row, height_mean_mm=None, decision="not measured", reason="missing: no head found")
    overlay = draw_overlay({"rivet": [row], "seam station": []}, scene, [])
    assert "MISSING" in [x.text for x in overlay.labels if x.feature == "R07"]
    assert "NOT JUDGED" in [x.text for x in overlay.labels]


def test_the_legend_says_what_bars_and_question_marks_mean(scene: Reconstruction) -> None:
    rows = [replace(station(float(s), "green", scene.rig), width_mm=None) for s in range(0, 40, 2)]
    overlay = draw_overlay({"seam station": rows}, scene, [])
    texts = [x.text for x in overlay.labels]
    assert any(" | ?" in text for text in texts)
    assert {"values in mm", "SEAM: step | gap (before and after the bar)", "? not measured"} <= set(texts)


def test_values_near_a_limit_are_starred_and_the_star_is_explained(scene: Reconstruction) -> None:
    overlay = draw_overlay(
        {"rivet": [replace(rivet("R", 0, 0, "green", scene.rig), decision="conditional pass")], "seam station": []},
        scene,
        [],
    )
    texts = [x.text for x in overlay.labels]
    assert "+0.12*" in texts
    assert "* nearer to a limit than its uncertainty" in texts
    assert {"values in mm", "RIVET: height"} <= set(texts)


def test_where_there_is_no_room_grave_values_stay(scene: Reconstruction) -> None:
    spots = [(9.0 * i, 9.0 * j) for i in range(-14, 15) for j in range(-9, 10)]
    rivets = [rivet(f"R{k}", x, y, "red" if k % 37 == 0 else "green", scene.rig) for k, (x, y) in enumerate(spots)]
    overlay = draw_overlay({"rivet": rivets, "seam station": []}, scene, ["T"])
    values = [x for x in overlay.labels if x.feature]
    assert sum(x.colour == COLOURS["red"] for x in values) == sum(r.severity == "red" for r in rivets)
    assert sum(x.colour == COLOURS["green"] for x in values) < sum(r.severity == "green" for r in rivets)


def test_the_heads_of_a_long_arrow_stay_small() -> None:
    turn = np.linspace(0, 2 * np.pi, 80, endpoint=False)
    for long, barb in ((12.0, 0.25 * 0.7 * 12.0), (400.0, 21.0)):
        shaft, *heads = arrow_marks(np.stack([long * np.cos(turn), 3 * np.sin(turn)], axis=1), "blue", 3)
        assert np.ptp(shaft.points[:, 0]) == pytest.approx(1.4 * long)
        for head in heads:
            assert np.ptp(head.points[:, 0]) == pytest.approx(barb)
            assert np.ptp(head.points[:, 1]) == pytest.approx(2 * barb)

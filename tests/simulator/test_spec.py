"""Specifications: what is shipped is valid, what is wrong is named."""

from __future__ import annotations

import numpy as np
import pytest

from metrology.errors import SpecError
from simulator.pack import pack
from simulator.panel import Panel, Seam
from simulator.random_panel import Variety, random_panel, random_placement
from simulator.rig import aim_frame, virtual_rig, warmed
from simulator.spec import parse_spec, read_spec, shipped_spec
from tests.support.random_seams import SeamVariety, crossing_seams, random_seam

LEAST = """
format = "flushline-simulation/1"
[scene]
aircraft_serial = "A"
panel = "P"
station = "S"
captured_at = "2026-11-20T08:00:00Z"
"""


@pytest.mark.parametrize(
    ("name", "rivets", "seams"), [("demo", 8, 1), ("gage", 10, 1), ("standard_part", 16, 0), ("skin", 7, 1)]
)
def test_shipped_specifications_are_valid(name, rivets, seams):
    spec = shipped_spec(name)
    assert (len(spec.panel.rivets), len(spec.panel.seams)) == (rivets, seams)
    pack(spec.panel)


def test_standard_part_has_the_papers_rows():
    heights = np.array([r.height_mm for r in shipped_spec("standard_part").panel.rivets]).reshape(4, 4)
    # Means of the ground truth of Table 1.
    np.testing.assert_allclose(heights.mean(axis=1), [0.14175, 0.25375, 0.54175, 1.0425])


def test_least_specification_has_defaults():
    spec = parse_spec(LEAST, "spec.toml")
    assert spec.fringe.counts == (70, 64, 59)
    assert spec.camera.exposures == (1.0,)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LEAST + "[panel]\nwidht_mm = 3.0", "panel.widht_mm: found an unknown key"),
        (LEAST.replace('panel = "P"', ""), "scene.panel: found nothing, expected text"),
        (LEAST + "repeats = 'two'", "repeats"),
        (LEAST.replace("[scene]", "repeats = true\n[scene]"), "repeats: found True, expected a whole number"),
        (LEAST + "[panel.skin]\nradius_1_mm = 10.0", "panel.skin: radius_1_mm: found 10.0"),
        (LEAST + "[[panel.rivets]]\nid = 'R'\nx_mm = 1.0\ny_mm = 'b'\ndiameter_mm = 5", r"panel.rivets\[0\].y_mm"),
        (LEAST + "[[panel.rivets]]\nid = 'R'\nx_mm = 1000.0\ny_mm = 0\ndiameter_mm = 5", "position of R"),
        (LEAST.replace("08:00:00Z", "08:00:00"), "captured_at"),
        (LEAST.replace("simulation/1", "simulation/9"), "format: found 'flushline-simulation/9'"),
        (LEAST + "[fringe]\naxis = 'z'\nsteps = 4\ncounts = [5, 6]", "fringe.axis"),
        (LEAST + "[panel.surface]\npatches = [{shape = 'star', x_mm = 0, y_mm = 0, size_mm = [1, 1]}]", "shape"),
        (LEAST + "[camera]\nexposures = [0.0]", "camera: exposures"),
        ("[scene", "expected TOML"),
    ],
)
def test_mistakes_are_named(text, message):
    with pytest.raises(SpecError, match=message) as caught:
        parse_spec(text, "spec.toml")
    assert str(caught.value).startswith("spec.toml: ")
    assert "\n" not in str(caught.value)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(SpecError, match=r"none\.toml"):
        read_spec(tmp_path / "none.toml")
    with pytest.raises(SpecError, match="found 'nothing'"):
        shipped_spec("nothing")


def test_seams_must_make_sense():
    with pytest.raises(SpecError, match="advance"):
        Seam("J", ((0.0, 0.0), (10.0, 0.0), (5.0, 1.0), (12.0, 0.0)), (1.0,))
    with pytest.raises(SpecError, match="id of another seam"):
        Panel(seams=(Seam("J", ((0.0, 0.0), (10.0, 0.0)), (1.0,), ends_at="K"),))
    with pytest.raises(SpecError, match="corners"):
        pack(Panel(seams=(Seam("J", ((0.0, 0.0), (5.0, 1.0), (9.0, 0.0)), (1.0,), course="polyline"),)))


def test_random_panels_are_valid_and_keep_their_distances(rng):
    for _ in range(15):
        variety = Variety(holes=2, stickers=3, cables=1)
        panel = random_panel(rng, variety, (random_seam(rng),))
        pack(panel)
        places = np.array([[r.x_mm, r.y_mm, r.diameter_mm] for r in panel.rivets])
        for k, (x, y, d) in enumerate(places):
            others = np.delete(places, k, axis=0)
            gaps = np.hypot(others[:, 0] - x, others[:, 1] - y) / (0.5 * (others[:, 2] + d))
            assert gaps.size == 0 or gaps.min() > 1.5
    for joint in ("cross", "T"):
        pack(random_panel(rng, Variety(), crossing_seams(rng, joint, SeamVariety(width_mm=(0.5, 2.0)))))
    assert abs(random_placement(rng).rotation_deg[0]) <= 10


def test_rigs_are_built_alike_from_the_same_seed_and_converge(rng):
    a, b = (virtual_rig(np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(a.right.R, b.right.R)
    assert np.linalg.norm(a.right.centre) == pytest.approx(300, abs=15)
    angle = np.degrees(np.arccos(a.right.R[2] @ [0, 0, 1]))
    assert angle == pytest.approx(24, abs=2)
    _, aim = aim_frame(a)
    for device in (a.left, a.right, a.projector):
        middle = np.array([device.width / 2, device.height / 2])
        assert np.abs(device.project(aim) - middle).max() < 0.05 * device.width


def test_a_warmed_rig_grows(rng):
    rig = virtual_rig(rng)
    grown = np.linalg.norm(warmed(rig, 10.0).right.centre) / np.linalg.norm(rig.right.centre)
    assert grown == pytest.approx(1 + 230e-6)

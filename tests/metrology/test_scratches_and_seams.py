"""A shallow groove that begins and ends in the skin is a scratch; what parts two sheets is a seam."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from metrology.cloud import Reconstruction
from metrology.defects.measure import measure_defects
from metrology.results import SeamLine
from metrology.seams import detect_seams
from metrology.seams.finding.relief import Relief
from metrology.seams.finding.scratches import scratches_of
from metrology.sighted import Sighted
from tests.support.rivet_scan import Skin, scan

FLAT = Skin(sigma_z=0.012, correlated_px=0.8)


def grooved(
    cloud: Reconstruction, half_mm: float, width: float, depth: float, open_gap: bool = False
) -> Reconstruction:
    """With a dark groove along x, from −half to half; an open gap has hardly any points."""
    local = FLAT.frame.local(np.asarray(cloud.points, float))
    x, y = local[..., 0], local[..., 1] + 4.0
    off = np.hypot(np.maximum(np.abs(x) - half_mm, 0.0), y) / (0.5 * width)
    profile = np.cos(0.25 * np.pi * np.minimum(off, 2.0)) ** 2
    local[..., 2] -= depth * profile
    points = FLAT.frame.rig(local).astype(np.float32)
    dark = cv2.GaussianBlur((off < 1.0).astype(np.float32), (0, 0), 0.8)
    if open_gap:
        points[off < 1.2] = np.nan
    left = replace(
        cloud.left,
        texture=cloud.left.texture * (1 - (0.8 if open_gap else 0.3) * dark),
        modulation=cloud.left.modulation * (1 - (0.9 if open_gap else 0.3) * dark),
    )
    return replace(cloud, points=points, left=left)


@pytest.fixture
def bare(rng: np.random.Generator) -> Reconstruction:
    return scan(FLAT, (), rng)


def test_a_scratch_that_ends_in_the_skin_is_a_defect(bare: Reconstruction) -> None:
    cloud = grooved(bare, 40.0, 2.0, 0.2)
    assert [line for line in detect_seams(cloud, []) if line.relief] == []
    (found,) = measure_defects(Sighted(cloud, [], detect_seams(cloud, []), {}))
    assert found.kind == "scratch"
    assert found.depth_mm == pytest.approx(0.2, abs=0.02)
    assert found.length_mm == pytest.approx(80.0, rel=0.04)
    assert found.width_mm == pytest.approx(2.0, rel=0.25)


def test_the_same_groove_from_one_end_of_the_view_to_the_other_stays_a_seam(bare: Reconstruction) -> None:
    (line,) = detect_seams(grooved(bare, 100.0, 2.0, 0.2), [])
    assert line.relief


def test_an_open_gap_that_ends_in_the_skin_stays_a_seam(bare: Reconstruction) -> None:
    (line,) = detect_seams(grooved(bare, 40.0, 2.0, 1.0, open_gap=True), [])
    assert line.relief


def test_a_scratchs_edge_is_no_seam_and_a_groove_beside_it_is() -> None:
    def line(name: str, v: float, start: float = 150.0) -> SeamLine:
        u = np.arange(start, 501.0)
        return SeamLine(name, np.stack([u, np.full_like(u, v)], axis=1), np.full(len(u), 8.0), 1.0, True)

    skin, none = np.ones((480, 640), bool), np.zeros((480, 640), bool)
    cut = Relief(1.0, groove_share=1.0, shallow_share=1.0)
    scratch, edge = (line("scratch", 200.0), cut), (line("edge", 215.0), Relief(1.0, step_mm=0.2, step_share=1.0))
    gap, far = (line("gap", 215.0), Relief(1.0, groove_share=1.0)), (line("far", 280.0), edge[1])
    assert [found.seam_id for found in scratches_of([scratch, edge, far], skin, none)] == ["scratch", "edge"]
    assert [found.seam_id for found in scratches_of([scratch, gap], skin, none)] == ["scratch"]
    # What it runs on to makes it a seam: another line, the end of the skin, the picture's border.
    crossed = np.stack([np.full(300, 520.0), np.arange(100.0, 400.0)], axis=1)
    other = (SeamLine("other", crossed, np.full(300, 8.0), 1.0, True), Relief(1.0, groove_share=1.0))
    assert scratches_of([scratch, other], skin, none) == []
    # A head hides what comes next: beyond it a seam may go on.
    head = none.copy()
    head[170:230, 505:565] = True
    beyond = (line("beyond", 200.0, 350.0), Relief(1.0, groove_share=1.0))
    beyond[0].centre_px[:, 0] += 220.0
    assert scratches_of([scratch], skin, head) == [scratch[0]]
    assert scratches_of([scratch, beyond], skin, head) == []
    skin[:, 520:] = False
    assert scratches_of([scratch], skin, none) == []
    assert scratches_of([(line("to the border", 200.0, 20.0), cut)], np.ones((480, 640), bool), none) == []


def test_what_lies_far_behind_is_no_dent_of_its_width(bare: Reconstruction) -> None:
    """A few cells 39 mm behind the skin, round which there are no points."""
    points, flags = bare.points.copy(), bare.flags.copy()
    window = np.s_[200:252, 300:352]
    points[window] = np.nan
    points[216:236, 312:340] = bare.points[216:236, 312:340] * (1 + 39.0 / 700.0)
    assert measure_defects(Sighted(replace(bare, points=points, flags=flags), [], [], {})) == []

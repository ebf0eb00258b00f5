"""What is a fastener: paint and dents are none, and what is in doubt is neither enrolled nor judged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from metrology.cloud import Reconstruction
from metrology.kinds import RIVET
from metrology.limits import Limit, PanelSpec
from metrology.registration import enrol
from metrology.rivets import detect_rivets, measure_rivets
from metrology.rivets.confirm import _doubt, _nothing_inside, _Shown
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.relief import HeadRelief
from metrology.rivets.rim_light import GapLight
from metrology.rivets.rim_step import RimStep, rim_step
from metrology.tolerance import judge
from tests.support.reference_scans import reference_scan
from tests.support.rivet_scan import Head, Skin, scan

ROWS = (Head(-45, 20), Head(-15, 20), Head(15, 20), Head(45, 20), Head(-45, -20), Head(15, -20), Head(45, -20))


def painted(reconstruction: Reconstruction, ring: Head, skin: Skin, width_mm: float = 0.12) -> Reconstruction:
    """A dark circle painted on the skin, in both cameras' pictures."""
    views = []
    for view, camera in (
        (reconstruction.left, reconstruction.rig.left),
        (reconstruction.right, reconstruction.rig.right),
    ):
        v, u = np.mgrid[: camera.height, : camera.width].astype(float)
        rays = camera.rays(np.stack([u, v], axis=-1)) @ skin.frame.axes.T
        eye = skin.frame.local(camera.centre)
        reach = -eye[2] / rays[..., 2]
        away = np.hypot(eye[0] + reach * rays[..., 0] - ring.x, eye[1] + reach * rays[..., 1] - ring.y)
        dark = ring.contrast * np.exp(-0.5 * ((away - ring.diameter / 2) / (width_mm + 0.05)) ** 2)
        views.append(replace(view, texture=(view.texture - dark).astype(np.float32)))
    return replace(reconstruction, left=views[0], right=views[1])


def dented(
    reconstruction: Reconstruction, skin: Skin, x: float, y: float, depth: float, width: float
) -> Reconstruction:
    """A smooth dent, `width` across at half its depth."""
    local = skin.frame.local(reconstruction.points.astype(float))
    away = np.hypot(local[..., 0] - x, local[..., 1] - y)
    local[..., 2] -= depth * np.exp(-np.log(2) * (2 * away / width) ** 2)
    return replace(reconstruction, points=skin.frame.rig(local).astype(np.float32))


def test_a_painted_ring_of_another_size_between_the_rows_is_in_doubt(rng: np.random.Generator) -> None:
    skin = Skin()
    detections = detect_rivets(painted(scan(skin, ROWS, rng), Head(-32, 6, 11.0), skin))
    doubtful = [d for d in detections if d.doubt]
    assert len(detections) - len(doubtful) == len(ROWS)
    assert len(doubtful) == 1
    assert "without a step" in doubtful[0].doubt


def test_a_painted_ring_of_nearly_a_usual_size_between_the_rows_is_in_doubt(rng: np.random.Generator) -> None:
    """As thin as a gap, and as dark: its size is that of no other, as well as diameters are known."""
    skin = Skin()
    ring = replace(ROWS[0], x=-32.0, y=6.0, diameter=1.07 * ROWS[0].diameter)
    detections = detect_rivets(painted(scan(skin, ROWS, rng), ring, skin))
    assert len(detections) == len(ROWS) + 1
    (doubtful,) = (d for d in detections if d.doubt)
    assert "in no row of theirs" in doubtful.doubt


@pytest.mark.parametrize(("width_mm", "contrast"), [(0.24, 30.0), (0.12, 90.0), (0.12, 74.0), (0.12, -30.0)])
def test_a_painted_ring_of_the_usual_size_is_told_by_its_line(
    rng: np.random.Generator, width_mm: float, contrast: float
) -> None:
    """Wider, of far more contrast, or bright where gaps are dark."""
    ring = replace(ROWS[0], x=0.0, y=0.0, contrast=contrast)
    skin = Skin()
    detections = detect_rivets(painted(scan(skin, ROWS, rng), ring, skin, width_mm))
    doubtful = [d for d in detections if d.doubt]
    assert len(detections) - len(doubtful) == len(ROWS)
    assert len(doubtful) == 1


def test_a_step_that_paint_pretends_confirms_no_line_unlike_the_gaps(rng: np.random.Generator) -> None:
    skin = Skin()
    for contrast, sure in ((110.0, 0), (40.0, 1)):
        ring = replace(ROWS[0], x=0.0, y=0.0, height=0.016, contrast=contrast)
        detections = detect_rivets(scan(skin, (*ROWS, ring), rng))
        assert len(detections) == len(ROWS) + 1
        assert sum(d.doubt is None for d in detections) == len(ROWS) + sure


@pytest.mark.parametrize(("width_mm", "doubted"), [(0.3, 1), (0.1, 0)])
def test_where_few_fasteners_tell_what_gaps_are_a_broad_ring_without_a_step_is_in_doubt(
    rng: np.random.Generator, width_mm: float, doubted: int
) -> None:
    skin = Skin()
    letter = Head(0.0, 0.0, 6.0, contrast=80.0)
    detections = detect_rivets(painted(scan(skin, ROWS[:2], rng), letter, skin, width_mm))
    assert sum(d.doubt is not None for d in detections) == doubted
    assert len(detections) == 3


@pytest.mark.parametrize(
    ("step", "significance", "doubted"),
    [
        (None, 0.8, True),
        (None, 5.0, False),
        (RimStep(0.02, 0.01, 1.0, 1.0), 0.8, False),
        (RimStep(0.29, 0.07, 2.8, 4.8), 0.8, True),
    ],
)
def test_a_ring_too_small_to_tell_a_step_needs_others_like_it(
    step: RimStep | None, significance: float, doubted: bool
) -> None:
    """Strokes of a letter leave such a ring between them, ten pixels across: nothing is clear of it."""
    relief = SimpleNamespace(significance=significance)
    shown = SimpleNamespace(step=step, relief=relief, place=None, light=None)
    doubt = _doubt(shown, [], GapLight.of([]), SimpleNamespace(right=None))
    assert ("too few points" in (doubt or "")) == doubted


@pytest.mark.parametrize(("inside_mm", "doubted"), [(-0.13, False), (0.02, True), (-0.02, True)])
def test_a_broken_ring_that_steps_is_a_head_if_all_of_it_does(inside_mm: float, doubted: bool) -> None:
    step, relief = SimpleNamespace(mean_mm=-0.14), HeadRelief(inside_mm, 5.0, 1.0, 1.0)
    for clear in (False, True):
        shown = SimpleNamespace(clear=clear, stroke=False, step=step, relief=relief)
        assert (_nothing_inside(shown) is not None) == (doubted and not clear)


@pytest.mark.parametrize(("reach", "doubted"), [(0.55, 0), (0.0, 1)])
def test_a_flush_ring_with_a_recess_in_its_middle_is_a_head(
    rng: np.random.Generator, reach: float, doubted: int
) -> None:
    """Of another size than the others, and in no row of theirs: without a recess it is in doubt."""
    skin, ring = Skin(), Head(-32, 6, 11.0)
    reconstruction = painted(scan(skin, ROWS, rng), ring, skin)
    local = skin.frame.local(reconstruction.points.astype(float))
    away = np.hypot(local[..., 0] - ring.x, local[..., 1] - ring.y)
    local[..., 2] -= 0.5 * (away < reach * ring.diameter / 2)
    detections = detect_rivets(replace(reconstruction, points=skin.frame.rig(local).astype(np.float32)))
    assert sum(d.doubt is None for d in detections) == len(ROWS) + 1 - doubted


def test_of_a_countersink_all_is_deep() -> None:
    assert [HeadRelief(0.0, 0.0, 1.0, 1.0, share).recessed for share in (0.05, 0.4, 0.95)] == [False, True, False]


def test_a_recess_in_the_skin_s_stead_makes_no_letter_of_a_head() -> None:
    """The median of what the rim of a recessed head encloses lies anywhere."""
    for share, doubted in ((0.0, True), (0.35, False)):
        relief = HeadRelief(0.007, 0.9, 1.0, 1.0, share)
        shown = SimpleNamespace(clear=False, stroke=False, step=SimpleNamespace(mean_mm=0.093), relief=relief)
        assert (_nothing_inside(shown) is not None) == doubted


@pytest.mark.parametrize(("inside_mm", "inside", "doubted"), [(0.041, 5.7, True), (0.11, 15.0, False)])
def test_a_stroke_of_thick_paint_encloses_skin(inside_mm: float, inside: float, doubted: bool) -> None:
    """A bold D steps at its borders by 0.11 mm; blur raises what lies within."""
    step, relief = SimpleNamespace(mean_mm=0.114), HeadRelief(inside_mm, inside, 1.0, 1.0)
    shown = SimpleNamespace(clear=False, stroke=True, step=step, relief=relief)
    assert (_nothing_inside(shown) is not None) == doubted


@pytest.mark.parametrize(
    ("inside_mm", "inside", "significance", "stands"),
    [(0.087, 12.1, 4.4, True), (0.087, 12.1, 2.0, False), (0.02, 2.0, 4.4, False), (0.39, 48.8, 18.8, False)],
)
def test_of_a_rim_half_hidden_what_lies_inside_tells_that_it_steps(
    inside_mm: float, inside: float, significance: float, stands: bool
) -> None:
    """Letters across a head leave little beside its rim. Paint leaves the inside in the skin, a drop is far higher."""
    fit = SimpleNamespace(coverage=0.62, noise=1.8, amplitude=-17.7, sigma_px=0.8)
    step = RimStep(0.062, 0.021, significance, mean_significance=2.9)
    shown = _Shown(SimpleNamespace(fit=fit), step, HeadRelief(inside_mm, inside, 1.0, 1.0))
    assert not shown.clear
    assert shown.stands == stands


def test_a_chip_on_the_skin_is_in_doubt(rng: np.random.Generator) -> None:
    detections = detect_rivets(scan(Skin(), (*ROWS, Head(-32, 6, diameter=3.4, height=0.5)), rng))
    (doubtful,) = (d for d in detections if d.doubt)
    assert "chip" in doubtful.doubt
    assert len(detections) == len(ROWS) + 1


@pytest.mark.parametrize("width_mm", [0.5, 0.26])
def test_a_drop_in_a_row_is_in_doubt(rng: np.random.Generator, width_mm: float) -> None:
    """It is round and stands out of the skin, most in its middle, with a border that is blurred or wider than gaps."""
    skin, drop = Skin(), Head(-15, -20, diameter=4.8, contrast=30.0)
    reconstruction = painted(scan(skin, ROWS, rng), drop, skin, width_mm)
    local = skin.frame.local(reconstruction.points.astype(float))
    away = np.hypot(local[..., 0] - drop.x, local[..., 1] - drop.y)
    local[..., 2] += 0.4 * np.clip(1 - (away / 2.4) ** 3, 0, None)
    detections = detect_rivets(replace(reconstruction, points=skin.frame.rig(local).astype(np.float32)))
    (doubtful,) = (d for d in detections if d.doubt)
    assert "bulges" in doubtful.doubt
    assert len(detections) == len(ROWS) + 1


def test_a_flush_head_in_its_row_or_of_the_usual_size_is_not_in_doubt(rng: np.random.Generator) -> None:
    heads = (*ROWS, Head(-15, -20, diameter=5.0, height=0.0), Head(-2, 3, height=0.0))
    detections = detect_rivets(scan(Skin(), heads, rng))
    assert len(detections) == len(heads)
    assert not any(d.doubt for d in detections)


def test_a_ring_that_one_camera_alone_shows_is_in_doubt(rng: np.random.Generator) -> None:
    flush = scan(Skin(), (Head(0, 0, height=0.0),), rng)
    glint = replace(flush, right=replace(flush.right, texture=scan(Skin(), (), rng).right.texture))
    assert detect_rivets(flush)[0].doubt is None
    assert "other does not" in detect_rivets(glint)[0].doubt


def test_rings_of_a_scan_that_is_nearly_all_overexposed_are_in_doubt(rng: np.random.Generator) -> None:
    """Nothing tells how large they are, nor whether anything steps there: letters and stickers pass for heads."""
    seen = scan(Skin(), ROWS, rng)
    points = np.where(np.arange(seen.points.shape[1])[:, None] < 40, seen.points, np.float32(np.nan))
    found = detect_rivets(replace(seen, points=points))
    assert len(found) >= len(ROWS)
    assert all("too few points" in (d.doubt or "") for d in found)


def test_stencilled_letters_are_no_rivets(rng: np.random.Generator) -> None:
    reconstruction = scan(Skin(), ROWS, rng)
    views = []
    for view in (reconstruction.left, reconstruction.right):
        ink = np.zeros(view.texture.shape, np.uint8)
        for row, text in enumerate(("LIFT HERE 0O8QG", "RH-F1 STA 872 6")):
            cv2.putText(ink, text, (60, 225 + 50 * row), cv2.FONT_HERSHEY_SIMPLEX, 1.5, 255, 8, cv2.LINE_AA)
        views.append(replace(view, texture=view.texture * (1 - np.float32(0.003) * cv2.GaussianBlur(ink, (0, 0), 0.7))))
    found = detect_rivets(replace(reconstruction, left=views[0], right=views[1]))
    assert sum(d.doubt is None for d in found) == len(ROWS)


def test_a_dent_does_not_step_at_any_ring_and_a_head_does(rng: np.random.Generator) -> None:
    skin = Skin()
    dent = dented(scan(skin, (), rng), skin, 0.0, 0.0, 0.25, 18.0)
    u, v = dent.rig.left.project(skin.frame.rig([0.0, 0.0, 0.0]))
    for radius in (9.0, 15.0, 22.0, 29.0):
        step = rim_step(dent, Ellipse(u, v, radius, radius, 0.0))
        assert abs(step.mean_mm) < 0.015 * max(1, 15 / radius)
        assert step.significance < 3
    head = scan(skin, (Head(0, 0, height=-0.058),), rng)
    step = rim_step(head, Ellipse(u, v, 20.0, 19.7, 0.0))
    assert step.mean_mm == pytest.approx(-0.058, abs=0.008)
    assert step.significance > 5


def test_a_head_of_few_pixels_steps(rng: np.random.Generator) -> None:
    skin = Skin(sigma_z=0.03)
    u, v = (float(place) for place in scan(skin, (), rng).rig.left.project(skin.frame.rig([0.0, 0.0, 0.0])))
    for height in (0.1, -0.1):
        step = rim_step(scan(skin, (Head(0, 0, 3.2, height),), rng), Ellipse(u, v, 8.0, 7.9, 0.0))
        assert step.mean_mm == pytest.approx(height, abs=0.15)
        assert step.significance > 3
    flat = rim_step(scan(skin, (), rng), Ellipse(u, v, 8.0, 7.9, 0.0))
    assert flat.significance < 3


def test_a_recess_that_fills_most_of_a_head_does_not_turn_its_step(rng: np.random.Generator) -> None:
    skin = Skin()
    head = scan(skin, (Head(0, 0, 6.4, -0.08),), rng)
    u, v = head.rig.left.project(skin.frame.rig([0.0, 0.0, 0.0]))
    local = skin.frame.local(head.points.astype(float))
    local[..., 2] -= 0.4 * np.clip(1.7 - np.hypot(local[..., 0], local[..., 1]), 0, 1)
    step = rim_step(
        replace(head, points=skin.frame.rig(local).astype(np.float32)), Ellipse(float(u), float(v), 16.0, 15.7, 0.0)
    )
    assert step.mean_mm < -0.05


@pytest.mark.parametrize("depth", [0.25, -0.25, 0.6])
@pytest.mark.parametrize("width", [10.0, 14.0, 18.0])
def test_dents_and_bumps_are_no_rivets(rng: np.random.Generator, depth: float, width: float) -> None:
    skin = Skin()
    assert detect_rivets(dented(scan(skin, (), rng), skin, 0.0, 0.0, depth, width)) == []


def test_what_is_in_doubt_is_neither_enrolled_nor_judged(rng: np.random.Generator) -> None:
    skin = Skin()
    reconstruction = painted(scan(skin, ROWS, rng), Head(-32, 6, 11.0), skin)
    rivets = measure_rivets(detect_rivets(reconstruction), reconstruction)
    assert sorted(r.rivet_id for r in rivets) == [*(f"R{k:02d}" for k in range(1, 8)), "X01"]
    enrolled = enrol(rivets, [], reconstruction.points, "S1")
    assert [r.rivet_id for r in enrolled.enrolled.rivets] == [f"R{k:02d}" for k in range(1, 8)]
    limits = PanelSpec("P", "A", {"default": {"height_mm": Limit(lower=-1.0, upper=1.0)}})
    (doubtful,) = (r for r in judge(RIVET, enrolled.rivets, limits) if r.rivet_id == "X01")
    assert (doubtful.decision, doubtful.severity, doubtful.height_mean_mm) == ("unconfirmed", None, None)
    assert doubtful.diameter_mm == pytest.approx(11.0, abs=0.2)


def test_heads_of_a_lettered_skin_and_nothing_else(shared: Path) -> None:
    reconstruction, truth = reference_scan(shared / "scenes" / "hall", "rig-11.json")
    confirmed = [d for d in detect_rivets(reconstruction) if d.doubt is None]
    heads = [t["uv_px"] for t in truth["rivets"] if t["kind"] != "hole"]
    assert len(confirmed) == len(heads)
    assert all(min(np.hypot(d.u_px - u, d.v_px - v) for d in confirmed) < 1 for u, v in heads)

"""Light missing across a ring's line: a length that blur does not change, by which paint and gaps are told apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metrology.cloud import Reconstruction
from metrology.rivets import detect_rivets
from metrology.rivets.rim_light import GapLight, RimLight, rim_light
from metrology.surfaces import Frame
from tests.support.reference_scans import reference_scan
from tests.support.rivet_scan import Skin, scan


def painted_ring(
    scanned: Reconstruction, skin: Frame, x: float, y: float, diameter: float, width: float, sigma: float
) -> Reconstruction:
    """The scan with a black ring of a width (mm) on the skin, blurred by sigma (mm), in all pictures."""
    views = []
    for camera, view in scanned.cameras.values():
        middle = np.rint(camera.project(skin.rig(np.array([x, y, 0.0])))).astype(int)
        part = tuple(slice(max(at - 60, 0), at + 61) for at in middle[::-1])
        v, u = (at.astype(float) for at in np.mgrid[part])
        rays = camera.rays(np.stack([u, v], axis=-1)) @ skin.axes.T
        eye = skin.local(camera.centre)
        reach = -eye[2] / rays[..., 2]
        away = np.hypot(eye[0] + reach * rays[..., 0] - x, eye[1] + reach * rays[..., 1] - y) - diameter / 2
        texture = view.texture.copy()
        texture[part] *= 1 - width / (np.sqrt(2 * np.pi) * sigma) * np.exp(-0.5 * (away / sigma) ** 2)
        views.append(replace(view, texture=texture))
    return replace(scanned, left=views[0], right=views[1])


@pytest.mark.parametrize("blur_mm", [0.14, 0.2, 0.28])
def test_missing_light_is_the_width_of_a_black_line_whatever_the_blur(rng: np.random.Generator, blur_mm: float) -> None:
    skin = Skin()
    scanned = painted_ring(scan(skin, (), rng), skin.frame, 0.0, 0.0, 7.0, 0.12, blur_mm)
    u, v = scanned.rig.left.project(skin.frame.rig(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))).T
    light = rim_light(scanned, skin.frame, 3.5, 1 / float(np.hypot(*np.diff([u, v])[:, 0])))
    assert light.missing_mm == pytest.approx([0.12, 0.12], abs=0.012)
    assert abs(light.ratio) < 4 * light.ratio_sd + 0.02


def gap(oblique: float, slope: float = 3.5, size: float = 0.1, off: float = 0.0) -> RimLight:
    ratio = slope * oblique + off
    return RimLight(size * np.exp([0.5 * ratio, -0.5 * ratio]), ratio, 0.01, oblique)


OBLIQUE = (-0.1, -0.03, 0.03, 0.1, -0.1, 0.1)


def test_paint_looks_alike_from_both_cameras_and_gaps_do_not() -> None:
    gaps = GapLight.of([gap(x, off=off) for x, off in zip(OBLIQUE, (0.02, 0, -0.02, 0.03, -0.01, 0), strict=True)])
    assert gaps.slope == pytest.approx(3.5, abs=0.3)
    assert gaps.is_paint(gap(0.1, slope=0.0))
    assert not gaps.is_gap(gap(0.1, slope=0.0))
    assert gaps.is_gap(gap(-0.1))
    assert not gaps.is_paint(gap(-0.1))
    # In the middle between both cameras gaps look alike from both, too.
    assert gaps.side(gap(0.002, slope=0.0)) is None
    # Where gaps themselves do, nothing is told.
    alike = GapLight.of([gap(x, slope=0.0, off=0.02 * (-1) ** k) for k, x in enumerate(OBLIQUE)])
    assert not alike.is_paint(gap(0.1, slope=0.0))
    assert not alike.is_gap(gap(0.1, slope=0.0))


def test_a_line_that_takes_far_more_light_than_gaps_is_none() -> None:
    gaps = GapLight.of([gap(0.0, size=size) for size in (0.08, 0.09, 0.1, 0.1, 0.11, 0.12)])
    assert not gaps.takes_more(gap(0.0, size=0.14))
    assert gaps.takes_more(gap(0.0, size=0.25))
    few = GapLight.of([gap(0.1)] * 3)
    assert not few.takes_more(gap(0.0, size=5.0))
    assert few.side(gap(0.1)) is None


def test_a_painted_ring_as_dark_as_gaps_and_of_their_size_is_told_by_the_cameras(shared: Path) -> None:
    """Painted on an independently rendered scan, left of the middle, where its gaps look darker to one camera."""
    scanned, _ = reference_scan(shared / "scenes" / "hall", "rig-11.json")
    points = scanned.points[200:321:4, 121:242:4].reshape(-1, 3).astype(float)
    skin = Frame.on_plane(
        np.mean(points, axis=0), np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    )
    ray = scanned.rig.left.rays(np.array([[181.0, 260.0]]))[0] @ skin.axes.T
    eye = skin.local(scanned.rig.left.centre)
    x, y, _ = eye - eye[2] / ray[2] * ray
    found = detect_rivets(painted_ring(scanned, skin, x, y, 8.0, 0.1, 0.15))
    (ring,) = (d for d in found if np.hypot(d.u_px - 181, d.v_px - 260) < 5)
    assert "alike from both cameras" in (ring.doubt or "")
    assert sum(d.doubt is None for d in found) == 15

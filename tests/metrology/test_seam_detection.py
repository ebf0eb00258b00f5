"""Seam detection: centre lines and ends on painted textures; what the points confirm; the reference scans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import fsolve
from scipy.spatial import cKDTree

from metrology.cloud import PixelFlag
from metrology.errors import UsageError
from metrology.results import RivetDetection
from metrology.seams import ImageLine, LineSettings, SeamSettings, detect_lines, detect_seams
from metrology.seams.finding import segments
from metrology.seams.finding.relief import examine_relief
from metrology.seams.finding.segments import join_pieces, straight_pieces
from metrology.seams.finding.shade import projected_share
from metrology.seams.polyline import smoothest
from metrology.seams.skins.sections import usable_points
from tests.support.seam_scan import SHAPE, Relief, seam_scan
from tests.support.seam_textures import Band, paint

IMAGE = (620, 820)


def only_line(bands, rng, **extras) -> ImageLine:
    lines = detect_lines(paint(bands, IMAGE, rng, **extras))
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parametrize(
    ("angle", "width", "contrast", "bow"),
    [(0, 8, 40, 0), (90, 5, 40, 0), (25, 12, 30, 3), (62, 4, 50, 0), (117, 16, 25, 4), (158, 7, -40, 2)],
)
def test_centre_line(angle, width, contrast, bow, rng):
    # Unequal brightness on both sides pulls Steger's own points aside.
    band = Band((410, 310), angle, width, contrast, bow_px=bow, other_side=6.0)
    line = only_line([band], rng)
    offset = band.offsets(line.centre_px)
    assert np.sqrt(np.mean(offset**2)) < 0.04
    assert np.abs(offset).max() < 0.12
    assert np.median(line.width_px) == pytest.approx(width, abs=0.25)
    assert np.sign(line.contrast) == -np.sign(contrast)
    # Up to the image's borders.
    assert line.length_px > 0.97 * chord_length(band)


def chord_length(band: Band) -> float:
    """Length of the band's axis within the image."""
    angle = np.deg2rad(band.angle_deg)
    t = np.arange(-1200.0, 1200.0, 0.25)
    u, v = band.through[0] + t * np.cos(angle), band.through[1] + t * np.sin(angle)
    inside = (u >= 0) & (u <= IMAGE[1] - 1) & (v >= 0) & (v <= IMAGE[0] - 1)
    return 0.25 * float(inside.sum())


@pytest.mark.parametrize("angle", [3, 48, 95, 140])
def test_line_ends(angle, rng):
    band = Band((410, 310), angle, 8.0, 45.0, reach=(-170.3, 201.6), bow_px=2.0)
    ends = only_line([band], rng).centre_px[[0, -1]]
    for which in (0, 1):
        assert np.linalg.norm(ends - band.end(which), axis=1).min() < 0.15


@pytest.mark.parametrize(("angle", "width"), [(40, 6.0), (85, 12.0), (130, 9.0)])
def test_crossing(angle, width, rng):
    bands = [Band((400, 300), 4, 9.0, 35.0), Band((430, 320), angle, width, 45.0, bow_px=2.0)]
    lines = detect_lines(paint(bands, IMAGE, rng))
    assert len(lines) == 2
    true = fsolve(lambda p: [float(b.offsets(p[None])[0]) for b in bands], [410, 310])
    assert np.linalg.norm(intersection(lines[0].centre_px, lines[1].centre_px) - true) < 0.15


def intersection(a, b):
    """Where two polylines cross: straight pieces around the places nearest to each other."""
    distance, index = cKDTree(b).query(a)
    k = int(distance.argmin())
    p, q = a[k - 3 : k + 4], b[index[k] - 3 : index[k] + 4]
    along_a, along_b = p[-1] - p[0], q[-1] - q[0]
    s = np.linalg.solve(np.stack([along_a, -along_b], axis=1), q.mean(axis=0) - p.mean(axis=0))
    return p.mean(axis=0) + s[0] * along_a


@pytest.mark.parametrize("angle", [50, 90, 125])
def test_line_ends_at_the_border_of_the_one_it_runs_into(angle, rng):
    through = Band((400, 250), 5, 10.0, 40.0)
    ending = Band((400, 250), angle, 7.0, 40.0, reach=(0.0, 3000.0))
    lines = detect_lines(paint([through, ending], IMAGE, rng))
    assert len(lines) == 2
    line = min(lines, key=lambda found: np.abs(ending.offsets(found.centre_px)).mean())
    end = np.abs(through.offsets(line.centre_px[[0, -1]])).min()
    assert end == pytest.approx(0.5 * through.width_px, abs=0.15)


def test_heads_and_highlights_interrupt_no_seam(rng):
    band = Band((410, 310), 20, 8.0, 40.0, bow_px=3.0)
    along = np.array([np.cos(np.deg2rad(20)), np.sin(np.deg2rad(20))])
    centre = np.array(band.through)
    discs = [(*(centre - 200 * along), 32.0, 118.0)]
    glints = [(*(centre + 180 * along), 30.0, 300.0)]
    line = only_line([band], rng, discs=discs, glints=glints)
    offset = band.offsets(line.centre_px)
    assert line.length_px > 0.97 * chord_length(band)
    assert np.sqrt(np.mean(offset**2)) < 0.06
    assert line.support < 0.95


def test_smoothest_curve_follows_bends_and_nothing_else(rng):
    s = np.linspace(0, 1600, 134)
    noise = 0.1 * rng.normal(size=s.size)
    for bend, least_gain in ((0.0, 4.5), (3e-6, 4.5), (1e-8, 1.0)):
        # A straight line, a parabola, and waves of 5 px in 800 px.
        true = bend * s**2 if bend != 1e-8 else 5 * np.sin(2 * np.pi * s / 800)
        curve = smoothest(np.stack([s, true + noise], axis=1), np.ones(s.size))
        error = curve[:, 1] - true
        assert 0.1 / np.sqrt(np.mean(error**2)) > least_gain
        assert np.abs(error).max() < 0.1
        assert curve[:, 0] == pytest.approx(s, abs=1e-3)
    # What could not be measured does not count.
    true = 2 * np.sin(2 * np.pi * s / 1200)
    points = np.stack([s, true + noise], axis=1)
    points[60:66, 1] += 5.0
    weights = np.where((np.arange(s.size) >= 60) & (np.arange(s.size) < 66), 0.0, 1.0)
    assert np.abs(smoothest(points, weights)[:, 1] - true).max() < 0.1


def test_smoothest_curve_leaves_cubics_and_weighs_all_stiffnesses(rng):
    t = np.linspace(-1, 1, 90)
    cubic = np.stack([800 * t, 30 * t - 9 * t**2 + 4 * t**3], axis=1)
    weights = rng.uniform(0.3, 3, t.size)
    assert smoothest(cubic, weights) == pytest.approx(cubic, abs=1e-6)
    # Each stiffness' curve by its definition, and its likelihood with the free cubics and the noise's size integrated
    # out, by determinants.
    y = np.sin(3 * t) + rng.normal(0, 0.2, t.size) / np.sqrt(weights)
    bends = np.diff(np.eye(t.size), 4, axis=0)
    total, mean = 0.0, np.zeros(t.size)
    for stiffness in 4.0 ** np.arange(-3, 21):
        system = np.diag(weights) + stiffness * bends.T @ bends
        curve = np.linalg.solve(system, weights * y)
        cost = weights @ (y - curve) ** 2 + stiffness * np.sum((bends @ curve) ** 2)
        log_odds = 0.5 * ((t.size - 4) * np.log(stiffness / cost) - np.linalg.slogdet(system)[1])
        total, mean = total + np.exp(log_odds + 200), mean + np.exp(log_odds + 200) * curve
    found = smoothest(np.stack([1e4 * t, y], axis=1), weights)[:, 1]
    assert found == pytest.approx(mean / total, abs=1e-4)


@pytest.mark.parametrize("angle", [55, 130])
def test_a_faint_line_is_followed_across_another_one_and_round_a_bend(angle, rng):
    # On this side of the other line it is too faint to be looked for, 6–7 % darker, over two thirds of its length.
    other = Band((250, 300), angle, 16.0, 45.0, other_side=6.0)
    band = Band((410, 310), 10, 7.0, 8.0, bow_px=4.0, period_px=1000.0)
    lines = detect_lines(paint([band, other], IMAGE, rng))
    assert len(lines) == 2
    line = min(lines, key=lambda found: np.abs(band.offsets(found.centre_px)).mean())
    assert line.length_px > 0.97 * chord_length(band)
    # Three times what noise usually does at 8 levels.
    assert np.abs(band.offsets(line.centre_px)).max() < 0.3


def test_a_line_that_fades_is_one_line(rng):
    # Half of its length only is as dark as a line must be.
    band = Band((410, 310), 12, 6.0, 14.0)
    u = np.arange(IMAGE[1])
    fading = np.where(u < 380, 0.4, 1.0)
    image = paint([], IMAGE, rng)
    image += fading * (paint([band], IMAGE, np.random.default_rng(5)) - paint([], IMAGE, np.random.default_rng(5)))
    lines = detect_lines(image)
    assert len(lines) == 1
    assert lines[0].length_px > 0.8 * chord_length(band)


def test_no_line_in_noise_nor_of_short_scratches(rng):
    assert detect_lines(100 + rng.normal(0, 3, IMAGE)) == []
    scratches = [
        Band(tuple(rng.uniform((100, 100), (700, 500))), rng.uniform(0, 180), 1.5, 25.0, reach=(-50, 50))
        for _ in range(8)
    ]
    assert detect_lines(paint(scratches, IMAGE, rng)) == []


def test_border_of_a_patch_is_no_line(rng):
    u = np.arange(IMAGE[1])
    patch = 50 + 45 * np.clip(0.5 + (u - 400) / 3, 0, 1)
    assert detect_lines(patch + rng.normal(0, 2, IMAGE)) == []


def test_pieces_are_straight_and_joined_across_a_gap(rng):
    t = np.arange(0.0, 400.0)
    line = np.stack([t, 0.1 * t + rng.normal(0, 0.2, t.size), np.ones_like(t)], axis=-1)
    bent = np.concatenate([line, [[400 + k, 40 + 2 * k, 1] for k in range(100)]])
    pieces = straight_pieces(bent, 1.0, 40.0, rng)
    assert len(pieces) == 2
    assert max(len(p) for p in pieces) == pytest.approx(400, abs=5)
    halves = [line[:150], line[230:][::-1]]
    joined = join_pieces(halves, 100.0, 2.0, np.deg2rad(6))
    assert len(joined) == 1
    assert len(joined[0]) == 320
    aside = line[230:] + np.array([0, 12, 0])
    assert len(join_pieces([line[:150], aside], 100.0, 2.0, np.deg2rad(6))) == 2


def test_a_join_compares_the_ends_of_what_it_joined_alone(monkeypatch):
    """On relief there are a thousand pieces and hundreds of joins: each anew with all others took a minute."""
    along = np.arange(0.0, 20.0)
    pieces = [
        np.column_stack([along + 24.0 * k, np.full(20, 30.0 * row) + 1e-3 * (k * 7 % 5) * along])
        for row in range(5)
        for k in range(20)
    ]
    compared = []
    prices = segments._prices

    def counted(here, there, limits):
        compared.append(len(here) * len(there))
        return prices(here, there, limits)

    monkeypatch.setattr(segments, "_prices", counted)
    assert sorted(len(line) for line in join_pieces(pieces, 6.0, 2.0, np.deg2rad(6))) == [400] * 5
    assert sum(compared) < 200**2 + 95 * 4 * 200


SEAM = Band((450, 350), 70, 9.0, 70.0, bow_px=3.0)


@pytest.mark.parametrize(
    ("band", "relief"),
    [
        (SEAM, Relief(depth_mm=2.0)),
        (SEAM, Relief(depth_mm=2.0, step_mm=-0.6)),
        # Sealed: a step without a groove, a little sunk in, bright.
        (SEAM, Relief(step_mm=0.12)),
        (SEAM, Relief(depth_mm=0.05)),
        (Band((450, 350), 0, 12.0, -30.0), Relief(step_mm=0.3)),
        # 0.3 mm wide.
        (Band((450, 350), 120, 1.5, 100.0), Relief(depth_mm=2.0, step_mm=0.1)),
    ],
)
def test_groove_or_step_is_a_seam(band, relief, rng):
    found = detect_seams(seam_scan([band], [relief], rng), ())
    assert [line.relief for line in found] == [True]
    assert found[0].seam_id == "S01"
    assert found[0].confidence > 0.8
    assert np.abs(band.offsets(found[0].centre_px)).max() < 0.3


@pytest.mark.parametrize("depth", [0.0, -0.06, -1.2])
def test_paint_decals_and_cables_are_no_seams(depth, rng):
    found = detect_seams(seam_scan([SEAM], [Relief(depth_mm=depth)], rng), ())
    assert [line.relief for line in found] == [False]
    assert found[0].confidence <= 0.2


def test_border_of_the_lit_field_is_no_line(rng):
    lit = np.broadcast_to(np.arange(SHAPE[1]) > 300, SHAPE)
    assert detect_seams(seam_scan([], [], rng, lit=lit), ()) == []


def test_seam_ends_with_the_lit_field(rng):
    lit = np.broadcast_to(np.arange(SHAPE[0])[:, None] < 500, SHAPE)
    band = Band((450, 350), 88, 9.0, 70.0)
    found = detect_seams(seam_scan([band], [Relief(depth_mm=2.0)], rng, lit=lit), ())
    assert len(found) == 1
    assert found[0].centre_px[:, 1].max() == pytest.approx(499.5, abs=0.3)


def test_highlight_denies_no_seam(rng):
    # Over more than half of its length there are no points beside it.
    v, u = np.indices(SHAPE)
    saturated = (v < 420) & (np.abs(u - 450) > 6) & (np.abs(u - 450) < 200)
    band = Band((450, 350), 90, 9.0, 70.0)
    found = detect_seams(seam_scan([band], [Relief(depth_mm=2.0)], rng, saturated=saturated), ())
    assert [line.relief for line in found] == [True]
    assert np.ptp(found[0].centre_px[:, 1]) > 0.95 * SHAPE[0]


def test_seam_runs_on_under_rivets(rng):
    band = Band((450, 350), 90, 9.0, 70.0)
    places = [(450.0, 200.0), (450.0, 480.0)]
    heads = [RivetDetection(u, v, 70.0, 70.0, 0.0, 1.0) for u, v in places]
    scan = seam_scan([band], [Relief(depth_mm=2.0)], rng, discs=[(u, v, 35.0, 112.0) for u, v in places])
    found = detect_seams(scan, heads)
    assert [line.relief for line in found] == [True]
    assert np.ptp(found[0].centre_px[:, 1]) > 0.97 * SHAPE[0]


def test_fringes_are_fainter_in_a_gap_than_on_paint(rng):
    black, band = 3.0, np.arange(40) < 8
    reflectance = np.where(band, 0.4, 1.0) * rng.uniform(0.98, 1.02, (5, 40))
    # Projected light of 90 grey levels, and light from all around of 10; a gap's floor sees little of the former.
    projected = np.where(band & (np.arange(5)[:, None] > 2), 60.0, 90.0)
    texture, modulation = black + reflectance * (projected + 10), reflectance * projected
    skin = np.broadcast_to(~band, (5, 40))
    share = projected_share(texture, modulation, band, skin, black)
    assert share[:3] == pytest.approx(1, abs=0.005)
    assert share[3:] == pytest.approx(60 / 70 * 100 / 90, abs=0.01)
    # Too large a black level makes no gap of paint.
    assert np.all(projected_share(texture, modulation, band, skin, 20.0)[:3] > 1)
    # Nor of paint that is brighter than the skin.
    white = np.where(band, 1.8 / 0.4, 1.0)
    share = projected_share(black + (texture - black) * white, modulation * white, band, skin, 20.0)
    assert np.all(share[:3] > 0.99)


def test_a_saturated_bright_line_is_no_gap(rng):
    """Its fringes are cut off, and are fainter than its light."""
    band = Band((450, 350), 90, 4.0, -60.0)
    scan = seam_scan([band], [Relief(0.0, 0.0)], rng)
    bright = np.abs(np.arange(SHAPE[1]) - 450) < 3
    left = replace(
        scan.left,
        modulation=np.where(bright, 0.8 * scan.left.modulation, scan.left.modulation).astype(np.float32),
        flags=scan.left.flags | np.where(bright, np.uint16(PixelFlag.SATURATED_SAMPLES), np.uint16(0)),
    )
    assert not any(line.relief for line in detect_seams(replace(scan, left=left), ()))


def test_thick_letters_beside_a_line_are_no_step(rng):
    """On one side of it for some millimetres; a step between sheets goes on."""
    band = Band((450, 350), 90, 12.0, 60.0)
    for thick, seams in ((np.s_[:, 450:482], 0), (np.s_[:, 450:], 1)):
        scan = seam_scan([band], [Relief(0.0, 0.0)], rng)
        points = scan.points.copy()
        points[thick] *= 1 - 0.06 / 700.0
        assert sum(line.relief for line in detect_seams(replace(scan, points=points), ())) == seams


def test_seams_are_numbered_from_left_to_right(rng):
    bands = [Band((700, 350), 90, 8.0, 70.0), Band((200, 350), 90, 8.0, 70.0), Band((450, 350), 90, 8.0, 70.0)]
    reliefs = [Relief(depth_mm=2.0), Relief(step_mm=0.3), Relief()]
    found = detect_seams(seam_scan(bands, reliefs, rng), ())
    assert [line.seam_id for line in found] == ["S01", "S02", "S03"]
    assert [line.relief for line in found] == [True, True, False]
    assert [round(float(line.centre_px[:, 0].mean()), -2) for line in found] == [200, 700, 400]


def test_settings_out_of_range():
    with pytest.raises(UsageError, match="min_contrast"):
        LineSettings(min_contrast=2)
    with pytest.raises(UsageError, match="coarsest_level"):
        LineSettings(coarsest_level=0)


@pytest.mark.parametrize(("name", "seams"), [("skin", 1), ("skin-shiny", 1), ("skin-worn", 0), ("standard-part", 0)])
def test_reference_scans(shared, name, seams):
    from metrology.rivets import detect_rivets
    from tests.support.reference_scans import reference_scan

    cloud, truth = reference_scan(shared / "scenes" / name)
    found = [line for line in detect_seams(cloud, detect_rivets(cloud)) if line.relief]
    assert len(found) == seams
    for line, true in zip(found, truth.get("seams", []), strict=True):
        visible = np.array(true["uv_px"])[np.array(true["visible"])]
        distance, _ = cKDTree(line.centre_px).query(visible)
        # The image's dark band and the ideal edges have different middles.
        assert np.quantile(distance, 0.98) < 0.5 * np.median(line.width_px)


@pytest.mark.parametrize("angle", [0.8, 1.5, 3.0, 90.8])
def test_paint_on_a_tilted_skin_has_no_step(angle, rng):
    # Places beside the line all round to their pixels alike, and half a pixel is 0.03 mm of depth.
    band = Band((450, 350), angle, 8.0, 40.0)
    scan = seam_scan([band], [Relief()], rng, sigma_z=0.01, radius_mm=4000.0, tilt=0.3)
    line = np.array([band.through]) + np.linspace(-330, 330, 661)[:, None] * [
        np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    ]  # fmt: skip
    relief = examine_relief(line, band.width_px, scan, usable_points(scan), SeamSettings())
    assert relief.skin_share == 1.0
    assert abs(relief.step_mm) < 0.004
    assert relief.step_share < 0.1
    assert relief.groove_share < 0.1


def test_highlight_in_the_other_camera_is_no_evidence(rng):
    band = Band((450, 350), 80, 8.0, 45.0)
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    # Two thirds of the length have points on one side only.
    unmatched = (band.local(u, v)[1] > 0) & (v > 240)
    (seam,) = detect_seams(seam_scan([band], [Relief(1.5, 0.2)], rng, unmatched=unmatched), [])
    assert seam.relief
    assert np.abs(band.offsets(seam.centre_px)).max() < 0.15
    assert len(seam.centre_px) > 0.9 * SHAPE[0]

"""The stitched picture of a panel and the map of its deviations: everything in its place, whichever scan saw it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.assembly.assemble import Assembly, assembled
from metrology.assembly.picture import FINER, Stitched, stitched
from metrology.assembly.scan import PanelScan, Skin
from metrology.assembly.smooth_skin import SmoothSkin
from storage.panel_picture import encoded, stored_pictures
from tests.support.panel_scans import SIZE, SimulatedPanel, facing

DENT_MM, DENT_RADIUS_MM = 0.2, 15.0


def texture(scan: PanelScan) -> NDArray[np.uint8]:
    """Grey skin with a dark disc for each head."""
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    picture = np.full(v.shape, 140, np.uint8)
    for head in scan.heads:
        picture[(u - head.u_px) ** 2 + (v - head.v_px) ** 2 < (head.major_px / 2) ** 2] = 30
    return picture


def dented(scan: PanelScan, at: Array) -> PanelScan:
    """A scan with a flat dent around a place of its rig frame."""
    points = scan.skin.points.copy()
    within = np.linalg.norm(points - at, axis=2) < DENT_RADIUS_MM
    points[within] *= 1 + DENT_MM / points[within][:, 2:]
    return replace(scan, skin=Skin(points, scan.skin.sigma))


@pytest.fixture(scope="module")
def made() -> tuple[Assembly, Array, Stitched]:
    """A panel of three stations with a dent that the middle one saw: where it lies, and the picture."""
    rng = np.random.default_rng(3)
    panel = SimulatedPanel.made(rng, 15, (-62.0, 74.0))
    scans = [panel.seen(facing(x, 0.0, rng, turn=10)[0], f"S{k}", rng) for k, x in enumerate((-220, 0, 220), 1)]
    at = scans[1].skin.middle
    scans[1] = dented(scans[1], at)
    assembly = assembled(scans)
    [placement] = [p for _, number, p in assembly.placed() if number == 1]
    [picture] = stitched(assembly, {k: texture(scan) for k, scan in enumerate(assembly.scans)})
    return assembly, placement.to_panel(at), picture


def test_heads_are_where_the_panel_has_them(made: tuple[Assembly, Array, Stitched]) -> None:
    assembly, _, picture = made
    assert picture.size_mm[0] > 650
    assert 0.8 < picture.seen.mean() <= 1
    step, reach = picture.mm_per_px, 8.0
    found = 0
    for _, number, placement in assembly.placed():
        for x, y, _ in placement.to_panel(assembly.scans[number].pattern.positions):
            column, row = (x - picture.left_mm) / step, (picture.top_mm - y) / step
            around = round(reach / step)
            window = picture.grey[round(row) - around : round(row) + around, round(column) - around :][:, : 2 * around]
            dark_rows, dark_columns = np.nonzero(window < 70)
            corner = np.array([round(column), round(row)]) - around
            middle = corner + np.array([dark_columns.mean(), dark_rows.mean()]) + 0.5
            assert np.hypot(*(middle - [column, row])) * step < 0.3
            found += 1
    assert found > 30


def test_the_map_shows_a_dent_and_is_flat_elsewhere(made: tuple[Assembly, Array, Stitched]) -> None:
    _, (x, y, _), picture = made
    step = picture.mm_per_px * FINER
    rows, columns = np.mgrid[: picture.deviation.shape[0], : picture.deviation.shape[1]]
    away = np.hypot(picture.left_mm + (columns + 0.5) * step - x, picture.top_mm - (rows + 0.5) * step - y)
    assert np.nanmedian(picture.deviation[away < 10]) == pytest.approx(-DENT_MM, abs=0.03)
    elsewhere = picture.deviation[away > 20]
    assert abs(np.nanmedian(elsewhere)) < 0.005
    assert np.nanpercentile(np.abs(elsewhere), 95) < 0.03


def test_what_was_not_seen_is_empty(made: tuple[Assembly, Array, Stitched]) -> None:
    _, _, picture = made
    small = picture.seen[::FINER, ::FINER]
    assert np.isnan(picture.deviation[~small]).mean() > 0.95


def test_pictures_come_back_as_they_were_stored(made: tuple[Assembly, Array, Stitched], tmp_path: Path) -> None:
    _, _, picture = made
    files, listed = encoded([picture])
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "manifest.json").write_text(json.dumps({"pictures": listed}))
    [back] = stored_pictures(tmp_path.parent.joinpath, f"{tmp_path.name}/manifest.json").values()
    assert (back.seen == picture.seen).mean() > 0.999
    shown = back.seen & picture.seen
    assert np.abs(back.grey[shown].astype(int) - picture.grey[shown]).mean() < 2
    assert np.array_equal(np.isnan(back.deviation), np.isnan(picture.deviation))
    assert np.nanmax(np.abs(back.deviation - picture.deviation)) <= 0.0011
    assert (back.left_mm, back.top_mm, back.mm_per_px) == (picture.left_mm, picture.top_mm, picture.mm_per_px)


def test_few_points_make_a_surface_through_them() -> None:
    skin = SmoothSkin.fitted(np.array([[0.0, 0, 1], [10, 0, 1], [0, 10, 1]]))
    assert skin.on_grid(np.array([0.0, 10]), np.array([0.0, 10]))[:, 0] == pytest.approx(1, abs=0.02)


def test_a_smooth_skin_follows_a_cylinder_and_no_bump() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform([-400, -100], [400, 100], (8000, 2))
    bump = np.hypot(xy[:, 0] - 50, xy[:, 1]) < 20
    z = -0.5 * xy[:, 1] ** 2 / 600 + rng.normal(0, 0.005, len(xy)) - 0.3 * bump
    skin = SmoothSkin.fitted(np.column_stack([xy, z]))
    x, y = np.linspace(-380, 380, 40), np.linspace(-90, 90, 10)
    assert np.abs(skin.on_grid(x, y) + 0.5 * y[:, None] ** 2 / 600).max() < 0.01

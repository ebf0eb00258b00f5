"""A close-up from a run's own fits gives the table's numbers whatever the settings; one of a run without says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

from dashboard.closeup import NOT_KEPT, rivet_close_up, seam_section
from metrology.cloud import Reconstruction
from metrology.results import Rivet, SeamLine, SeamStation
from metrology.rivets import RivetSettings, measure_rivets
from metrology.seams import SeamSettings, measure_seams
from storage.archive import Store
from storage.archive.bundle import FITS
from storage.cloud import StoredCloud, read_cloud
from storage.fits import StoredFits, read_fits
from tests.support.results import small_key, small_result
from tests.support.rivet_scan import Head, Skin, truth_detection
from tests.support.rivet_scan import scan as rivet_scan
from tests.support.seam_scan import Relief, seam_scan
from tests.support.seam_textures import Band

HEADS = (Head(-30, 15, 8.0, 0.12, 0.4, 30), Head(5, 15, 6.0, -0.08, 0.3, 200), Head(32, -15, 10.0, 0.05, 0.2, 90, 0.08))
BAND = Band((450.0, 350.0), 47.0, 8.0, 40.0, (-420.0, 420.0), 60.0, 900.0)


def stored(
    folder: Path, scan: Reconstruction, rivets: Sequence[Rivet] = (), stations: Sequence[SeamStation] = ()
) -> tuple[StoredCloud, StoredFits, list[SimpleNamespace]]:
    """A result as it comes back from a store: cloud, fits and rows."""
    store = Store(folder)
    preview = np.clip(scan.left.texture, 0, 255).astype(np.uint8)
    features = {"rivet": tuple(rivets), "seam station": tuple(stations)}
    result = replace(small_result(), reconstruction=scan, features=features, preview=preview)
    store.publish(result)
    bundle = store.paths(small_key().scene_id).bundle
    table = pq.read_table(bundle / ("rivets.parquet" if rivets else "seam_stations.parquet"))
    rows = [SimpleNamespace(**row) for row in table.to_pylist()]
    return read_cloud(bundle / "cloud.parquet"), read_fits(bundle / FITS), rows


@pytest.mark.parametrize(
    "settings",
    [
        RivetSettings(),
        RivetSettings(reference="plane", inner_radius=0.6, outer_radii=(1.3, 2.2), guard_px=2.0),
        RivetSettings(outer_radii=(1.05, 3.6), min_crown_mm=1.0),
    ],
)
def test_a_rivet_s_close_up_has_the_table_s_height(settings: RivetSettings, tmp_path: Path) -> None:
    skin = Skin(radius_x=1500.0, radius_y=900.0)
    scan = rivet_scan(skin, HEADS, np.random.default_rng(2))
    detections = [truth_detection(scan, skin, head) for head in HEADS]
    cloud, fits, rows = stored(tmp_path / "s", scan, measure_rivets(detections, scan, (), settings))
    assert len(rows) == len(HEADS)
    for row, head in zip(rows, HEADS, strict=True):
        found = rivet_close_up(cloud, row, fits.head(row.rivet_id))
        assert not isinstance(found, str), found
        assert found.height == pytest.approx(row.height_mean_mm, abs=1e-5)
        radius = found.fit.radius
        assert 2 * radius == pytest.approx(row.diameter_mm, abs=1e-5)
        assert found.fit.inner_mm <= 1.005 * settings.inner_radius * radius
        assert found.fit.outer_mm[1] == pytest.approx(max(settings.outer_radii[1] * radius, radius + 4), rel=0.02)
        # The stored points lie on the drawn surfaces.
        assert abs(np.median(found.deviation[found.outer])) < 0.005
        on_head = found.inner & (np.hypot(found.x, found.y) < 0.3 * radius)
        assert head.crown or abs(np.median(found.deviation[on_head]) - found.head(np.zeros(1))[0]) < 0.01


@pytest.mark.parametrize(
    "settings",
    [SeamSettings(station_step_mm=8.0), SeamSettings(station_step_mm=9.0, half_length_mm=1.0, skin_extent_mm=8.0,
                                                     guard_px=6.0, chamfer_deg=30.0)],
)  # fmt: skip
def test_a_section_across_a_bent_seam_has_the_table_s_step(settings: SeamSettings, tmp_path: Path) -> None:
    scan = seam_scan([BAND], [Relief(2.0, 0.2)], np.random.default_rng(1))
    x = np.arange(-400.0, 400.0)
    angle, y = np.radians(BAND.angle_deg), BAND.bow_px * np.sin(2 * np.pi * x / BAND.period_px)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    line = SeamLine("S01", np.column_stack([x, y]) @ turn.T + BAND.through, np.full(len(x), BAND.width_px), 1.0, True)
    cloud, fits, rows = stored(tmp_path / "s", scan, stations=measure_seams([line], scan, [], settings))
    measured = [row for row in rows if row.step_mm is not None]
    assert len(measured) > 10
    for row in measured:
        found = seam_section(cloud, row, fits.section(row.seam_id, row.s_mm))
        assert not isinstance(found, str), found
        assert found.step == pytest.approx(row.step_mm, abs=1e-5)
        assert (found.width is None) == (row.width_mm is None)
        if found.width is not None:
            assert found.width == pytest.approx(row.width_mm, abs=1e-5)
        # Side B is the same all along: the points there stand lower, as the table says.
        side_b, side_a = (np.median(found.h[found.used & (s * found.x > 0)]) for s in (1, -1))
        assert np.sign(side_b - side_a) == np.sign(row.step_mm)


def test_a_run_that_kept_no_fits_says_so(tmp_path: Path) -> None:
    cloud, fits, rows = stored(tmp_path / "s", small_result().reconstruction, small_result().features["rivet"])
    assert rivet_close_up(cloud, rows[0], fits.head(rows[0].rivet_id)) == NOT_KEPT

"""Waviness: a wave of known height under a straight-edge, along and across, on flat and curved skins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrology.defects.measure import measure_defects
from metrology.kinds import WAVINESS
from metrology.limits import Limit, PanelSpec
from metrology.waviness.measure import measure_waviness
from metrology.waviness.row import WavinessSettings
from metrology.waviness.sliding import sliding_gap
from tests.metrology.test_defects import CURVED, FLAT, bent, bowl, sighted
from tests.support.rivet_scan import Skin, scan

EDGE = WavinessSettings(straight_edge_mm=60.0)


def gap_of(line: np.ndarray, window: int) -> float:
    """The plain way: every pair of points that an edge may rest on, at every place."""
    best = 0.0
    for start in range(len(line) - window + 1):
        part = line[start : start + window]
        for a in range(window):
            for b in range(a + 1, window):
                edge = part[a] + (part[b] - part[a]) * np.arange(b - a + 1) / (b - a)
                whole = part[a] + (part[b] - part[a]) * (np.arange(window) - a) / (b - a)
                if (whole >= part - 1e-12).all():
                    best = max(best, float((edge - part[a : b + 1]).max()))
    return best


def test_the_kernel_slides_a_straight_edge(rng: np.random.Generator) -> None:
    lines = rng.normal(size=(3, 20)).cumsum(axis=1)
    expected = [gap_of(line, 12) for line in lines]
    gap, row, _ = sliding_gap(lines, 12, 0.4)
    assert gap == pytest.approx(max(expected))
    assert row == int(np.argmax(expected))
    assert np.isnan(sliding_gap(lines, 21, 0.4)[0])
    lines[:, 3::4] = np.nan
    assert sliding_gap(lines, 12, 0.4)[0] > 0
    assert np.isnan(sliding_gap(lines, 12, 0.1)[0])


@pytest.mark.parametrize("skin", [FLAT, replace(CURVED, radius_x=np.inf)], ids=["flat", "cylinder"])
def test_a_wave_is_as_high_as_it_is(rng: np.random.Generator, skin: Skin) -> None:
    """Of ± 0.04 mm every 40 mm along x: an edge of 60 mm spans two crests."""

    def wave(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.asarray(0.04 * np.cos(2 * np.pi * x / 40.0) + 0 * y)

    along, across = measure_waviness(sighted(bent(scan(skin, (), rng), skin, wave), skin), EDGE)
    assert (along.direction, across.direction) == ("along", "across")
    assert along.waviness_u95_mm is not None
    assert abs((along.waviness_mm or 0.0) - 0.08) < along.waviness_u95_mm < 0.012
    assert (across.waviness_mm or 0.0) < 1.5 * along.waviness_u95_mm


def test_a_smooth_skin_has_hardly_any_and_a_dent_is_none(rng: np.random.Generator) -> None:
    scanned = sighted(bent(scan(CURVED, (), rng), CURVED, bowl(5.0, -4.0, 0.3, 14.0, 12.0)), CURVED)
    scanned = replace(scanned, features={**scanned.features, "defect": measure_defects(scanned)})
    for row in measure_waviness(scanned, EDGE):
        assert row.waviness_mm is not None
        assert row.waviness_mm < 1.5 * (row.waviness_u95_mm or 0.0) < 0.02


def test_a_view_that_is_too_short_says_so(rng: np.random.Generator) -> None:
    for row in measure_waviness(sighted(scan(FLAT, (), rng), FLAT), WavinessSettings(straight_edge_mm=900.0)):
        assert row.decision == "not measured"
        assert "long enough for a straight-edge of 900 mm" in (row.reason or "")


def test_it_is_asked_for_by_a_limit() -> None:
    limit = Limit(upper=0.2)
    assert WAVINESS.on_request
    assert PanelSpec("P", "A", {"nose": {"waviness_mm": limit}}).limits_any(WAVINESS)
    assert not PanelSpec("P", "A", {"nose": {"height_mm": limit}}).limits_any(WAVINESS)

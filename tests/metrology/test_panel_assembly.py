"""Scans of one panel in one frame: every feature once, and nothing joined that does not belong together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrology.arrays import Array
from metrology.assembly.assemble import Assembly, assembled
from metrology.assembly.coverage import coverage
from metrology.assembly.panel import PanelFeatures, panel_features
from metrology.assembly.scan import PanelScan
from metrology.kinds import RIVET, SEAM_STATION
from metrology.limits import PanelSpec
from metrology.panel import Placement
from tests.support.panel_scans import SimulatedPanel, facing, rigid_rms

SPEC = PanelSpec("P", "1")
ROWS = (-62.0, 74.0)
STATIONS = (-220.0, 0.0, 220.0)


def long_panel(seed: int = 0) -> tuple[SimulatedPanel, list[PanelScan], list[Placement]]:
    """Three stations in a row, about 70 mm of overlap, the rig turned by up to 20°."""
    rng = np.random.default_rng(seed)
    panel = SimulatedPanel.made(rng, 15, ROWS)
    placements = [facing(x, 0.0, rng, turn=20)[0] for x in STATIONS]
    return panel, [panel.seen(p, f"S{k}", rng) for k, p in enumerate(placements, 1)], placements


@pytest.fixture(scope="module")
def joined() -> tuple[SimulatedPanel, Assembly, PanelFeatures]:
    panel, scans, _ = long_panel()
    assembly = assembled(scans)
    return panel, assembly, panel_features(assembly, SPEC)


def places(features: PanelFeatures, kind: str) -> Array:
    rows = [feature.row for feature in features[kind]]
    return np.array([(row.x_panel_mm, row.y_panel_mm, row.z_panel_mm) for row in rows], float)


def test_every_head_is_there_once_and_in_its_place(joined: tuple[SimulatedPanel, Assembly, PanelFeatures]) -> None:
    panel, assembly, features = joined
    assert len(assembly.parts) == 1
    assert len(features[RIVET.name]) == len(panel.heads) == 30
    found, true = places(features, RIVET.name), panel.lift(panel.heads)
    for turn in (np.eye(3), np.diag([-1.0, -1.0, 1.0])):  # the panel's own frame has either end to the right
        nearest = np.linalg.norm((found @ turn)[:, None] - true, axis=2).argmin(1)
        if len(set(nearest)) == 30:
            rms, worst = rigid_rms(found, true[nearest])
            assert rms < 0.03
            assert worst < 0.08
            return
    pytest.fail("found heads in other places than the panel has them")


def test_values_of_several_scans_are_combined(joined: tuple[SimulatedPanel, Assembly, PanelFeatures]) -> None:
    panel, _, features = joined
    twice = [feature for feature in features[RIVET.name] if len(feature.measured_by) == 2]
    assert len(twice) >= 4
    assert all(any(d.quantity.name == "height" for d in feature.differences) for feature in twice)
    heights = sorted(feature.row.height_mean_mm for feature in features[RIVET.name])  # type: ignore[attr-defined]
    assert np.abs(np.array(heights) - np.sort(panel.heights)).max() < 0.008


def test_a_seam_is_one_course_from_one_end(joined: tuple[SimulatedPanel, Assembly, PanelFeatures]) -> None:
    panel, _, features = joined
    rows = [feature.row for feature in features[SEAM_STATION.name]]
    assert len({row.seam_id for row in rows}) == 1  # type: ignore[attr-defined]
    s = np.array([row.s_mm for row in rows])  # type: ignore[attr-defined]
    assert s[0] == 0.0
    assert np.abs(np.diff(s) - 2.0).max() <= 1.0  # where one scan goes on with another one's positions
    assert s[-1] > 650
    steps = np.array([row.step_mm for row in rows])  # type: ignore[attr-defined]
    x = places(features, SEAM_STATION.name)[:, 0]
    # The same sides all along, whichever they are; the frame's middle is not the panel's.
    shifts = np.arange(-60.0, 60.0, 0.25)
    worst = [
        min(np.abs(steps - sign * panel.step(way * x + shift)).max() for sign in (1, -1) for way in (1, -1))
        for shift in shifts
    ]
    assert min(worst) < 0.02


def test_the_middle_station_missing_leaves_two_parts_and_says_so() -> None:
    _, scans, _ = long_panel()
    assembly = assembled([scans[0], scans[2]])
    assert [part.numbers for part in assembly.parts] == [(0,), (1,)]
    assert "found 2 parts that nothing joins (S1, S3)" in assembly.warnings[0]
    features = panel_features(assembly, SPEC)
    assert {feature.part for feature in features[RIVET.name]} == {1, 2}
    names = [feature.name for feature in features[RIVET.name]]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("seed", range(3))
def test_a_scan_of_another_aircraft_is_not_joined(seed: int) -> None:
    _, scans, placements = long_panel(seed)
    rng = np.random.default_rng(100 + seed)
    other = SimulatedPanel.made(rng, 15, ROWS)
    mixed = [scans[0], other.seen(placements[1], "S2", rng), scans[2]]
    assembly = assembled(mixed)
    assert len(assembly.parts) == 3
    assert "is each scan of this panel?" in assembly.warnings[0]


def test_a_scan_of_another_aircraft_is_left_out_where_the_pattern_fits_all() -> None:
    rng = np.random.default_rng(7)
    panel, other = SimulatedPanel.made(rng, 15, ROWS), SimulatedPanel.made(rng, 15, ROWS)
    true = [facing(x, 0.0, rng)[0] for x in STATIONS]
    scans = [(other if k == 2 else panel).seen(p, f"S{k}", rng, nominal=p, listed=True) for k, p in enumerate(true, 1)]
    assembly = assembled(scans, panel.layout)
    assert list(assembly.left_out) == [1]
    assert "is it of another aircraft" in assembly.warnings[-1]


def test_a_regular_pattern_of_equal_heads_is_not_joined_by_guessing() -> None:
    rng = np.random.default_rng(3)
    panel = SimulatedPanel.made(rng, 15, ROWS)
    panel = replace(
        panel, heads=np.round(panel.heads), diameters=np.full(30, 6.4), heights=np.zeros(30), profile=np.zeros((3, 1))
    )
    scans = [panel.seen(facing(x, 0.0, rng)[0], f"S{k}", rng) for k, x in enumerate(STATIONS, 1)]
    assembly = assembled(scans)
    offsets = []
    for part in assembly.parts:
        x = [part.fit.placements[k].to_panel(scans[n].skin.middle)[0] for k, n in enumerate(part.numbers)]
        offsets += np.abs(np.diff(x)).tolist()
    assert all(abs(offset - 220.0) < 20.0 for offset in offsets)  # joined rightly, or not at all
    assert len(assembly.parts) == 1 or "nothing joins" in assembly.warnings[0]


def test_names_and_places_are_the_specifications_where_it_has_a_pattern() -> None:
    rng = np.random.default_rng(5)
    panel = SimulatedPanel.made(rng, 15, ROWS)
    true = [facing(x, 0.0, rng)[0] for x in STATIONS]
    scans = [panel.seen(p, f"S{k}", rng, nominal=p, listed=True) for k, p in enumerate(true, 1)]
    layout = panel.layout
    assembly = assembled([scans[0], scans[2]], layout)  # no overlap: the pattern alone puts them into one frame
    assert len(assembly.parts) == 1
    features = panel_features(assembly, SPEC, layout)
    by_name = {feature.name: feature.row for feature in features[RIVET.name]}
    for rivet in layout.rivets:
        if row := by_name.get(rivet.rivet_id):
            assert np.hypot(row.x_panel_mm - rivet.position[0], row.y_panel_mm - rivet.position[1]) < 4.0
    covered = coverage(assembly, features, layout)
    unseen = {row.feature_id for row in covered.rows if row.state == "not seen" and row.feature_kind == RIVET.name}
    inside = {r.rivet_id for r in layout.rivets if abs(r.position[0]) < 80}
    assert unseen
    assert unseen <= inside
    assert any(row.from_mm is not None and row.state == "not seen" for row in covered.rows)
    assert "moved by" in (covered.next_station or "")


def test_twelve_stations_do_not_drift() -> None:
    rng = np.random.default_rng(1)
    panel = SimulatedPanel.made(rng, 17, (-210.0, -160.0, -110.0, -60.0, 60.0, 110.0, 160.0, 210.0))
    stands = [facing(x, y, rng) for y in (-150.0, 0.0, 150.0) for x in (-300.0, -100.0, 100.0, 300.0)]
    scans = [panel.seen(true, f"S{k}", rng, expected=near) for k, (true, near) in enumerate(stands, 1)]
    assembly = assembled(scans)
    assert len(assembly.parts) == 1
    found, true = [], []
    for _, number, placement in assembly.placed():
        points = scans[number].skin.points[::20, ::20].reshape(-1, 3)
        points = points[np.isfinite(points[:, 2])]
        found.append(placement.to_panel(points))
        true.append(stands[number][0].to_panel(points))
    rms, worst = rigid_rms(np.concatenate(found), np.concatenate(true))
    assert worst < 0.1
    assert rms < 0.03

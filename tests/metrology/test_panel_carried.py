"""From one assembly to the next: the frame and the names stay, or nothing is claimed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from metrology.arrays import Array
from metrology.assembly.assemble import Assembly, assembled
from metrology.assembly.carried import Former, Known, places_of, remembered, with_frames
from metrology.assembly.panel import PanelFeatures, panel_features
from metrology.assembly.scan import PanelScan
from metrology.kinds import KINDS, RIVET, SEAM_STATION
from metrology.limits import PanelSpec
from metrology.panel import PanelLayout, Placement
from tests.support.panel_scans import SimulatedPanel, facing

STATIONS = (-220.0, 0.0, 220.0)
NOTHING = PanelLayout()


def night(
    panel: SimulatedPanel, seed: int, stations: Sequence[int] = (1, 2, 3), upside_down: bool = False
) -> list[PanelScan]:
    """Scans of stations, the rig wherever it came to stand."""
    rng = np.random.default_rng(seed)
    turn = np.diag([-1.0, -1.0, 1.0]) if upside_down else np.eye(3)
    stands = [facing(x, 0.0, rng)[0] for x in STATIONS]
    scans = [panel.seen(Placement(p.R @ turn, p.t), f"S{k}", rng) for k, p in enumerate(stands, 1)]
    dated = [replace(scan, key=replace(scan.key, captured_at=scan.key.captured_at.replace(day=seed))) for scan in scans]
    return [dated[k - 1] for k in stations]


def put_together(scans: list[PanelScan], former: Former | None = None) -> tuple[Assembly, PanelFeatures, Former]:
    """The assembly, its features, and what the next one needs of it."""
    assembly = with_frames(assembled(scans), NOTHING, former)
    features = panel_features(assembly, PanelSpec("P", "1"), NOTHING, former)
    names = remembered(assembly, features, former)
    for kind in KINDS:
        for part in {feature.part for feature in features[kind.name]}:
            rows = [feature.row for feature in features[kind.name] if feature.part == part]
            sides = {feature.name: feature.side for feature in features[kind.name]}
            found = {name: Known(part, places, sides[name]) for name, places in places_of(kind, rows).items()}
            names[kind.name] = {**names.get(kind.name, {}), **found}
    placed = {scans[k].key.scene_id: (scans[k].key.station, part, place) for part, k, place in assembly.placed()}
    frames = {number: part.frame_id for number, part in enumerate(assembly.parts, 1)}
    loaded = {scan.key.scene_id: scan for scan in scans}
    return assembly, features, Former(placed, frames, names, loaded.get)


def places(features: PanelFeatures) -> dict[str, Array]:
    return {f.name: np.array([f.row.x_panel_mm, f.row.y_panel_mm, f.row.z_panel_mm]) for f in features[RIVET.name]}


@pytest.fixture(scope="module")
def panel() -> SimulatedPanel:
    return SimulatedPanel.made(np.random.default_rng(0), 15, (-62.0, 74.0))


@pytest.fixture(scope="module")
def first(panel: SimulatedPanel) -> tuple[Assembly, PanelFeatures, Former]:
    return put_together(night(panel, 1))


def same_places(now: PanelFeatures, then: PanelFeatures) -> float:
    """The greatest distance between what has the same name."""
    one, two = places(now), places(then)
    return max(float(np.linalg.norm(one[name] - two[name])) for name in one.keys() & two.keys())


def test_names_frame_and_positions_stay_when_all_is_scanned_again(
    panel: SimulatedPanel, first: tuple[Assembly, PanelFeatures, Former]
) -> None:
    assembly, features, _ = put_together(night(panel, 2), first[2])
    assert [part.frame_id for part in assembly.parts] == [part.frame_id for part in first[0].parts]
    assert places(features).keys() == places(first[1]).keys()
    assert same_places(features, first[1]) < 0.5
    one, two = (
        {round(f.row.s_mm): f.row.x_panel_mm for f in found[SEAM_STATION.name]}  # type: ignore[attr-defined]
        for found in (features, first[1])
    )
    shared = one.keys() & two.keys()
    assert len(shared) > 100
    assert max(abs(one[s] - two[s]) for s in shared) < 1.5  # positions are rounded to a millimetre


def test_a_step_keeps_its_sign_when_the_rig_stood_upside_down(
    panel: SimulatedPanel, first: tuple[Assembly, PanelFeatures, Former]
) -> None:
    scans = night(panel, 2, upside_down=True)
    _, features, _ = put_together(scans, first[2])
    one, two = (
        {round(f.row.s_mm / 2): f.row.step_mm for f in found[SEAM_STATION.name]}  # type: ignore[attr-defined]
        for found in (features, first[1])
    )
    shared = sorted(one.keys() & two.keys())
    assert len(shared) > 100
    steps = np.array([(one[s], two[s]) for s in shared])
    assert np.corrcoef(steps.T)[0, 1] > 0.95


def test_a_station_that_was_left_out_one_night_gets_its_names_back(
    panel: SimulatedPanel, first: tuple[Assembly, PanelFeatures, Former]
) -> None:
    _, fewer, second = put_together(night(panel, 2, (1, 2)), first[2])
    assert places(fewer).keys() < places(first[1]).keys()
    _, features, _ = put_together(night(panel, 3), second)
    assert places(features).keys() == places(first[1]).keys()
    assert same_places(features, first[1]) < 1.0


def test_parts_that_nothing_joins_any_more_keep_names_and_frame(
    panel: SimulatedPanel, first: tuple[Assembly, PanelFeatures, Former]
) -> None:
    assembly, features, _ = put_together(night(panel, 2, (1, 3)), first[2])
    assert len(assembly.parts) == 2
    assert {part.frame_id for part in assembly.parts} == {first[0].parts[0].frame_id}
    assert same_places(features, first[1]) < 0.5


def test_another_panel_is_numbered_for_itself(first: tuple[Assembly, PanelFeatures, Former]) -> None:
    other = SimulatedPanel.made(np.random.default_rng(9), 15, (-62.0, 74.0))
    assembly, _, _ = put_together(night(other, 2), first[2])
    assert not {part.frame_id for part in assembly.parts} & {part.frame_id for part in first[0].parts}
    assert all(part.former is None for part in assembly.parts)
    assert assembly.warnings[-1].startswith("names and places of S1+S2+S3 are not those of the assembly before")


def test_the_same_scans_lie_where_they_lay(
    panel: SimulatedPanel, first: tuple[Assembly, PanelFeatures, Former]
) -> None:
    _, features, _ = put_together(night(panel, 1), first[2])
    assert places(features).keys() == places(first[1]).keys()
    assert same_places(features, first[1]) < 1e-6

"""What changed on a station since the scan before, and what drifts from aircraft to aircraft."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from metrology.results import SceneKey
from storage.archive.changes import changes_sql, drift_sql
from storage.archive.store import Store
from tests.support.synthetic_scene import Recipe, synthetic_result

FIRST = datetime(2026, 11, 14, 21, 0, tzinfo=UTC)
SOUND = (0.02, -0.03, 0.01, 0.0, 0.04, -0.02, 0.0, 0.01, 0.03, 0.03, -0.01, 0.02)


def scan(night: int, heights: dict[int, float], step: float = 0.08, aircraft: str = "MSN-1") -> Recipe:
    key = SceneKey(aircraft, "LH-F12", "S1", FIRST + timedelta(days=night))
    return Recipe(key, tuple(heights.get(k, height) for k, height in enumerate(SOUND)), step_mm=step)


@pytest.fixture(scope="module")
def nights(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """R03 is cured, R07 gets worse, R09 is new, R05 stays; the seam's step is beyond its limit on both nights."""
    store = Store(tmp_path_factory.mktemp("changes") / "store")
    store.publish(synthetic_result(scan(0, {2: 0.2, 4: 0.15, 6: 0.13}, step=0.15)))
    store.publish(synthetic_result(scan(1, {4: 0.15, 6: 0.19, 8: 0.16}, step=0.15)))
    return store


def asked(store: Store, sql: str) -> list[dict[str, Any]]:
    with contextlib.closing(store.connect()) as connection:
        rows: list[dict[str, Any]] = connection.sql(sql).to_arrow_table().to_pylist()
    return rows


def test_each_finding_is_compared_with_the_scan_before(nights: Store) -> None:
    found = {row["feature_id"]: row for row in asked(nights, changes_sql("true"))}
    rivets = {name: row["change"] for name, row in found.items() if row["feature_kind"] == "rivet"}
    assert rivets == {"R03": "cured", "R05": "unchanged", "R07": "worse", "R09": "new"}
    assert (found["R07"]["value_mm"], found["R07"]["before_mm"]) == pytest.approx((0.19, 0.13), abs=0.005)
    assert (found["R03"]["value_mm"], found["R03"]["before_mm"]) == pytest.approx((0.01, 0.2), abs=0.005)
    assert found["R09"]["before_mm"] is None or abs(found["R09"]["before_mm"]) < 0.1


def test_a_stretch_of_a_seam_is_one_finding(nights: Store) -> None:
    found = [row for row in asked(nights, changes_sql("true")) if row["feature_kind"] == "seam station"]
    assert [row["change"] for row in found] == ["unchanged"] * len(found)
    stretch, *_ = found  # what lies within U95 of the limit, beside it, makes findings of its own
    assert stretch["positions"] > 10
    assert stretch["to_mm"] - stretch["from_mm"] == pytest.approx(4.0 * (stretch["positions"] - 1))
    assert stretch["feature_id"].startswith("M1@")


def gap_changes(root: Path, widths: tuple[float, float], revision: str | None = None) -> set[str]:
    """What becomes of a seam whose gap is another on the second night, judged by another revision if one is given."""
    store = Store(root)
    for night, width in enumerate(widths):
        result = synthetic_result(replace(scan(night, {}), width_mm=width))
        other = {**result.panel_spec, "revision": revision} if revision and night else result.panel_spec
        store.publish(replace(result, panel_spec=other))
    return {row["change"] for row in asked(store, changes_sql("true")) if row["feature_kind"] == "seam station"}


def test_a_gap_that_opens_further_beyond_its_limit_is_worse(tmp_path: Path) -> None:
    assert gap_changes(tmp_path / "opens", (3.9, 4.4)) == {"worse"}
    assert gap_changes(tmp_path / "stays", (3.9, 3.9)) == {"unchanged"}
    assert gap_changes(tmp_path / "other limits", (3.9, 4.4), revision="2") == {"unchanged"}


def test_only_the_scans_that_are_asked_for(nights: Store) -> None:
    assert asked(nights, changes_sql("captured_at > TIMESTAMPTZ '2026-11-16 00:00:00+00'")) == []


def test_names_of_a_scan_that_was_not_recognised_are_compared_with_nothing(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    for night in (0, 1):
        result = synthetic_result(scan(night, {2: 0.2}))
        lost = {"status": "not recognised", "matched": [], "rms_mm": None}
        store.publish(replace(result, registration=lost))
    [rivet] = [row for row in asked(store, changes_sql("true")) if row["feature_kind"] == "rivet"]
    assert (rivet["change"], rivet["before_mm"]) == ("new", None)


def test_what_moves_from_aircraft_to_aircraft_has_a_slope(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    for night in range(4):
        store.publish(synthetic_result(scan(night, {8: 0.02 * night}, aircraft=f"MSN-{night}")))
    moves = {row["name"]: row for row in asked(store, drift_sql("true"))}
    assert moves["R09"]["slope"] == pytest.approx(0.02, abs=0.002)
    assert moves["R09"]["r"] > 0.99
    assert (moves["R09"]["n"], moves["R09"]["scene_id"]) == (4, "MSN-3~LH-F12~S1~20261117T210000Z")
    assert abs(moves["R01"]["slope"]) < 0.003

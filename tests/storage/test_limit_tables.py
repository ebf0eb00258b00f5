"""The limits that scans were judged by, as a table."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import duckdb
import pytest

from flows.cli import main
from metrology.inspection import InspectionResult
from storage.archive import Store
from storage.archive.limit_tables import limits
from tests.support.results import small_key, small_result

ORIGIN = {"source": "drawing 7", "revision": "C"}
SPECIFICATION: dict[str, Any] = {
    "format": "flushline-panel/1", "panel": "LH-F12", "revision": "B",
    "zones": {
        "default": {
            "height_mm": {"lower": -0.1, "upper": 0.2, **ORIGIN},
            "step_into_wind_mm": {"upper": 0.3, "serious_upper": 0.5, **ORIGIN},
            "defect_depth_by_width_mm": {"steps": [[10.0, 0.1], [30.0, 0.4]], **ORIGIN},
        },
        "nose": {"height_mm": {"upper": 0.05, **ORIGIN}},
    },
    "rivets": [{"id": "R1", "position_mm": [0.0, 0.0, 0.0], "zone": "nose"}],
    "seams": [{
        "id": "M1", "course_mm": [[0.0, 0.0, 0.0], [90.0, 0.0, 0.0]],
        "stretches": [{"from_mm": 20.0, "to_mm": 50.0, "zone": "nose"}],
    }],
}  # fmt: skip


def judged(station: str, config: str, **changed: Any) -> InspectionResult:
    return replace(small_result(small_key(station)), config_hash=config, panel_spec={**SPECIFICATION, **changed})


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Two settings under one revision, a later revision, and a specification that cannot be read."""
    made = Store(tmp_path / "store")
    for station, config in (("S1", "one"), ("S2", "two"), ("S3", "two")):
        made.publish(judged(station, config))
    made.publish(judged("S4", "three", revision="C", zones={"default": {}, "nose": {}}))
    made.publish(judged("S5", "four", zones={"default": {"height": 0.1}}))
    return made


def limit(store: Store, zone: str, quantity: str, more: str = "true") -> dict[str, Any]:
    sql = f"FROM limits WHERE zone = '{zone}' AND quantity = '{quantity}' AND {more}"
    (row,) = store.query(sql).to_pylist()
    return dict(row)


def test_each_zone_says_what_holds_in_it(store: Store) -> None:
    row = limit(store, "default", "height")
    assert (row["lower"], row["upper"], row["unit"], row["inherited"]) == (-0.1, 0.2, "mm", False)
    assert (row["panel"], row["revision"], row["kind"], row["source"]) == ("LH-F12", "B", "rivet", "drawing 7")
    assert (row["config_hashes"], row["n_scenes"]) == (["one", "two"], 3)
    row = limit(store, "nose", "height")
    assert (row["lower"], row["upper"], row["holds_for"], row["inherited"]) == (None, 0.05, "R1", False)
    row = limit(store, "nose", "step")
    assert (row["depends_on"], row["upper"], row["serious_upper"]) == ("into the wind", 0.3, 0.5)
    assert (row["inherited"], row["holds_for"]) == (True, "M1 20–50 mm")
    assert limit(store, "default", "step")["holds_for"] == "M1 but 20–50 mm"
    row = limit(store, "default", "depth")
    assert (row["depends_on"], row["upper"], row["steps"]) == ("width", 0.4, "0.1 at 10, 0.4 at 30")


def test_what_cannot_be_read_says_why(store: Store) -> None:
    (row,) = store.query("FROM limits WHERE problem IS NOT NULL").to_pylist()
    assert (row["panel"], row["config_hashes"], row["kind"], row["upper"]) == ("LH-F12", ["four"], None, None)
    assert "height" in row["problem"]
    store.query("SELECT * FROM scenes").to_pylist()
    for manifest in store.layout.bundles.rglob("manifest.json"):
        manifest.chmod(0o600)
        manifest.write_text("{")
    assert store.query("FROM limits WHERE problem IS NULL").num_rows == 0
    assert store.query("FROM limits").num_rows == 4  # one for each of the settings


def test_the_command_line_has_it(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    sql = "SELECT zone, upper FROM limits WHERE quantity = 'height' ORDER BY upper"
    assert main(["query", sql, "--store", str(store.root), "--format", "csv"]) == 0
    assert capsys.readouterr().out.split() == ["zone,upper", "nose,0.05", "default,0.2"]


def test_panels_judged_by_a_specification_that_changed_under_its_name_are_told_apart(tmp_path: Path) -> None:
    """Of 40 assemblies, the last 15 were judged by another limit that has the same panel and revision."""
    for k in range(40):
        zones = {"default": {"height_mm": {"upper": 0.2 if k < 25 else 0.1, **ORIGIN}}}
        (tmp_path / f"b{k}").mkdir()
        spec = {**SPECIFICATION, "zones": zones, "rivets": [], "seams": []}
        (tmp_path / f"b{k}" / "manifest.json").write_text(json.dumps({"panel_spec": spec}))
    with duckdb.connect() as connection:
        connection.execute("SET TimeZone = 'UTC'")
        connection.execute(
            "CREATE TABLE panels AS SELECT 'P' AS panel, 'P B' AS panel_spec, 'b' || k AS bundle_path, "
            "TIMESTAMPTZ '2026-11-01 00:00Z' + to_days(k::INT) AS captured_at, captured_at AS processed_at "
            "FROM range(40) t(k)"
        )
        connection.execute("CREATE TABLE scenes AS SELECT *, 'c' AS config_hash FROM panels LIMIT 0")
        rows = limits(connection, tmp_path).to_pylist()
    times = ("first_captured_at", "last_captured_at")
    found = [(row["upper"], *(f"{row[name]:%m-%d}" for name in times)) for row in rows]
    assert found == [(0.2, "11-01", "11-25"), (0.1, "11-26", "12-10")]

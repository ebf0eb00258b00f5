"""Defects that were accepted on an earlier scan are known on the next, with what has changed since."""

from __future__ import annotations

import json

import duckdb

from storage.archive.known_defects import accepted_before
from storage.review_entries import Disposition, Entry, Review

SCANS = {"first": "2026-11-01", "second": "2026-11-02", "third": "2026-11-03"}


def index(depths: dict[str, float | None]) -> duckdb.DuckDBPyConnection:
    """D01 of three scans of a station, with a depth of each."""
    connection = duckdb.connect()
    connection.execute(
        "CREATE TABLE defects (aircraft_serial TEXT, panel TEXT, station TEXT, captured_at TIMESTAMP, scene_id TEXT, "
        "defect_id TEXT, depth_mm DOUBLE, depth_u95_mm DOUBLE, x_panel_mm DOUBLE)"
    )
    for scene, depth in depths.items():
        row = ["A", "P", "S", SCANS[scene], scene, "D01", depth, None if depth is None else 0.003, 1.0]
        connection.execute("INSERT INTO defects VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", row)
    return connection


def decided(number: int, scene: str, disposition: Disposition | None) -> Entry:
    said = {
        "format": "flushline-review/1", "number": number, "at": f"2026-11-0{number}T10:00:00Z", "who": "Ada",
        "action": "disposition", "scene_id": scene, "run_id": "r", "feature_kind": "defect", "feature_id": "D01",
        "disposition": disposition, "comment": "", "shown": {}, "previous": "0",
    }  # fmt: skip
    if disposition is None:
        said |= {"format": "flushline-review/4", "action": "undo"}
    return Entry.of_document(json.dumps(said))


def test_an_accepted_defect_is_known_with_its_change() -> None:
    connection = index({"first": 0.200, "second": 0.201, "third": 0.250})
    review = Review((decided(1, "first", "use as is"),))
    second, third = (accepted_before(connection, review, scene)["D01"] for scene in ("second", "third"))
    assert str(second).startswith("known: accepted as it is on 2026-11-01 by Ada; ")
    assert str(second).endswith("depth since then +0.001 ± 0.004 mm, no more than its uncertainty")
    assert "+0.050 ± 0.004 mm, more than its uncertainty" in str(third)
    assert accepted_before(connection, review, "first") == {}


def test_what_was_decided_otherwise_since_is_not_accepted() -> None:
    connection = index({"first": 0.2, "second": 0.2, "third": 0.2})
    review = Review((decided(1, "first", "use as is"), decided(2, "second", "repair")))
    assert accepted_before(connection, review, "third") == {}
    assert "D01" in accepted_before(connection, review, "second")


def test_what_was_undone_is_as_it_was_before() -> None:
    connection = index({"first": 0.2, "second": 0.2, "third": 0.2})
    entries = [decided(1, "first", "use as is"), decided(2, "first", "repair"), decided(3, "first", None)]
    assert "D01" in accepted_before(connection, Review(tuple(entries)), "third")
    entries.append(decided(4, "first", None))
    assert accepted_before(connection, Review(tuple(entries)), "third") == {}


def test_without_a_depth_the_change_is_not_known_and_an_index_without_defects_has_none() -> None:
    review = Review((decided(1, "first", "use as is"),))
    found = accepted_before(index({"first": 0.2, "second": None}), review, "second")["D01"]
    assert str(found).endswith("its depth was not measured both times")
    assert accepted_before(duckdb.connect(), review, "second") == {}

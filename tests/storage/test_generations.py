"""The next generation is made from an old one that nobody reads; whoever still reads one keeps it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from storage.archive import Store, generations, maintenance
from tests.support.results import small_key, small_result

ROWS = "SELECT scene_id, run_id FROM scenes ORDER BY ALL"


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Store:
    """A store whose index counts as large, with as many generations as are kept."""
    monkeypatch.setattr(generations, "WORTHWHILE_BYTES", 0)
    store = Store(tmp_path / "store")
    for number in range(3):
        publish(store, number)
    return store


def publish(store: Store, number: int) -> None:
    store.publish(small_result(small_key(f"S{number % 4}"), height_mm=number / 1000, rivets=number % 5 + 1))


def inodes(store: Store) -> set[int]:
    return {path.stat().st_ino for path in store.layout.generations.glob("*.duckdb")}


def test_files_go_round_and_every_generation_is_whole(store: Store) -> None:
    before = inodes(store)
    for number in range(3, 12):
        publish(store, number)
        newest = [(scene.name, max(scene.iterdir()).name) for scene in sorted(store.layout.bundles.glob("*/*/*"))]
        with store.connect() as connection:
            assert connection.execute(ROWS).fetchall() == newest
    assert inodes(store) == before
    assert maintenance.check(store.layout) == maintenance.Check(12, ())
    assert len(list(store.layout.generations.glob("*.duckdb"))) == 2


def test_what_somebody_reads_is_not_touched(store: Store) -> None:
    oldest = min(store.layout.generations.glob("*.duckdb"))
    content = oldest.read_bytes()
    with oldest.open("rb") as reader:
        for number in range(3, 8):
            publish(store, number)
        assert reader.read() == content
    assert maintenance.check(store.layout).problems == ()


def test_a_generation_without_its_list_is_copied(store: Store, tmp_path: Path) -> None:
    for path in store.layout.generations.glob("*.duckdb"):
        (tmp_path / path.name).hardlink_to(path)  # so that no other file gets its number
    for note in store.layout.generations.glob("*.json"):
        note.write_text("[")
    before = inodes(store)
    publish(store, 3)
    assert inodes(store) != before
    assert maintenance.check(store.layout).problems == ()


def test_what_turns_out_otherwise_is_copied(store: Store) -> None:
    # A run in the list that is not there any more: the old generation cannot be brought up to date.
    newest = max(store.layout.generations.glob("*.json"))
    newest.write_text(json.dumps(json.loads(newest.read_text()) | {"runs": ["bundles/MSN-1/LH-F12/gone/run"]}))
    publish(store, 3)
    publish(store, 4)
    assert maintenance.check(store.layout).problems == ()


def test_what_a_killed_writer_left_is_no_harm(store: Store) -> None:
    (store.layout.generations / ".spare.duckdb").write_bytes(b"half")
    (store.layout.generations / ".spare.duckdb.wal").write_bytes(b"half")
    publish(store, 3)
    assert not list(store.layout.generations.glob(".spare*"))
    assert maintenance.check(store.layout).problems == ()

"""Keeping an archive in order: damage is named, the index comes back, copies are complete."""

from __future__ import annotations

import json
import shutil
from datetime import timedelta
from pathlib import Path

import duckdb
import pytest

from flows.cli import main
from metrology.errors import StoreError
from storage.archive import Store, maintenance
from storage.archive.compaction import compact
from storage.archive.schema import TABLES
from tests.support.damage import forge, spoil
from tests.support.results import copied, small_key, small_result


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Three scenes of two aircraft, one of them inspected twice; do not write to it."""
    store = Store(tmp_path_factory.mktemp("published") / "store")
    for aircraft, station in (("MSN-1", "S1"), ("MSN-1", "S2"), ("MSN-2", "S1")):
        store.publish(small_result(small_key(station, aircraft)))
    store.publish(small_result(small_key("S1"), height_mm=0.2, rivets=2))
    return store


@pytest.fixture
def store(published: Store, tmp_path: Path) -> Store:
    """A copy of it to write to."""
    return copied(published, tmp_path)


def newest_run(store: Store) -> Path:
    return max(store.layout.scene(small_key("S1")).iterdir())


def test_a_sound_archive_has_no_problems(store: Store) -> None:
    assert maintenance.check(store.layout) == maintenance.Check(4, ())


@pytest.mark.parametrize("name", ["cloud.parquet", "overlay.png", "rivets.parquet", "rig.json"])
def test_a_damaged_file_is_named(store: Store, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = newest_run(store) / name
    spoil(path)
    assert main(["archive", "check", "--store", str(store.root)]) == 1
    said = capsys.readouterr()
    assert f"error: {path}: found checksum" in said.err
    assert "4 runs checked" in said.out
    path.unlink()
    assert any(f"{path}: found no such file" in problem for problem in maintenance.check(store.layout).problems)


def test_an_index_that_says_something_else_is_named(store: Store) -> None:
    forge(store, "DELETE FROM rivets WHERE aircraft_serial = 'MSN-2'; DELETE FROM scenes WHERE station = 'S2'")
    problems = maintenance.check(store.layout).problems
    assert "found run None of MSN-1~LH-F12~S2" in problems[0]
    assert "found other rows of MSN-2" in problems[-1]
    assert maintenance.rebuild(store.layout) == []
    assert maintenance.check(store.layout).problems == ()


def test_rebuild_makes_the_same_index(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    before = [store.query(f"FROM {table.name} ORDER BY ALL") for table in TABLES]
    shutil.rmtree(store.layout.index)
    store.layout.archive.unlink()
    (store.layout.index).mkdir()
    assert main(["archive", "rebuild", "--store", str(store.root)]) == 0
    assert "index of 3 scenes" in capsys.readouterr().out
    assert [store.query(f"FROM {table.name} ORDER BY ALL") for table in TABLES] == before


def test_rebuild_mends_a_store_that_lost_its_hidden_folders(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    before = store.query("SELECT * FROM rivets ORDER BY ALL")
    for folder in (store.layout.index, store.layout.staging):
        shutil.rmtree(folder)
    assert main(["query", "SELECT 1", "--store", str(store.root)]) == 2
    assert "'flushline archive rebuild'" in capsys.readouterr().err
    assert main(["archive", "rebuild", "--store", str(store.root)]) == 0
    assert store.query("SELECT * FROM rivets ORDER BY ALL").equals(before)
    assert maintenance.check(store.layout).problems == ()


def test_a_cut_index_says_how_to_mend_it(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    index = store.layout.archive.resolve()
    index.chmod(0o644)
    index.write_bytes(index.read_bytes()[:100_000])
    assert main(["query", "SELECT 1", "--store", str(store.root)]) == 2
    assert "'flushline archive rebuild'" in capsys.readouterr().err
    assert main(["archive", "rebuild", "--store", str(store.root)]) == 0


@pytest.mark.parametrize("ending", ["png", "svg"])
def test_no_other_picture_is_handed_to_the_projector(
    store: Store, tmp_path: Path, ending: str, capsys: pytest.CaptureFixture[str]
) -> None:
    scene_id = small_key("S1").scene_id
    overlay = store.paths(scene_id).overlay.with_suffix(f".{ending}")
    overlay.chmod(0o644)
    overlay.write_bytes(overlay.read_bytes() + b" ")
    out = tmp_path / f"overlay.{ending}"
    assert main(["overlay", scene_id, "--store", str(store.root), "--out", str(out)]) == 2
    assert f"error: {overlay}: found" in capsys.readouterr().err
    assert not out.exists()


def test_rebuild_passes_over_a_damaged_run(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    spoil(newest_run(store) / "rivets.parquet")
    assert main(["archive", "rebuild", "--store", str(store.root)]) == 1
    assert "rivets.parquet: found checksum" in capsys.readouterr().err
    heights = store.query("SELECT DISTINCT height_mean_mm FROM rivets").column(0).to_pylist()
    assert heights == [0.05]


def test_compacted_parquet_holds_the_same_rows(store: Store) -> None:
    for _ in range(3):
        parquet = compact(store.layout)
    assert len(list(store.layout.index.glob("parquet-*"))) == 2
    with duckdb.connect() as other:
        for table in TABLES:
            files = str(parquet / table.name / "*" / "*.parquet")
            if store.query(f"FROM {table.name}").num_rows == 0:
                assert not list((parquet / table.name).rglob("*.parquet"))
                continue
            columns = ", ".join(column.name for column in table.columns)
            found = other.execute(f"SELECT {columns} FROM read_parquet(?) ORDER BY ALL", [files]).fetchall()
            with store.connect() as own:
                assert found == own.execute(f"SELECT {columns} FROM {table.name} ORDER BY ALL").fetchall()
    assert sorted(path.name for path in (parquet / "rivets").iterdir()) == [
        "aircraft_serial=MSN-1",
        "aircraft_serial=MSN-2",
    ]


def test_prune_keeps_what_the_index_shows(store: Store) -> None:
    assert maintenance.prune(store.layout, older_than=timedelta(days=1)) == []
    assert maintenance.prune(store.layout, keep=2) == []
    shown = newest_run(store)
    removed = maintenance.prune(store.layout)
    assert len(removed) == 1
    assert shown.is_dir()
    assert maintenance.check(store.layout) == maintenance.Check(3, ())
    with pytest.raises(StoreError, match="at least 1"):
        maintenance.prune(store.layout, keep=0)


@pytest.mark.parametrize("as_uri", [False, True])
def test_export_copies_current_runs_once(store: Store, tmp_path: Path, as_uri: bool) -> None:
    target = tmp_path / "copy"
    place = target.as_uri() if as_uri else str(target)
    assert maintenance.export(store.layout, place, aircraft="MSN-1") == (2, 0)
    assert maintenance.export(store.layout, place) == (1, 2)
    manifests = sorted(target.glob("bundles/*/*/*/*/manifest.json"))
    assert len(manifests) == 3
    for manifest in manifests:
        listed = json.loads(manifest.read_text())["files"]
        assert {path.name for path in manifest.parent.iterdir()} == {*listed, "manifest.json"}
    with pytest.raises(StoreError, match="expected a folder or a URI"):
        maintenance.export(store.layout, "nowhere://x/y")


def test_a_cloud_becomes_a_ply_file(store: Store, tmp_path: Path) -> None:
    scene = small_key("S1").scene_id
    out = tmp_path / "cloud.ply"
    assert main(["archive", "ply", scene, "--store", str(store.root), "--out", str(out)]) == 0
    header = out.read_bytes()[:400].decode("ascii", "replace")
    assert "element vertex" in header
    assert int(header.split("element vertex ")[1].split()[0]) == small_result().reconstruction.valid.sum()


def test_no_store_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for action in ("check", "rebuild", "compact", "prune"):
        assert main(["archive", action, "--store", str(tmp_path / "none")]) == 2
        assert "found no such folder, expected a store" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_the_next_writer_removes_what_a_killed_prune_left(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    store.publish(small_result())
    left = store.layout.staging / "20260101T000000.000000Z-00000000.removed"
    left.mkdir()
    (left / "cloud.parquet").write_bytes(b"half")
    assert store.recover() == 0
    assert not left.exists()

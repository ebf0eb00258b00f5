"""The archive: what is published is what is read, once, whole, and only to be read."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from pathlib import Path

import duckdb
import numpy as np
import pytest

from metrology.errors import RigError, StoreError
from metrology.kinds import KINDS
from metrology.panel import NominalRivet, PanelLayout
from storage.archive import Store, maintenance
from storage.archive.panels import PatternTaken
from storage.archive.schema import KEY, OF_KIND, TABLES
from storage.archive.staging import staged_run
from tests.support.results import small_key, small_result, small_rig

COUNTS = "SELECT (SELECT count(*) FROM scenes), (SELECT count(*) FROM rivets), (SELECT count(*) FROM seam_stations)"


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


def counts(store: Store) -> tuple[int, ...]:
    return tuple(column[0].as_py() for column in store.query(COUNTS).columns)


def tree(root: Path) -> dict[str, float]:
    return {str(path.relative_to(root)): path.lstat().st_mtime_ns for path in root.rglob("*")}


def test_every_field_of_a_result_has_a_column() -> None:
    for kind in KINDS:
        columns = {c.name for c in OF_KIND[kind.name].columns} - {c.name for c in KEY}
        assert {f.name for f in fields(kind.row_type)} == columns


def test_what_is_published_is_read_back(store: Store) -> None:
    result = small_result()
    run = store.publish(result)
    assert counts(store) == (1, 3, 2)
    rivets = store.query("SELECT * FROM rivets ORDER BY rivet_id").to_pylist()
    assert rivets[0]["height_mean_mm"] == 0.05
    assert rivets[0]["captured_at"] == result.key.captured_at
    assert rivets[0]["u_right_px"] is None
    scene = store.query("SELECT * FROM scenes").to_pylist()[0]
    assert (scene["run_id"], scene["rig_id"], scene["status"]) == (run, "rig-a", "ok")
    assert scene["n_points"] == result.reconstruction.valid.sum()
    station = store.query("SELECT * FROM seam_stations WHERE step_mm IS NULL").to_pylist()[0]
    assert (station["reason"], station["x_mm"]) == ("over a rivet", None)


def test_the_cloud_comes_back_to_half_a_micrometre(store: Store) -> None:
    result = small_result()
    store.publish(result)
    cloud = store.load_cloud(result.key.scene_id)
    points = result.reconstruction.points
    assert np.array_equal(np.isnan(cloud.points), np.isnan(points))
    assert np.nanmax(np.abs(cloud.points.astype(float) - points)) <= 0.00055
    assert np.array_equal(cloud.flags, result.reconstruction.flags)
    assert np.allclose(cloud.sigma_z, result.reconstruction.sigma_z, atol=1e-6, equal_nan=True)


def test_inspecting_a_scene_again_replaces_its_rows(store: Store) -> None:
    first = store.publish(small_result(height_mm=0.05))
    other = store.publish(small_result(small_key("S4")))
    second = store.publish(small_result(height_mm=0.07, rivets=2))
    assert first < other < second
    assert counts(store) == (2, 5, 4)
    heights = store.query("SELECT DISTINCT height_mean_mm FROM rivets WHERE station = 'S3'")
    assert heights.column(0).to_pylist() == [0.07]
    assert len(list(store.layout.scene(small_key()).iterdir())) == 2


def test_a_clock_that_went_back_does_not_hide_the_newer_run(store: Store) -> None:
    run = store.publish(small_result())
    ahead = store.layout.scene(small_key())
    shutil.copytree(ahead / run, ahead / "99991231T000000.000000Z-00000000")
    assert store.publish(small_result(height_mm=0.09)) > "99991231T000000.000000Z-00000000"


def test_every_table_and_column_says_what_it_is(store: Store) -> None:
    store.publish(small_result())
    missing = store.query(
        "SELECT table_name, column_name FROM duckdb_columns() WHERE NOT internal AND comment IS NULL "
        "AND table_name IN (SELECT table_name FROM duckdb_tables())"
    )
    assert missing.num_rows == 0
    named = "SELECT table_name, comment FROM duckdb_tables() UNION ALL SELECT view_name, comment FROM duckdb_views() "
    described = store.query(named + "WHERE NOT internal").to_pylist()
    assert len(described) > len(TABLES)
    assert all(row["comment"] for row in described)


@pytest.mark.parametrize(
    "view", ["latest_scenes", "worst_rivets", "worst_seam_stations", "panel_summary", "seam_summary"]
)
def test_views_answer(store: Store, view: str) -> None:
    store.publish(small_result())
    rows = store.query(f"SELECT * FROM {view}").to_pylist()
    assert len(rows) == {"worst_rivets": 0, "worst_seam_stations": 2}.get(view, 1)


@pytest.mark.parametrize(
    "sql",
    [
        "INSERT INTO rivets (rivet_id) VALUES ('x')",
        "DELETE FROM rivets",
        "CREATE TABLE t (i INT)",
        "COPY rivets TO '{out}'",
        "EXPORT DATABASE '{out}'",
        "SELECT * FROM read_csv('{secret}')",
        "SELECT * FROM read_text('{secret}')",
        "SELECT * FROM glob('/*')",
        "ATTACH '{out}' AS other",
        "INSTALL httpfs",
        "LOAD httpfs",
        "SET enable_external_access = true",
        "SET lock_configuration = false",
        "PRAGMA enable_profiling",
        "SET temp_directory = '/'",
        "nonsense",
    ],
)
def test_a_query_can_neither_write_nor_reach_files(store: Store, tmp_path: Path, sql: str) -> None:
    store.publish(small_result())
    secret, out = tmp_path / "secret.txt", tmp_path / "out"
    secret.write_text("secret")
    before = tree(store.root)
    with pytest.raises(StoreError, match="query: "):
        store.query(sql.format(secret=secret, out=out))
    assert not out.exists()
    assert tree(store.root) == before


def test_times_are_utc_whatever_the_machine_says(store: Store) -> None:
    store.publish(small_result())
    code = (
        "import sys; from pathlib import Path; from storage.archive import Store; "
        'print(Store(Path(sys.argv[1])).query("SELECT captured_at::VARCHAR FROM scenes").to_pylist())'
    )
    environment = os.environ | {"TZ": "Asia/Tokyo"}
    said = subprocess.run(
        [sys.executable, "-c", code, str(store.root)], capture_output=True, text=True, env=environment, check=True
    )
    assert "2026-11-20 08:15:00+00" in said.stdout


def test_many_threads_query_at_once(store: Store) -> None:
    store.publish(small_result())
    sql = "SELECT count(*) AS n FROM rivets WHERE panel = ?"
    with ThreadPoolExecutor(4) as threads:
        tables = list(threads.map(lambda _: store.query(sql, ["LH-F12"]), range(40)))
    assert {table["n"][0].as_py() for table in tables} == {3}


def test_a_plain_client_reads_while_results_are_published(store: Store) -> None:
    store.publish(small_result())
    with duckdb.connect(str(store.layout.archive), read_only=True) as client:
        for station in ("S4", "S5", "S6", "S7"):
            store.publish(small_result(small_key(station)))
            assert client.execute("SELECT count(*) FROM scenes").fetchone() == (1,)
    assert counts(store)[0] == 5
    assert len(list(store.layout.generations.glob("*.duckdb"))) == 2


def test_the_published_file_is_of_the_format_that_released_clients_read(store: Store) -> None:
    store.publish(small_result())
    with duckdb.connect(str(store.layout.archive), read_only=True) as client:
        tags = client.execute("SELECT tags FROM duckdb_databases() WHERE NOT internal").fetchone()
    assert tags is not None
    assert tags[0]["storage_version"].startswith("v1.4")


class _Stop(BaseException):
    """Stands for the process being killed at this point."""


@pytest.mark.parametrize(
    ("module", "name"),
    [
        ("storage.archive.bundle", "write_bundle"),
        ("storage.archive.index", "take"),
        ("storage.archive.generations", "publish"),
        ("storage.archive.generations", "point_to"),
    ],
)
def test_a_run_cut_short_leaves_the_old_rows_or_the_new(
    store: Store, monkeypatch: pytest.MonkeyPatch, module: str, name: str
) -> None:
    store.publish(small_result(height_mm=0.05))

    def stop(*_: object) -> None:
        raise _Stop

    with monkeypatch.context() as patch:
        patch.setattr(f"{module}.{name}", stop)
        with pytest.raises(_Stop):
            store.publish(small_result(height_mm=0.07))
    assert store.query("SELECT DISTINCT height_mean_mm FROM rivets").column(0).to_pylist() == [0.05]
    written = name != "write_bundle"
    assert store.recover() == written
    assert store.query("SELECT DISTINCT height_mean_mm FROM rivets").column(0).to_pylist() == [
        0.07 if written else 0.05
    ]
    assert counts(store) == (1, 3, 2)
    assert list(store.layout.staging.iterdir()) == []


def test_dead_staging_is_cleared_and_living_staging_is_left(store: Store) -> None:
    store.publish(small_result())
    (store.layout.staging / "dead").mkdir()
    (store.layout.staging / "dead.json").write_text(json.dumps({"run": "bundles/a/b/c/dead", "pattern": "panels/p/s"}))
    (store.layout.staging / "not-finished.json").write_text("")
    pattern = store.panels.pattern_path("LH-F12", "S9")
    with staged_run(store.layout, store.layout.scene(small_key("S9")), pattern) as run:
        (run.folder / "half.parquet").write_text("half")
        store.recover()
        assert run.folder.is_dir()
        assert {path.name for path in store.layout.staging.iterdir()} == {run.run_id, f"{run.run_id}.json"}


def full_disk(*_: object) -> None:
    raise OSError(28, "No space left on device")


def test_a_full_disk_is_said_and_changes_nothing(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    store.publish(small_result())
    with monkeypatch.context() as patch:
        patch.setattr("storage.archive.bundle.encode_cloud", full_disk)
        with pytest.raises(StoreError, match=r"disk full.*as it was"):
            store.publish(small_result(small_key("S4")))
    assert list(store.layout.staging.iterdir()) == []
    with monkeypatch.context() as patch:
        patch.setattr("storage.archive.generations.clone", full_disk)
        with pytest.raises(StoreError, match=r"disk full.*the result is kept"):
            store.publish(small_result(small_key("S4")))
    assert counts(store)[0] == 1
    store.publish(small_result(small_key("S5")))
    assert counts(store)[0] == 3


PATTERN = PanelLayout((NominalRivet("R1", (1.0, 2.0, 0.0)),))


def test_a_pattern_comes_with_its_result_or_not_at_all(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    result = replace(small_result(), pattern=PATTERN)
    with monkeypatch.context() as patch:
        patch.setattr("storage.archive.bundle.encode_cloud", full_disk)
        with pytest.raises(StoreError, match="disk full"):
            store.publish(result)
    assert not store.layout.panels.exists()
    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", full_disk)
        with pytest.raises(StoreError, match="disk full"):
            store.publish(result)
    assert store.panels.stations("LH-F12") == []
    run = store.publish(result)
    assert store.panels.pattern("LH-F12", "S3") == PATTERN
    assert (store.layout.scene(result.key) / run / "pattern.toml").exists()


def test_a_writer_killed_after_enrolling_leaves_no_pattern(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    store.publish(small_result(small_key("S4")))

    def die(*_: object) -> None:
        os._exit(9)

    child = os.fork()
    if child == 0:
        monkeypatch.setattr(Path, "rename", die)
        store.publish(replace(small_result(), pattern=PATTERN))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    assert store.panels.stations("LH-F12") == ["S3"]
    assert store.recover() == 0
    assert store.panels.stations("LH-F12") == []
    assert list(store.layout.staging.iterdir()) == []


def test_of_two_first_scans_the_one_stored_first_is_the_pattern(store: Store) -> None:
    store.publish(replace(small_result(), pattern=PATTERN))
    later = replace(small_key(), captured_at=small_key().captured_at.replace(hour=9))
    with pytest.raises(PatternTaken, match="enrolled meanwhile"):
        store.publish(replace(small_result(later), pattern=PATTERN))
    assert counts(store)[0] == 1
    assert list(store.layout.staging.iterdir()) == []


def test_the_index_is_made_again_from_the_bundles_alone(store: Store) -> None:
    for station in ("S3", "S4"):
        store.publish(small_result(small_key(station)))
    store.publish(small_result(small_key("S4"), height_mm=0.2))
    before = [store.query(f"SELECT * FROM {table.name} ORDER BY ALL") for table in TABLES]
    shutil.rmtree(store.layout.index)
    store.layout.archive.unlink()
    store.publish(small_result(small_key("S3"), height_mm=0.05))
    after = [store.query(f"SELECT * FROM {table.name} ORDER BY ALL") for table in TABLES]
    assert [table.num_rows for table in after] == [table.num_rows for table in before]
    assert after[1].drop(["scene_id"]).equals(before[1].drop(["scene_id"]))


def test_a_damaged_run_gives_way_to_the_one_before(store: Store) -> None:
    store.publish(small_result(height_mm=0.05))
    run = store.layout.scene(small_key()) / store.publish(small_result(height_mm=0.07))
    damaged = run / "rivets.parquet"
    damaged.chmod(0o644)
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"x")
    problems = maintenance.rebuild(store.layout)
    assert store.query("SELECT run_id FROM scenes").column(0)[0].as_py() < run.name
    assert "rivets.parquet: found checksum" in problems[0]


def test_calibrations_are_found_by_their_id(store: Store) -> None:
    rig = small_rig()
    assert store.add_rig(rig)
    assert not store.add_rig(replace(rig, calibrated_at="2027-01-01T00:00:00Z"))
    assert store.find_rig("rig-a").calibrated_at == rig.calibrated_at
    with pytest.raises(RigError, match="found no rig 'rig-b'"):
        store.find_rig("rig-b")


def test_a_result_is_known_by_its_settings_and_rig(store: Store) -> None:
    result = small_result()
    assert not store.holds(result.key.scene_id, "c0ffee", "x")
    store.publish(result)
    row = store.query("SELECT config_hash, rig_hash FROM scenes").to_pylist()[0]
    assert store.holds(result.key.scene_id, row["config_hash"], row["rig_hash"])
    assert not store.holds(result.key.scene_id, "other", row["rig_hash"])


def occupied(root: Path) -> None:
    root.mkdir()
    (root / "letters.txt").write_text("")


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (occupied, "other things"),
        (lambda root: root.write_text(""), "found a file"),
        (
            lambda root: (root.mkdir(), (root / "flushline-store.json").write_text('{"format": "flushline-store/9"}')),
            "/9",
        ),
    ],
)
def test_a_folder_that_is_no_store_is_left_alone(store: Store, make: Callable[[Path], None], said: str) -> None:
    make(store.root)
    with pytest.raises(StoreError, match=said):
        store.publish(small_result())


def test_many_writers_may_make_the_store_at_once(tmp_path: Path) -> None:
    for attempt in range(10):
        stores = [Store(tmp_path / f"store-{attempt}") for _ in range(8)]
        with ThreadPoolExecutor(8) as threads:
            list(threads.map(Store.prepare, stores))
        stores[0].check_usable()


def test_no_store_is_said(store: Store) -> None:
    with pytest.raises(StoreError, match="found no such folder"):
        store.query("SELECT 1")
    store.root.mkdir()
    with pytest.raises(StoreError, match="expected a store"):
        store.query("SELECT 1")

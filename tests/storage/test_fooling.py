"""What would fool the archive: a clock set back, forged indexes, bundles that lie, files put beside the index."""

from __future__ import annotations

import hashlib
import json
import logging
import shutil
from datetime import UTC, datetime
from pathlib import Path

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from flows.cli import main
from metrology.errors import StoreError
from storage.archive import Store, maintenance, run_ids
from storage.archive.bundles import Bundles
from storage.archive.compaction import compact
from tests.support.damage import forge, spoil
from tests.support.results import copied, small_key, small_result


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Two scenes, one of them inspected twice; do not write to it."""
    store = Store(tmp_path_factory.mktemp("published") / "store")
    for station, height_mm in (("S1", 0.05), ("S2", 0.05), ("S1", 0.2)):
        store.publish(small_result(small_key(station), height_mm=height_mm))
    return store


@pytest.fixture
def store(published: Store, tmp_path: Path) -> Store:
    """A copy of it to write to."""
    return copied(published, tmp_path)


def runs(store: Store, station: str = "S1") -> list[Path]:
    return sorted(store.layout.scene(small_key(station)).iterdir())


def shown(store: Store) -> dict[str, str]:
    return {row["station"]: row["run_id"] for row in store.query("SELECT station, run_id FROM scenes").to_pylist()}


def set_clock(patch: pytest.MonkeyPatch, year: int) -> None:
    class Clock(datetime):
        @classmethod
        def now(cls, tz: object = None) -> datetime:  # type: ignore[override]
            return datetime(year, 1, 1, tzinfo=UTC)

    patch.setattr(run_ids, "datetime", Clock)
    patch.setattr("time.time_ns", lambda: int(datetime(year, 1, 1, tzinfo=UTC).timestamp() * 1e9))


def test_a_clock_set_back_hides_nothing(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    given = [run.name for run in (*runs(store), *runs(store, "S2"))]
    for number, year in enumerate((1999, 2090, 1971, 2020)):
        with monkeypatch.context() as patch:
            set_clock(patch, year)
            run = store.publish(small_result(small_key(f"T{number}"), height_mm=number / 100))
        assert run > max(given)
        assert len(run) == len(given[0])
        given.append(run)
        assert shown(store)[f"T{number}"] == run
        assert len(shown(store)) == 3 + number
        compact(store.layout)
        rivets = str(store.layout.parquet / "scenes" / "*" / "*.parquet")
        assert duckdb.sql(f"SELECT count(*) FROM read_parquet('{rivets}')").fetchall() == [(3 + number,)]
    store.layout.newest_run.unlink()
    assert store.publish(small_result()) > max(given)
    assert maintenance.check(store.layout).problems == ()


def test_a_publish_that_readers_do_not_see_is_not_said_to_be_done(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("storage.archive.generations.point_to", lambda *_: None)
    with pytest.raises(StoreError, match="expected archive-"):
        store.publish(small_result(small_key("S4")))


# ---- bundles that the index cannot take


def rewrite(run: Path, name: str, table: pa.Table | None, **manifest: object) -> None:
    """Change a table of a run and let its manifest agree."""
    path, stated = run / f"{name}.parquet", run / "manifest.json"
    document = json.loads(stated.read_text())
    if table is not None:
        path.unlink()
        pq.write_table(table, path)
        content = path.read_bytes()
        document["files"][path.name] = {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    stated.chmod(0o644)
    stated.write_text(json.dumps(document | manifest))


def with_column(table: pa.Table, name: str, value: object) -> pa.Table:
    column = pa.array([value] * table.num_rows)
    return (
        table.set_column(table.schema.get_field_index(name), name, column)
        if name in table.schema.names
        else (table.append_column(name, column))
    )


LIES = {
    "a column": lambda run, rivets, _: rewrite(run, "rivets", with_column(rivets, "brand_new", 1.0)),
    "words for numbers": lambda run, rivets, _: rewrite(run, "rivets", with_column(rivets, "n_inner", "many")),
    "another scene": lambda run, rivets, _: rewrite(
        run, "rivets", with_column(rivets, "scene_id", small_key("S2").scene_id)
    ),
    "another aircraft": lambda run, rivets, _: rewrite(run, "rivets", with_column(rivets, "aircraft_serial", "MSN-9")),
    "fewer rows": lambda run, rivets, _: rewrite(run, "rivets", rivets.slice(1)),
    "a path": lambda run, _, scenes: rewrite(run, "scenes", with_column(scenes, "overlay_path", "../../../etc/passwd")),
    "another path": lambda run, _, scenes: rewrite(
        run, "scenes", with_column(scenes, "cloud_path", "reviews/log.jsonl")
    ),
    "another run": lambda run, _, scenes: rewrite(run, "scenes", with_column(scenes, "run_id", "zzz")),
    "two scenes": lambda run, _, scenes: rewrite(run, "scenes", pa.concat_tables([scenes, scenes])),
    "a table": lambda run, _rivets, _scenes: rewrite(run, "x", None, rows={"coupons": 1}),
    "a file's name": lambda run, _rivets, _scenes: rewrite(
        run, "x", None, files={"../../../x": {"bytes": 0, "sha256": ""}}
    ),
    "no Parquet": lambda run, _rivets, _scenes: (run / "seam_stations.parquet").unlink(),
    "no manifest": lambda run, _rivets, _scenes: (run / "manifest.json").write_text("{}"),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_bundle_that_cannot_be_taken_is_named_and_the_rest_goes_on(
    store: Store, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, lie: str
) -> None:
    old, bad = runs(store)
    rivets, scenes = (pq.ParquetFile(bad / f"{name}.parquet").read() for name in ("rivets", "scenes"))
    if lie == "no manifest":
        (bad / "manifest.json").chmod(0o644)
    LIES[lie](bad, rivets, scenes)
    problems = maintenance.rebuild(store.layout)
    assert [str(bad) in problem for problem in problems] == [True]
    assert shown(store) == {"S1": old.name, "S2": runs(store, "S2")[0].name}
    assert list(maintenance.check(store.layout).problems) == problems
    # As a run that waits to be indexed, it does not hold up others.
    marker = store.layout.staging / f"{bad.name}.json"
    marker.write_text(json.dumps({"run": store.layout.relative(bad), "pattern": "panels/LH-F12/enrolled/S1.toml"}))
    with caplog.at_level(logging.WARNING):
        run = store.publish(small_result(small_key("S3")))
    assert str(bad) in caplog.text
    assert shown(store)["S3"] == run
    assert shown(store)["S1"] == old.name
    with pytest.raises(StoreError) as refused:
        maintenance.prune(store.layout)
    assert str(bad) in str(refused.value)
    assert runs(store) == [old, bad]


def test_a_writer_that_could_not_index_its_own_run_fails(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    from storage.archive import staging

    settle = staging.settle

    def settle_badly(layout: object, run: staging.StagedRun, pattern: Path) -> None:
        settle(layout, run, pattern)  # type: ignore[arg-type]
        spoil(run.final / "rivets.parquet")

    with monkeypatch.context() as patch:
        patch.setattr(staging, "settle", settle_badly)
        with pytest.raises(StoreError, match=r"rivets\.parquet: found checksum.*not in the tables"):
            store.publish(small_result(small_key("S3")))
    assert set(shown(store)) == {"S1", "S2"}


# ---- prune


def test_prune_keeps_the_last_sound_run(store: Store) -> None:
    old, new = runs(store)
    spoil(new / "cloud.parquet")
    with pytest.raises(StoreError, match=r"cloud\.parquet.*all runs of its scene are kept"):
        maintenance.prune(store.layout)
    assert runs(store) == [old, new]


def test_prune_does_not_believe_the_index(store: Store) -> None:
    old, new = runs(store)
    ghost = "99990101T000000.000000Z-00000000"
    forge(store, f"UPDATE scenes SET run_id = '{ghost}' WHERE station = 'S1'")
    assert maintenance.prune(store.layout) == [old]
    assert runs(store) == [new]


def test_prune_counts_sound_runs_only(store: Store) -> None:
    store.publish(small_result(small_key("S1"), height_mm=0.3))
    first, second, third = runs(store)
    spoil(second / "overlay.png")
    assert maintenance.prune(store.layout, keep=2) == [second]
    assert runs(store) == [first, third]


# ---- forged indexes

FORGERIES = {
    "a value": "UPDATE rivets SET decision = 'pass', height_mean_mm = 0 WHERE station = 'S1'",
    "values swapped": "UPDATE seam_stations SET s_mm = CASE s_mm WHEN 0 THEN 2 ELSE 0 END WHERE station = 'S1'",
    "a row twice": "INSERT INTO rivets SELECT * FROM rivets LIMIT 1",
    "a row less": "DELETE FROM rivets WHERE rivet_id = 'R1' AND station = 'S2'",
    "a scene more": "INSERT INTO scenes BY NAME SELECT * REPLACE ('x' AS scene_id) FROM scenes LIMIT 1",
    "a scene less": "DELETE FROM scenes WHERE station = 'S2'",
    "a view": "CREATE OR REPLACE VIEW worst_seam_stations AS SELECT * FROM latest_seam_stations WHERE false",
}


@pytest.mark.parametrize("forgery", FORGERIES)
def test_a_forged_index_is_found(store: Store, forgery: str, capsys: pytest.CaptureFixture[str]) -> None:
    forge(store, FORGERIES[forgery])
    for arguments in ([], ["--fast"]):
        assert main(["archive", "check", *arguments, "--store", str(store.root)]) == 1
        assert "error: " in capsys.readouterr().err


def test_a_forged_index_is_made_again_from_the_bundles(store: Store) -> None:
    assert main(["archive", "check", "--fast", "--store", str(store.root)]) == 0
    for forgery in FORGERIES.values():
        forge(store, forgery)
    assert main(["archive", "check", "--fast", "--store", str(store.root)]) == 1
    maintenance.rebuild(store.layout)
    assert maintenance.check(store.layout).problems == ()
    assert maintenance.check_fast(store.layout).problems == ()


def test_an_index_forged_with_its_digests_is_found_by_the_bundles(store: Store) -> None:
    forge(store, "UPDATE rivets SET decision = 'pass', height_mean_mm = 0 WHERE station = 'S1'")
    with duckdb.connect(str(store.layout.archive.resolve())) as connection:
        from storage.archive import bookkeeping

        digests = bookkeeping.digests_sql(bookkeeping.additions(connection), lambda table: table)
        connection.execute(
            f"UPDATE bookkeeping.runs SET digest = d.digest FROM ({digests}) d WHERE d.scene_id = runs.scene_id"
        )
    assert maintenance.check_fast(store.layout).problems == ()
    [problem] = maintenance.check(store.layout).problems
    assert "than in its bundle" in problem


# ---- paths


def test_a_forged_path_is_not_followed(store: Store, tmp_path: Path) -> None:
    secret = tmp_path / "secret.svg"
    secret.write_text("secret")
    for path in ("../secret.svg", str(secret), "bundles/../../secret.svg", "reviews/log.jsonl"):
        forge(store, f"UPDATE scenes SET overlay_path = '{path}', bundle_path = '{path}' WHERE station = 'S1'")
        with pytest.raises(StoreError, match="in the tables, expected one of a bundle"):
            store.paths(small_key("S1").scene_id)
        with pytest.raises(StoreError, match="in the tables, expected one of a bundle"):
            store.file(path)
        with pytest.raises(StoreError, match="expected one of a bundle"):
            maintenance.export(store.layout, str(tmp_path / "export"))
        out = tmp_path / "out.svg"
        assert main(["overlay", small_key("S1").scene_id, "--store", str(store.root), "--out", str(out)]) != 0
        assert not out.exists()


def test_names_in_a_manifest_write_nothing_outside(tmp_path: Path) -> None:
    there = tmp_path / "there"
    there.mkdir()
    store = Store(tmp_path / "store")
    store.create(there.as_uri())
    run = store.layout.scene(small_key()) / store.publish(small_result())
    (there / "evil").write_text("evil")
    for place in (run, there / store.layout.relative(run)):
        up = "../" * 5 + "evil"
        rewrite(place, "x", None, files={up: {"bytes": 4, "sha256": ""}}, rows={"scenes": 1})
    shutil.rmtree(store.layout.bundles)
    for bring in (Bundles(store.layout).bring, lambda run: Bundles(store.layout).bring(run, tables_only=True)):
        with pytest.raises(StoreError, match="expected one inside the folder"):
            bring(run)
    assert not (store.root / "evil").exists()


def test_a_link_in_a_bundle_is_no_file_of_it(store: Store, tmp_path: Path) -> None:
    preview = runs(store)[-1] / "preview.png"
    preview.rename(tmp_path / "elsewhere.png")
    preview.symlink_to(tmp_path / "elsewhere.png")
    [problem] = maintenance.check(store.layout).problems
    assert f"{preview}: found a link" in problem


def test_the_check_by_names_looks_into_a_folder_only_where_they_differ(store: Store) -> None:
    *others, run = Bundles(store.layout).runs()
    (run.parent / "99990101T000000000000Z-0").mkdir()  # a copy that was broken off: no run
    assert maintenance.check_fast(store.layout) == maintenance.Check(len(others) + 1, ())
    shutil.rmtree(run)
    [problem] = maintenance.check_fast(store.layout).problems
    assert f"found scene {run.parent.name} without an undamaged run" in problem


def test_a_run_forged_with_its_manifest_is_said_when_the_index_is_made_again(store: Store) -> None:
    """The bundle agrees with itself: only what the index noted when the run came in says otherwise."""
    assert maintenance.rebuild(store.layout) == []
    run = runs(store)[-1]
    rivets = pq.read_table(run / "rivets.parquet")
    rewrite(run, "rivets", with_column(rivets, "height_mean_mm", 0.01))
    (said,) = maintenance.rebuild(store.layout)
    assert said.startswith(f"{run}: found other rows than the index noted when the run came in")
    assert "nobody signed the run off" in said
    assert maintenance.rebuild(store.layout) == []

"""Two scans under one key never replace each other, and a time that lies ahead never hides later scans."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from metrology.errors import SceneError
from metrology.inspection import InspectionResult
from metrology.results import SceneKey
from storage.archive import Store
from storage.archive.staging import staged_run
from storage.scan_identity import frames_digest
from storage.scene import load_manifest, load_scene
from tests.support.results import small_key, small_result


def scan(digest: str | None, key: SceneKey | None = None, height_mm: float = 0.05) -> InspectionResult:
    """A result of frames with this digest."""
    result = small_result(key, height_mm)
    return replace(result, reconstruction=replace(result.reconstruction, frames_digest=digest))


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


def heights(store: Store) -> list[float]:
    return store.query("SELECT DISTINCT height_mean_mm FROM rivets ORDER BY ALL").column(0).to_pylist()


def test_other_frames_under_a_known_key_are_refused(store: Store) -> None:
    first = store.publish(scan("a"))
    with pytest.raises(SceneError, match=f"found other frames than those stored as {small_key().scene_id}"):
        store.publish(scan("b", height_mm=0.2))
    assert heights(store) == [0.05]
    assert [run.name for run in store.bundles.runs()] == [first]
    assert not list(store.layout.staging.iterdir())


def test_the_same_frames_may_be_inspected_again(store: Store) -> None:
    store.publish(scan("a"))
    store.publish(scan("a", height_mm=0.2))
    assert heights(store) == [0.2]
    rows = store.query("SELECT frames_digest, first_stored_at < processed_at AS again FROM scenes").to_pylist()
    assert rows == [{"frames_digest": "a", "again": True}]


def test_a_run_of_unknown_frames_gives_way_and_the_next_ones_are_known(store: Store) -> None:
    store.publish(scan(None))
    store.publish(scan("a"))
    store.publish(scan(None))  # such as by an older version
    with pytest.raises(SceneError, match="found other frames"):
        store.publish(scan("b"))


def test_of_two_scans_stored_at_the_same_time_one_is_refused(store: Store) -> None:
    def publish(digest: str) -> str:
        try:
            store.publish(scan(digest))
        except SceneError:
            return "refused"
        return digest

    with ThreadPoolExecutor(4) as threads:
        outcomes = list(threads.map(publish, ["a", "b", "c", "d"]))
    (kept,) = set(outcomes) - {"refused"}
    assert store.query("SELECT frames_digest FROM scenes").column(0).to_pylist() == [kept]
    assert len(store.bundles.runs()) == 1


def test_a_scan_that_is_being_stored_just_now_counts(store: Store) -> None:
    store.prepare()
    scene = store.layout.scene(small_key())
    pattern = store.root / "pattern.toml"
    with staged_run(store.layout, scene, pattern, "a"):
        with pytest.raises(SceneError, match="being stored just now"), staged_run(store.layout, scene, pattern, "b"):
            pass
        with staged_run(store.layout, scene, pattern, "a"):
            pass
    with staged_run(store.layout, scene, pattern, "b"):  # the first one left nothing
        pass


def at(moment: datetime) -> SceneKey:
    return replace(small_key(), captured_at=moment)


def test_a_time_that_lies_ahead_hides_no_later_scan(store: Store) -> None:
    ahead, true = at(datetime(2036, 5, 1, 9, tzinfo=UTC)), small_key()
    store.publish(scan("a", ahead, 0.9))
    assert store.query("SELECT scene_id FROM latest_scenes").column(0).to_pylist() == [ahead.scene_id]
    store.publish(scan("b", true))
    for view in ("latest_scenes", "latest_rivets", "worst_seam_stations"):
        found = store.query(f"SELECT DISTINCT scene_id FROM {view}").column(0).to_pylist()
        assert found == [true.scene_id], view
    row = store.query("SELECT last_captured_at, height_worst_mm FROM panel_summary").to_pylist()
    assert row == [{"last_captured_at": true.captured_at, "height_worst_mm": 0.05}]


def test_a_little_ahead_is_no_wrong_clock(store: Store) -> None:
    earlier, later = small_key(), at(datetime.now(UTC).replace(microsecond=0) + timedelta(minutes=2))
    store.publish(scan("a", later))
    store.publish(scan("b", earlier))
    assert store.query("SELECT scene_id FROM latest_scenes").column(0).to_pylist() == [later.scene_id]


def test_a_scan_inspected_again_is_as_far_ahead_as_it_was(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    ahead = at(datetime.now(UTC).replace(microsecond=0) + timedelta(days=30))

    class Later(datetime):
        @classmethod
        def now(cls, tz: object = None) -> Later:
            return cls.fromtimestamp(datetime.now(UTC).timestamp() + 60 * 86400, UTC)

    store.publish(scan("a", ahead))
    store.publish(scan("b"))
    monkeypatch.setattr("storage.archive.bundle.datetime", Later)
    store.publish(scan("a", ahead))
    assert store.query("SELECT scene_id FROM latest_scenes").column(0).to_pylist() == [small_key().scene_id]


def test_the_digest_of_files_is_that_of_reading_them(scene_folder: Path) -> None:
    scene, manifest = load_scene(scene_folder), scene_folder / "scene.json"
    left, right = (scene.read(camera).checksums for camera in ("left", "right"))
    digest = frames_digest(scene.code, scene.exposures, left, right)
    assert load_manifest(manifest).digest(scene_folder) == digest
    assert frames_digest(scene.code, scene.exposures, right, left) != digest
    assert frames_digest(replace(scene.code, counts=(7, 5, 6)), scene.exposures, left, right) != digest


def test_the_state_of_files_changes_with_every_file(scene_folder: Path) -> None:
    manifest = scene_folder / "scene.json"
    before = load_scene(scene_folder).files_state
    for path in (manifest, scene_folder / "right" / "e0_c2_s3.png"):
        content = path.read_bytes()
        path.unlink()
        path.write_bytes(content)
        after = load_scene(scene_folder).files_state
        assert after != before
        before = after


def test_frames_under_another_name_are_found(store: Store) -> None:
    keys = [replace(small_key(), aircraft_serial=serial) for serial in ("MSN-1", "MSN-2", "MSN-3")]
    assert store.scenes_of_frames("a", keys[0]) == ()  # nothing is stored
    for key, digest in zip(keys, ("a", "a", None), strict=True):
        store.publish(scan(digest, key))
    assert store.scenes_of_frames("a", keys[0]) == (keys[1].scene_id,)
    assert set(store.scenes_of_frames("a", keys[2])) == {keys[0].scene_id, keys[1].scene_id}
    assert store.scenes_of_frames("b", keys[2]) == ()
    assert store.scenes_of_frames(None, keys[0]) == ()

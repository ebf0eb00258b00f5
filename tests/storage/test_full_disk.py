"""A disk that is really full: one clear line, nothing half-written, and all is well once there is room."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import duckdb
import pytest

from metrology.errors import StoreError
from storage.archive import Store, compaction, maintenance
from storage.archive.compaction import compact
from tests.support.results import small_key, small_result

RIVETS = 9


class Disk:
    """A file system of its own in memory."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def mount(self, kilobytes: int) -> None:
        options = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(self.folder)]
        if subprocess.run(options, capture_output=True, check=False).returncode:
            pytest.skip("mounting a file system is not permitted here")

    def grow(self) -> None:
        subprocess.run(["mount", "-o", "remount,size=64m", str(self.folder)], check=True)

    def unmount(self) -> None:
        subprocess.run(["umount", str(self.folder)], check=True)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    folder = tmp_path / "disk"
    folder.mkdir()
    disk = Disk(folder)
    yield disk
    if folder.is_mount():
        disk.unmount()


def fill(store: Store) -> tuple[int, str]:
    """Publish until there is no room; how many scenes went in, and what was said then."""
    for stored in range(200):
        try:
            store.publish(small_result(small_key(f"S{stored}"), rivets=RIVETS))
        except StoreError as problem:
            return stored, str(problem)
    raise AssertionError("the disk did not fill up")


@pytest.mark.parametrize("kilobytes", [8, 24, 100, 900, 4600, 5100, 7000])
def test_a_full_disk_is_said_and_all_is_well_once_there_is_room(disk: Disk, kilobytes: int) -> None:
    disk.mount(kilobytes)
    store = Store(disk.folder / "store")
    stored, said = fill(store)
    assert "found the disk full" in said
    kept = "the result is kept in" in said
    acts: tuple[Callable[[], object], ...] = (
        store.recover,
        lambda: maintenance.rebuild(store.layout),
        lambda: compact(store.layout),
        lambda: maintenance.prune(store.layout),
        lambda: maintenance.check(store.layout),
    )
    for act in acts:
        with contextlib.suppress(StoreError):
            act()
    if store.layout.archive.exists():
        rivets = store.query("SELECT count(*) AS n FROM rivets GROUP BY scene_id").column(0).to_pylist()
        assert set(rivets) <= {RIVETS}
    disk.grow()
    store.publish(small_result(small_key("LAST"), rivets=RIVETS))
    assert maintenance.check(store.layout) == maintenance.Check(stored + kept + 1, ())
    assert list(store.layout.staging.iterdir()) == []


def test_what_duckdb_says_of_a_full_disk_while_compacting_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path / "store")
    store.publish(small_result())

    def write(*_: object) -> None:
        raise duckdb.IOException('IO Error: Async write failed: "Could not write file: No space left on device"')

    monkeypatch.setattr(compaction, "_write", write)
    with pytest.raises(StoreError, match="found the disk full"):
        compact(store.layout)
    assert not list(store.layout.index.glob("parquet-*"))

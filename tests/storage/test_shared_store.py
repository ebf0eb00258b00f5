"""A store that a group shares: files follow the umask, and a second user can go on where the first one stopped."""

from __future__ import annotations

import errno
import fcntl
import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from metrology.errors import StoreError
from storage.archive import Store, maintenance
from storage.archive.compaction import compact
from storage.archive.files import locked
from storage.review import ReviewLog, ShownScene
from storage.rig import save_rig
from storage.saved_queries import SavedQueries
from tests.support.results import small_key, small_result, small_rig
from tests.support.users import as_user, only_root, open_to_all

GROUP = 61000


@pytest.fixture
def umask() -> Iterator[Callable[[int], int]]:
    before = os.umask(0o022)
    yield os.umask
    os.umask(before)


def use(store: Store, station: str) -> None:
    """Everything that writes into a store."""
    run = store.publish(small_result(small_key(station)))
    store.add_rig(small_rig())
    SavedQueries(store.root).save("mine", "SELECT 1")
    ReviewLog(store.root).sign_off("k.ito", ShownScene(small_key(station).scene_id, run))
    maintenance.prune(store.layout)
    maintenance.rebuild(store.layout)
    compact(store.layout)


@pytest.mark.parametrize(("mask", "never", "files"), [(0o002, 0o002, 0o040), (0o027, 0o027, 0o040), (0o077, 0o077, 0)])
def test_files_and_folders_follow_the_umask(
    umask: Callable[[int], int], tmp_path: Path, mask: int, never: int, files: int
) -> None:
    umask(mask)
    store = Store(tmp_path / "store")
    use(store, "S1")
    for path in (store.root, *store.root.rglob("*")):
        mode = stat.S_IMODE(path.lstat().st_mode)
        if path.is_symlink():
            continue
        assert mode & never == 0, path
        assert mode & files == files, path
    for lock in (store.layout.lock, store.root / "reviews" / ".lock", store.root / "reviews" / "decisions.sqlite"):
        assert stat.S_IMODE(lock.stat().st_mode) == 0o666 & ~mask


@only_root
def test_a_second_user_of_the_group_writes_where_the_first_one_did(tmp_path: Path) -> None:
    open_to_all(tmp_path)
    root = tmp_path / "store"
    root.mkdir()
    os.chown(root, 0, GROUP)
    root.chmod(0o2775)
    for user, station in ((61001, "S1"), (61002, "S2"), (61001, "S3")):

        def work(station: str = station) -> None:
            os.umask(0o002)
            use(Store(root), station)

        as_user(user, work, groups=(GROUP,))
    assert Store(root).query("SELECT count(*) AS n FROM scenes").column(0).to_pylist() == [3]
    assert {path.stat().st_gid for path in root.rglob("*")} == {GROUP}


def test_a_file_system_without_locks_names_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    said = 'lock: found "No locks available", expected a file system with file locks'
    with pytest.raises(StoreError, match=said), locked(tmp_path / "lock"):
        pass
    with pytest.raises(StoreError, match="No locks available"):
        Store(tmp_path / "store").publish(small_result())


def test_rig_files_follow_the_umask(umask: Callable[[int], int], tmp_path: Path) -> None:
    umask(0o007)
    save_rig(small_rig(), tmp_path / "rig.json")
    assert stat.S_IMODE((tmp_path / "rig.json").stat().st_mode) == 0o660

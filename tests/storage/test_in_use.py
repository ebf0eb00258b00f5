"""A program that holds the published index open for writing keeps nobody from storing, pruning or deciding."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import pytest

from metrology.errors import StoreError
from storage.archive import Store, generations, maintenance, snapshot
from storage.archive.files import locked
from tests.support.results import small_key, small_result

HOLD = "import duckdb, sys; held = duckdb.connect(sys.argv[1]); print('held', flush=True); sys.stdin.read()"


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """A store whose bundles lie elsewhere, with a replaced run."""
    store = Store(tmp_path / "store")
    store.create((tmp_path / "elsewhere").as_uri())
    for height_mm in (0.01, 0.02):
        store.publish(small_result(height_mm=height_mm))
    return store


@pytest.fixture
def _held(store: Store) -> Iterator[None]:
    """Another program has the published index open for writing; what waits for ever is cut short."""

    def give_up(_number: int, _frame: FrameType | None) -> None:
        raise TimeoutError("waits for its own lock")

    generation = store.layout.archive.resolve()
    generation.chmod(0o644)
    before = signal.signal(signal.SIGALRM, give_up)
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(generation)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout
        assert other.stdout.readline() == b"held\n"
        signal.alarm(20)
        yield
        signal.alarm(0)
        other.communicate()
    signal.signal(signal.SIGALRM, before)


def forget_tables(store: Store) -> None:
    """Leave what is known of the scene in the index alone, as after the local copies were deleted."""
    for manifest in store.layout.bundles.rglob("manifest.json"):
        manifest.unlink()


@pytest.mark.usefixtures("_held")
def test_a_result_is_stored(store: Store) -> None:
    forget_tables(store)
    store.publish(small_result(height_mm=0.03))
    assert store.query("SELECT max(height_mean_mm) FROM rivets").column(0).to_pylist() == [0.03]


@pytest.mark.usefixtures("_held")
def test_replaced_runs_are_pruned(store: Store) -> None:
    assert len(maintenance.prune(store.layout)) == 1


@pytest.mark.usefixtures("_held")
def test_who_holds_the_lock_is_refused_instead_of_waiting(store: Store) -> None:
    with locked(store.layout.lock), pytest.raises(StoreError, match="set lock"):
        snapshot.connect(store.layout, mend=False)


def test_a_rebuild_catches_up_with_what_was_stored_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path / "store")
    store.publish(small_result(small_key("S1")))
    store.publish(small_result(small_key("S2")))
    looked_at: list[list[Path] | None] = []
    stored_meanwhile = maintenance._stored_meanwhile

    def look(*where: object) -> list[Path] | None:
        looked_at.append(stored_meanwhile(*where))  # type: ignore[arg-type]
        return looked_at[-1]

    catch_up = maintenance.index.catch_up

    def catch_up_while_others_store(*what: object) -> dict[Path, str]:
        refused = catch_up(*what)  # type: ignore[arg-type]
        if not looked_at:
            store.publish(small_result(small_key("S2"), height_mm=0.04))
            store.publish(small_result(small_key("S3")))
        return refused

    monkeypatch.setattr(maintenance, "_stored_meanwhile", look)
    monkeypatch.setattr(maintenance.index, "catch_up", catch_up_while_others_store)
    assert maintenance.rebuild(store.layout) == []
    assert [run.parent.name.split("~")[2] for run in looked_at[0] or ()] == ["S2", "S2", "S3"]
    assert maintenance.check(store.layout) == maintenance.Check(4, ())
    assert len(generations.all_of(store.layout)) == 2

"""A store whose bundles lie on object storage: an S3 emulator on the loopback."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from metrology.errors import StoreError
from metrology.panel import NominalRivet, PanelLayout
from storage.archive import Store, maintenance
from storage.archive.compaction import compact
from storage.archive.remote import Remote
from tests.support.exported import deliver_panels
from tests.support.results import small_key, small_result
from tests.support.s3 import bundles_uri, emulated_s3

pytest.importorskip("moto.server", reason="moto[server] emulates S3")
pytestmark = pytest.mark.services


@pytest.fixture(scope="module")
def s3() -> Iterator[str]:
    with emulated_s3() as endpoint:
        yield endpoint


@pytest.fixture
def target(s3: str, tmp_path: Path) -> str:
    return bundles_uri(s3, tmp_path.name)


@pytest.fixture
def store(target: str, tmp_path: Path) -> Store:
    assert main(["archive", "create", "--store", str(tmp_path / "store"), "--bundles", target]) == 0
    return Store(tmp_path / "store")


def test_bundles_lie_there_and_come_back(store: Store, target: str) -> None:
    result = small_result()
    run = store.layout.scene(result.key) / store.publish(result)
    assert Remote(target).runs() == [store.layout.relative(run)]
    assert not (run / "cloud.parquet").exists()
    cloud = store.load_cloud(result.key.scene_id)
    assert np.nanmax(np.abs(cloud.points - result.reconstruction.points)) < 0.001
    assert store.file(store.layout.relative(run / "preview.png")).is_file()
    assert maintenance.check(store.layout) == maintenance.Check(1, ())


def test_the_index_is_made_again_from_there_alone(store: Store) -> None:
    for station in ("S3", "S4"):
        store.publish(small_result(small_key(station)))
    before = store.query("FROM rivets ORDER BY ALL")
    shutil.rmtree(store.layout.bundles)
    shutil.rmtree(store.layout.index)
    store.layout.archive.unlink()
    store.prepare()
    assert maintenance.rebuild(store.layout) == []
    assert store.query("FROM rivets ORDER BY ALL") == before
    assert maintenance.check(store.layout) == maintenance.Check(2, ())


def test_damage_there_is_named(store: Store, target: str) -> None:
    store.publish(small_result())
    there = Remote(target)
    (run,) = there.runs()
    there.write(f"{run}/overlay.png", b"nothing")
    assert "overlay.png: found 7 bytes" in maintenance.check(store.layout).problems[0]


def test_prune_removes_there_and_here(store: Store, target: str) -> None:
    old = store.publish(small_result())
    new = store.publish(small_result(height_mm=0.2))
    assert [run.name for run in maintenance.prune(store.layout)] == [old]
    assert [run.rpartition("/")[2] for run in Remote(target).runs()] == [new]
    assert maintenance.check(store.layout) == maintenance.Check(1, ())


def test_parquet_goes_there(store: Store, target: str) -> None:
    from pyarrow import dataset

    store.publish(small_result())
    for _ in range(3):
        assert compact(store.layout) == target
    there = Remote(target)
    names = there.folders("parquet")
    with there.filesystem.open_input_stream(f"{there.base}/parquet/latest") as stream:
        assert stream.read().decode() == names[-1]
    assert len(names) == 2
    rivets = dataset.dataset(f"{there.base}/parquet/{names[-1]}/rivets", filesystem=there.filesystem, format="parquet")
    assert rivets.count_rows() == 3


class _Stop(BaseException):
    """Stands for the process being killed at this point."""


@pytest.mark.parametrize("arrived", [False, True])
def test_a_writer_that_died_leaves_the_run_whole_or_nothing(
    store: Store, target: str, monkeypatch: pytest.MonkeyPatch, arrived: bool
) -> None:
    store.publish(small_result(small_key("S4")))
    put = Remote.put

    def die(there: Remote, folder: Path, run: str) -> None:
        if arrived:
            put(there, folder, run)
        else:
            there.copy_files([folder / "cloud.parquet"], run)
        raise _Stop

    with monkeypatch.context() as patch:
        patch.setattr(Remote, "put", die)
        patch.setattr("storage.archive.staging._remove", lambda *_: None)  # a dead process tidies nothing up
        with pytest.raises(_Stop):
            store.publish(replace(small_result(), pattern=PanelLayout((NominalRivet("R1", (1.0, 2.0, 0.0)),))))
    assert store.recover() == arrived
    assert len(Remote(target).runs()) == 1 + arrived
    assert store.panels.stations("LH-F12") == ["S3"] * arrived
    assert maintenance.check(store.layout) == maintenance.Check(1 + arrived, ())
    assert list(store.layout.staging.iterdir()) == []


def test_storage_that_does_not_answer_is_said(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    store.publish(small_result())

    def fail(*_: object) -> None:
        raise OSError("When completing multipart upload: no connection")

    with monkeypatch.context() as patch:
        patch.setattr(Remote, "put", fail)
        with pytest.raises(StoreError, match=r"no connection.*the store is as it was"):
            store.publish(small_result(small_key("S4")))
    assert list(store.layout.staging.iterdir()) == []
    assert store.query("SELECT count(*) FROM scenes").column(0)[0].as_py() == 1
    shutil.rmtree(store.layout.bundles)
    with monkeypatch.context() as patch:
        patch.setattr(Remote, "fetch", fail)
        with pytest.raises(StoreError, match="no connection"):
            store.load_cloud(small_key().scene_id)


def test_a_panel_is_delivered_there(target: str, tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    store.publish(small_result())
    deliver_panels(store, target, "csv")
    assert main(["deliver", "--store", str(store.root)]) == 0
    Remote(target).fetch(".", "MSN-1~LH-F12-rivets.csv", tmp_path / "rivets.csv")
    assert len((tmp_path / "rivets.csv").read_text("utf-8-sig").splitlines()) == 1 + 3


def test_a_delivery_waits_for_a_bucket_that_is_not_there(
    target: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(tmp_path / "store")
    store.publish(small_result())
    deliver_panels(store, target.replace("s3://", "s3://no-"), "csv")
    assert main(["deliver", "--store", str(store.root)]) == 1
    assert "0 delivered, 1 waiting, 0 given up" in capsys.readouterr().out

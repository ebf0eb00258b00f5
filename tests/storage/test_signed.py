"""A scene that is signed off keeps the run it was signed off on, whatever is inspected, pruned or made again."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest

from metrology.errors import StoreError, UsageError
from storage.archive import Store, maintenance
from storage.archive.decisions import dispose, shown_finding, sign_off
from storage.archive.work import standings
from storage.review import ReviewLog, ShownScene
from tests.support.results import small_key, small_result

SCENE = small_key().scene_id


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


def sign(store: Store, run: str) -> None:
    """Accept every finding of the run that is shown, and sign `run` off."""
    log = ReviewLog(store.root)
    with contextlib.closing(store.connect()) as connection:
        review = log.read()
        found = [
            shown_finding(connection, review, SCENE, standing.feature)
            for standing in standings(connection, review, SCENE)
            if standing.state == "waiting"
        ]
    if found:
        dispose(store.root, "k.ito", [finding for finding in found if finding], "use as is")
    sign_off(store.root, "k.ito", ShownScene(SCENE, run, {}, log.read().last_of_scene(SCENE)))


def shown(store: Store) -> list[str]:
    return store.query("SELECT run_id FROM scenes WHERE scene_id = ?", [SCENE]).column(0).to_pylist()


def sign_later(store: Store, run: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sign a run off just after the next one of the scene got its place."""
    from storage.archive import staging

    settle = staging.settle

    def settle_and_sign(*arguments: object) -> None:
        settle(*arguments)  # type: ignore[arg-type]
        sign(store, run)

    monkeypatch.setattr(staging, "settle", settle_and_sign)


def test_it_is_not_inspected_again(store: Store) -> None:
    run = store.publish(small_result())
    sign(store, run)
    with pytest.raises(StoreError, match=r"signed off by k\.ito at .*, expected an open scene"):
        store.publish(small_result(height_mm=0.2))
    assert shown(store) == [run]
    assert len(list(store.layout.scene(small_key()).iterdir())) == 1
    store.publish(small_result(small_key("S4")))


def test_a_sign_off_during_an_inspection_wins(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    run = store.publish(small_result())
    sign_later(store, run, monkeypatch)
    with pytest.raises(StoreError, match="signed off"):
        store.publish(small_result(height_mm=0.2))
    assert shown(store) == [run]
    maintenance.rebuild(store.layout)
    assert shown(store) == [run]
    assert maintenance.check(store.layout).problems == ()


def test_a_run_that_was_replaced_meanwhile_is_not_signed_off(store: Store) -> None:
    first = store.publish(small_result())
    second = store.publish(small_result(height_mm=0.2))
    with pytest.raises(UsageError, match=f"inspected again .run {second}.*look at the new result first"):
        sign(store, first)
    sign(store, second)


def test_prune_keeps_what_was_signed_off(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    old, signed = store.publish(small_result()), store.publish(small_result(height_mm=0.1))
    with monkeypatch.context() as patch:
        sign_later(store, signed, patch)
        with pytest.raises(StoreError):
            store.publish(small_result(height_mm=0.2))
    newest = max(store.layout.scene(small_key()).iterdir()).name
    # As in a store where a newer run was shown before sign-offs locked a scene.
    monkeypatch.setattr(maintenance, "_shown", lambda _: {SCENE: newest})
    assert [run.name for run in maintenance.prune(store.layout)] == [old]
    assert {run.name for run in store.layout.scene(small_key()).iterdir()} == {signed, newest}


def test_prune_does_nothing_where_the_log_is_damaged(store: Store) -> None:
    store.publish(small_result())
    run = store.publish(small_result(height_mm=0.1))
    sign(store, run)
    ReviewLog(store.root).path.unlink()
    with pytest.raises(StoreError, match="nothing is removed"):
        maintenance.prune(store.layout)
    assert len(list(store.layout.scene(small_key()).iterdir())) == 2

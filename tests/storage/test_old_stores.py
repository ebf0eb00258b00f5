"""Stores that earlier versions wrote stay readable: every scene, rivet, seam position, decision and sign-off is shown.

The stores lie in tests/data, made by tests/data/make_store.py of their version; beside each lies what it holds. One
that this version makes is read in the same way.
"""

from __future__ import annotations

import json
import tarfile
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from flows.cli import main
from metrology.errors import StoreError
from storage.archive import Store
from storage.archive.schema import TABLES
from storage.archive.views import VIEWS
from storage.review import ReviewLog
from storage.saved_queries import SavedQueries
from tests.data import make_store
from tests.support.results import small_key, small_result

DATA = Path(__file__).resolve().parent.parent / "data"
VERSIONS = sorted(path.name.removesuffix(".tar.xz") for path in DATA.glob("store-*.tar.xz"))
SIGNED = small_key("S2")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a store as this version makes it for later ones."""
    folder = tmp_path_factory.mktemp("made")
    make_store.main(folder / "store-now")
    return folder


@pytest.fixture(params=[*VERSIONS, "store-now"])
def old(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Store, dict[str, Any]]:
    """A store of an earlier version or of this one, and what it holds."""
    folder = DATA if request.param in VERSIONS else request.getfixturevalue("made")
    with tarfile.open(folder / f"{request.param}.tar.xz") as tar:
        tar.extractall(tmp_path, filter="tar")
    return Store(tmp_path / "store"), json.loads((folder / f"{request.param}.json").read_text(encoding="utf-8"))


def missing_rows(store: Store, held: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of an old store, in the columns that it had, that are not shown once each."""
    lost = []
    for table, rows in held["tables"].items():
        shown = [json.loads(json.dumps(row, default=str)) for row in store.query(f"FROM {table}").to_pylist()]
        for row in rows:
            if sum({name: found.get(name) for name in row} == row for found in shown) != 1:
                lost.append(row)
    return lost


def check_people(store: Store, held: dict[str, Any]) -> None:
    """Every decision, sign-off, saved query, pattern and specification is there."""
    review = ReviewLog(store.root).read()
    assert review.problem is None
    names = ("at", "who", "action", "scene_id", "run_id", "feature_kind", "feature_id", "disposition", "comment")
    for entry, wanted in zip(review.entries, held["review"], strict=True):
        assert [getattr(entry, name) for name in names[1:]] == [wanted[name] for name in names[1:]]
        assert entry.at == datetime.fromisoformat(wanted["at"])
    assert set(review.sign_offs()) == {SIGNED.scene_id}
    assert SavedQueries(store.root).read() == held["queries"]
    assert {panel: store.panels.stations(panel) for panel in store.panels.names()} == held["patterns"]
    for panel, texts in held["specifications"].items():
        assert [version.path.read_text(encoding="utf-8") for version in store.panels.versions(panel)] == texts
    assert {scene: int((store.load_cloud(scene).flags == 0).sum()) for scene in held["points"]} == held["points"]


def test_it_shows_all_that_it_holds(old: tuple[Store, dict[str, Any]]) -> None:
    store, held = old
    assert missing_rows(store, held) == []
    check_people(store, held)
    told = store.query("SELECT DISTINCT unnest(config_hashes) AS c FROM limits").column(0).to_pylist()
    assert set(told) == set(store.query("SELECT config_hash FROM scenes").column(0).to_pylist())


def test_it_takes_another_result(old: tuple[Store, dict[str, Any]]) -> None:
    store, held = old
    run = store.publish(small_result(small_key("S9")))
    assert store.query("SELECT run_id FROM scenes WHERE station = 'S9'").column(0).to_pylist() == [run]
    assert store.query("SELECT count(*) FROM scenes").column(0).to_pylist() == [len(held["tables"]["scenes"]) + 1]
    assert missing_rows(store, held) == []
    with pytest.raises(StoreError, match="signed off"):
        store.publish(small_result(SIGNED))
    check_people(store, held)


def test_its_index_is_made_again(old: tuple[Store, dict[str, Any]], capsys: pytest.CaptureFixture[str]) -> None:
    store, held = old
    assert main(["archive", "rebuild", "--store", str(store.root)]) == 0
    assert missing_rows(store, held) == []
    assert main(["archive", "check", "--store", str(store.root)]) == 0
    assert "5 runs checked, 0 problems" in capsys.readouterr().out
    check_people(store, held)


def test_it_is_read_where_it_may_not_be_changed(
    old: tuple[Store, dict[str, Any]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    store, held = old
    monkeypatch.setattr("os.access", lambda path, mode: False)
    before = sorted(store.layout.generations.iterdir())
    for table in TABLES:  # what the version did not have yet is NULL
        assert set(store.query(f"FROM {table.name}").column_names) >= {column.name for column in table.columns}
    for view in VIEWS:
        store.query(f"FROM {view.name}")
    assert missing_rows(store, held) == []
    scene = held["tables"]["scenes"][0]["scene_id"]
    assert main(["report", scene, "--store", str(store.root), "--out", str(tmp_path / "scene.html")]) == 0
    assert main(["query", "SELECT rig_verdict FROM scenes", "--store", str(store.root)]) == 0
    assert "error" not in capsys.readouterr().err
    assert sorted(store.layout.generations.iterdir()) == before

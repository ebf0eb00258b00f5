"""No query writes beside the index, whatever it is called, and what lies there changes nothing that is read."""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path

import duckdb
import pytest

from flows.cli import main
from metrology.errors import FlushlineError, StoreError
from storage.archive import Store, maintenance, snapshot
from tests.support.results import small_key, small_result

COMPANIONS = (".wal", ".wal.recovery", ".wal.checkpoint", ".checkpoint.wal", ".recovery.wal", ".tmp", ".tmp/x", "")
FORMATS = ("csv", "parquet", "blob", "json")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    store = Store(tmp_path_factory.mktemp("companions") / "store")
    for height_mm in (0.05, 0.2):
        store.publish(small_result(height_mm=height_mm))
    return store


def listing(root: Path) -> dict[str, tuple[int, str]]:
    """Names, sizes and checksums of all that is there."""
    found = {}
    for path in sorted(root.rglob("*")):
        content = path.read_bytes() if path.is_file() else b""
        found[str(path.relative_to(root))] = (path.lstat().st_size, hashlib.sha256(content).hexdigest())
    return found


def attempts(store: Store) -> list[str]:
    generation = str(store.layout.archive.resolve())
    places = [generation + ending for ending in COMPANIONS]
    places += [str(store.layout.archive), f"{store.layout.archive}.wal", str(store.layout.lock)]
    sources = {
        "blob": "SELECT from_base64('" + base64.b64encode(b"forged").decode() + "') AS content",
        "csv": "SELECT 1 AS a",
        "parquet": "SELECT 1 AS a",
        "json": "SELECT 1 AS a",
    }
    return [
        f"{explained}COPY ({sources[kind]}) TO '{place}' (FORMAT {kind}, USE_TMP_FILE {temporary})"
        for place in places
        for kind in FORMATS
        for temporary in ("true", "false")
        for explained in ("", "EXPLAIN ANALYZE ")
    ]


@pytest.mark.slow
def test_no_statement_writes_beside_the_index(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    before = listing(store.root)
    for sql in attempts(store):
        with pytest.raises(FlushlineError):
            store.query(sql)
    assert listing(store.root) == before
    # The command takes the same way; one statement of each kind and place shows it.
    for sql in attempts(store)[::4]:
        assert main(["query", sql, "--store", str(store.root)]) != 0
    capsys.readouterr()
    assert listing(store.root) == before


def test_what_a_query_has_to_put_aside_finds_its_place(store: Store) -> None:
    with store.connect() as connection:
        assert connection.execute("SELECT current_setting('temp_directory')").fetchall()[0][0].startswith("/")
        assert connection.execute("SELECT count(*) FROM range(2000000) t(i)").fetchall() == [(2000000,)]


@pytest.fixture
def forged(tmp_path: Path) -> tuple[Store, Path]:
    """A store with a log beside its index that would make every rivet pass."""
    store = Store(tmp_path / "store")
    store.publish(small_result(small_key("S1")))
    generation = store.layout.archive.resolve()
    copy = tmp_path / "copy.duckdb"
    copy.write_bytes(generation.read_bytes())
    connection = duckdb.connect(str(copy))
    connection.execute("SET checkpoint_threshold = '1GB'; UPDATE rivets SET height_mean_mm = 0")
    log = generation.with_name(generation.name + ".wal")
    log.write_bytes(copy.with_name("copy.duckdb.wal").read_bytes())
    connection.close()
    assert log.stat().st_size > 0
    return store, log


HEIGHTS = "SELECT DISTINCT height_mean_mm FROM rivets"


def test_a_log_beside_the_index_is_not_replayed(forged: tuple[Store, Path]) -> None:
    store, log = forged
    assert store.query(HEIGHTS).column(0).to_pylist() == [0.05]
    store.publish(small_result(small_key("S2")))
    store.publish(small_result(small_key("S3")))
    assert store.query(HEIGHTS).column(0).to_pylist() == [0.05]
    assert not log.exists()
    assert list(store.layout.generations.glob("*.wal*")) == []
    assert maintenance.check(store.layout).problems == ()


def test_a_reader_that_may_not_write_refuses_it(forged: tuple[Store, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    store, log = forged
    monkeypatch.setattr(snapshot.os, "access", lambda *_: False)
    with pytest.raises(StoreError, match=r"\.wal beside it, which would change what is read"):
        store.query(HEIGHTS)
    assert log.exists()


def test_a_log_beside_the_index_is_named(forged: tuple[Store, Path]) -> None:
    store, log = forged
    assert maintenance.check(store.layout).problems == (
        f"{log}: found it beside a generation of the index, expected nothing there",
    )

"""Versions with other tables, columns or views share a store: no run and no column is lost, whoever writes."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from metrology.errors import StoreError
from storage.archive import Store, bookkeeping, bundle, maintenance, schema, views
from storage.archive.schema import KEY, SCENES, TABLES, Column, Table
from storage.archive.views import View
from tests.support.damage import forge
from tests.support.results import copied, small_key, small_result

COUPONS = Table("coupons", "One row per coupon", (*KEY, Column("coupon_id", "VARCHAR", "name of the coupon")))
WIDER = replace(TABLES[1], columns=(*TABLES[1].columns, Column("torque_nm", "DOUBLE", "torque, N m")))
ONE_WORD = tuple(replace(view, comment=view.comment.replace("newest", "latest")) for view in views.VIEWS)
NEW_VIEW = (*views.VIEWS, View("torques", "Rivets with a torque", "SELECT * FROM rivets WHERE torque_nm IS NOT NULL"))
OTHER_TABLES = {
    "one word of a view": (TABLES, ONE_WORD),
    "a column": ((SCENES, WIDER, *TABLES[2:]), NEW_VIEW),
    "a table": ((*TABLES, COUPONS), views.VIEWS),
}
Other = Callable[[], Any]


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Three scenes of this version; do not write to it."""
    store = Store(tmp_path_factory.mktemp("published") / "store")
    for station in ("S1", "S2", "S3"):
        store.publish(small_result(small_key(station)))
    return store


@pytest.fixture
def store(published: Store, tmp_path: Path) -> Store:
    """A copy of it to write to."""
    return copied(published, tmp_path)


def become(
    patch: pytest.MonkeyPatch, tables: tuple[Table, ...], other_views: tuple[View, ...], version: str = "0.2.0"
) -> None:
    """Go on as another version, which writes its own columns and tables into its bundles, too."""
    written = bundle.result_tables

    def result_tables(*arguments: Any) -> dict[str, pa.Table]:
        rows = written(*arguments)
        key = rows["scenes"].select([column.name for column in KEY])
        if COUPONS in tables:
            rows["coupons"] = key.append_column(pa.field("coupon_id", pa.string()), pa.array(["C1"]))
        if WIDER in tables:
            count = rows["rivets"].num_rows
            rows["rivets"] = rows["rivets"].append_column("torque_nm", pa.array([4.5] * count, pa.float64()))
        return rows

    patch.setattr(schema, "TABLES", tables)
    patch.setattr(views, "VIEWS", other_views)
    patch.setattr(bundle, "result_tables", result_tables)
    patch.setattr(bookkeeping, "installed_version", lambda _: version)


def scenes(store: Store) -> int:
    return int(store.query("SELECT count(*) FROM scenes").column(0)[0].as_py())


def newer_rows(store: Store, kind: str) -> list[object]:
    sql = {
        "a column": "SELECT DISTINCT station FROM torques WHERE torque_nm = 4.5 ORDER BY 1",
        "a table": "SELECT station FROM coupons ORDER BY 1",
        "one word of a view": "SELECT station FROM scenes WHERE station IN ('S4', 'S6') ORDER BY 1",
    }[kind]
    return store.query(sql).column(0).to_pylist()


@pytest.mark.parametrize("kind", OTHER_TABLES)
def test_both_ways_round_nothing_is_lost(store: Store, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    with monkeypatch.context() as patch:
        become(patch, *OTHER_TABLES[kind])
        assert scenes(store) == 3
        store.publish(small_result(small_key("S4")))
        assert scenes(store) == 4
        assert newer_rows(store, kind) == ["S4"]
        assert maintenance.check(store.layout).problems == ()
    store.publish(small_result(small_key("S5")))
    assert scenes(store) == 5
    assert newer_rows(store, kind) == ["S4"]
    with monkeypatch.context() as patch:
        become(patch, *OTHER_TABLES[kind])
        store.publish(small_result(small_key("S6")))
        assert newer_rows(store, kind) == ["S4", "S6"]
    for check in (maintenance.check, maintenance.check_fast):
        assert check(store.layout).problems == ()
    assert maintenance.rebuild(store.layout) == []
    assert scenes(store) == 6
    assert newer_rows(store, kind) == ["S4", "S6"]
    assert maintenance.check(store.layout).problems == ()


def test_an_older_version_keeps_the_views_of_a_newer_one(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        become(patch, TABLES, ONE_WORD)
        store.publish(small_result(small_key("S4")))
    with monkeypatch.context() as patch:
        become(patch, TABLES, views.VIEWS[:-1], "0.0.9")
        store.publish(small_result(small_key("S5")))
    sql = "SELECT comment FROM duckdb_views() WHERE view_name = 'latest_rivets'"
    assert "latest scan" in store.query(sql).column(0)[0].as_py()
    assert store.query("SELECT count(*) FROM panel_summary").column(0).to_pylist() == [1]


def test_a_column_of_another_type_is_refused_and_the_version_named(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = store.layout.archive.resolve()
    changed = tuple(
        replace(column, sql_type="BIGINT") if column.name == "n_inner" else column for column in TABLES[1].columns
    )
    become(monkeypatch, (SCENES, replace(TABLES[1], columns=changed), *TABLES[2:]), views.VIEWS)
    with pytest.raises(StoreError, match=r"rivets\.n_inner as INTEGER, as version 0\.1\.0 has it, expected BIGINT"):
        store.publish(small_result(small_key("S4")))
    assert store.layout.archive.resolve() == before
    assert maintenance.rebuild(store.layout) == []
    assert scenes(store) == 4


@pytest.mark.parametrize("kind", ["a column", "a table"])
def test_a_run_that_no_index_has_tables_for_is_left_out_and_named(
    store: Store, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, kind: str
) -> None:
    with monkeypatch.context() as patch:
        become(patch, *OTHER_TABLES[kind])
        patch.setattr("storage.archive.generations.publish", lambda *_: {})  # it dies before the index knows
        store.publish(small_result(small_key("S4")))
    with caplog.at_level(logging.WARNING):
        store.publish(small_result(small_key("S5")))
    assert scenes(store) == 4
    [problem] = maintenance.rebuild(store.layout)
    assert "S4" in problem
    assert ("torque_nm" if kind == "a column" else "coupons") in problem
    assert maintenance.check(store.layout).problems == (problem,)
    assert scenes(store) == 4
    become(monkeypatch, *OTHER_TABLES[kind])
    store.publish(small_result(small_key("S6")))
    assert scenes(store) == 6
    assert newer_rows(store, kind) == ["S4", "S6"]


def test_an_index_of_the_first_version_catches_up(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    forge(store, "DROP SCHEMA bookkeeping CASCADE; DELETE FROM scenes WHERE station = 'S1'; DELETE FROM rivets")
    # Rows that an index has are taken as they are; scenes that it lacks come from their bundles.
    assert scenes(store) == 3
    assert any("other rows" in problem for problem in maintenance.check(store.layout).problems)
    maintenance.rebuild(store.layout)
    assert maintenance.check(store.layout).problems == ()

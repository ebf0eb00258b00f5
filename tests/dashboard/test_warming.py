"""What is read ahead is what the first look asks, and says the same as the tables."""

from __future__ import annotations

from pathlib import Path

import pytest
import streamlit as st

from dashboard import data
from dashboard.data import NOTICED, Archive
from dashboard.findings import PERIODS, Wanted, findings
from dashboard.loading_ahead import load_ahead
from dashboard.warming import OFF_VARIABLE, read_ahead
from metrology.kinds import KINDS
from storage.archive.work import findings_sql, noticed_sql, register
from storage.review import Review
from tests.dashboard.test_pages import Open, clean


def test_the_first_review_waits_for_no_finding(filled: Path, open_page: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    fetch = data._fetch
    monkeypatch.setattr(data, "_fetch", lambda cursor, sql, given: asked.append(sql) or fetch(cursor, sql, given))
    read_ahead(Archive(filled))
    found = len(findings(Archive(filled), Wanted()))
    assert found
    asked.clear()
    page = clean(open_page("review", filled))
    assert f"{found} findings" in "\n".join(caption.value for caption in page.caption)
    # Nothing but one scan's rows, and the names and the time that the filters offer.
    narrow = ("scene_id = ?", "scene_id IN (?)", "SELECT DISTINCT", "AS newest FROM scenes")
    assert [sql for sql in asked if not any(part in sql for part in narrow)] == []
    asked.clear()
    clean(open_page("overview", filled))
    assert not any("regr_slope" in sql for sql in asked)
    for period in PERIODS:
        asked.clear()
        clean(open_page("overview", filled, since=period))
        assert not any("before_mm" in sql for sql in asked), period
    asked.clear()
    clean(open_page("panel", filled))
    assert not any("last_scan" in sql for sql in asked)


def test_findings_are_the_same_from_what_was_noticed(filled: Path) -> None:
    with Archive(filled).store.connect() as connection:
        register(connection, Review())
        connection.register(NOTICED, connection.sql(noticed_sql()).to_arrow_table())
        for kinds in (KINDS, KINDS[:1], ()):
            direct, noticed = (
                connection.sql(f"FROM ({findings_sql(kinds, noticed=source)}) ORDER BY scene_id, feature_id").fetchall()
                for source in (None, NOTICED)
            )
            assert direct == noticed
            assert bool(direct) == bool(kinds)


def test_what_the_browser_loads_ahead_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another version of Streamlit may call its files otherwise: then pages show their first chart later."""
    said: list[str] = []
    monkeypatch.setattr(st, "html", lambda text, **_options: said.append(text))
    load_ahead()
    assert "DataFrame." in said[0]
    assert "PlotlyChart." in said[0]
    monkeypatch.setenv(OFF_VARIABLE, "1")
    load_ahead()
    assert len(said) == 1

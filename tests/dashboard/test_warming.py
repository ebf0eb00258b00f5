"""What is read ahead is what the first look asks, and says the same as the tables."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse
from starlette.routing import Route

from dashboard import data
from dashboard.data import NOTICED, Archive
from dashboard.findings import PERIODS, Wanted, findings
from dashboard.first_files import FirstFiles
from dashboard.loading_ahead import script
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
    assert "DataFrame." in script()
    assert "PlotlyChart." in script()
    monkeypatch.setenv(OFF_VARIABLE, "1")
    assert script() == ""


def test_a_browser_gets_the_page_with_our_links_and_scripts() -> None:
    """A browser takes compressed answers, and into these nothing can be written."""

    async def streamlit_page(request: Request) -> HTMLResponse:
        return HTMLResponse("<html><head></head><body><div id='root'></div></body></html>" + " " * 2000)

    app = Starlette(
        routes=[Route("/sql", streamlit_page)],
        middleware=[Middleware(FirstFiles), Middleware(GZipMiddleware)],
    )
    asked = {"accept": "text/html,application/xhtml+xml", "accept-encoding": "gzip, deflate, br"}
    headers, page = _got(app, "/sql", asked)
    assert "content-encoding" not in headers
    assert int(headers["content-length"]) == len(page)
    text = page.decode()
    assert text.index("modulepreload") < text.index("<body>")
    assert text.index("id='root'") < text.index(".stMainBlockContainer") < text.index("</body>")


def _got(app: Starlette, path: str, asked: dict[str, str]) -> tuple[Headers, bytes]:
    """Headers and body of an answer."""
    sent: list[Any] = []
    scope = {
        "type": "http", "method": "GET", "path": path, "raw_path": path.encode(), "root_path": "", "query_string": b"",
        "headers": [(name.encode(), value.encode()) for name, value in asked.items()],
    }  # fmt: skip

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(app(scope, receive, send))
    return Headers(raw=sent[0]["headers"]), b"".join(message.get("body", b"") for message in sent[1:])

"""Flow runs of a Prefect server, from a stand-in that answers as Prefect 3.8 does."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from streamlit.testing.v1 import AppTest

from dashboard.flow_runs import flow_runs
from metrology.errors import StoreError

ANSWERS: dict[str, Any] = {
    "/api/flows/filter": [{"id": "f-1", "name": "inspect_scene"}],
    "/api/flow_runs/filter": [
        {
            "id": "run-2",
            "flow_id": "f-1",
            "name": "inbox/scan-7",
            "start_time": "2026-11-23T02:00:03.8Z",
            "total_run_time": 4.25,
            "state": {"name": "Failed", "message": "scan-7: found no frames,\n expected 24"},
        },
        {"id": "run-1", "flow_id": "f-1", "name": "inbox/scan-8", "start_time": None, "state": {"name": "Scheduled"}},
    ],
}


class _Prefect(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        asked = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        assert "inspect_inbox" in asked["flows"]["name"]["any_"]
        body = json.dumps(ANSWERS[self.path]).encode()
        self.send_response(200)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: Any) -> None:
        """Quiet."""


@pytest.fixture
def api() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Prefect)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/api"
    server.shutdown()
    thread.join()
    server.server_close()


def test_runs_have_their_flow_state_and_page(api: str) -> None:
    runs = flow_runs(api)
    failed, scheduled = runs.iloc[0], runs.iloc[1]
    assert (failed.flow, failed.run, failed.state) == ("inspect_scene", "inbox/scan-7", "Failed")
    assert failed.message == "scan-7: found no frames, expected 24"
    assert failed.seconds == 4.25
    assert failed.started == pd.Timestamp("2026-11-23T02:00:03.8Z")
    assert failed.page == f"{api.removesuffix('/api')}/runs/flow-run/run-2"
    assert pd.isna(scheduled.started)
    assert pd.isna(scheduled.seconds)


def test_a_server_that_does_not_answer_is_one_line() -> None:
    with pytest.raises(StoreError, match="expected the API of a Prefect server"):
        flow_runs("http://127.0.0.1:9/api")


def test_the_page_shows_them(api: str, writable: Path, open_page: Callable[..., AppTest]) -> None:
    (writable / "dashboard.toml").write_text(f'prefect_api = "{api}"\n')
    page = open_page("runs", writable, view="Flow runs")
    assert not page.exception
    assert not page.error
    assert "scan-7: found no frames" in page.dataframe[0].value.to_string()


def test_the_page_says_how_to_name_a_server(
    filled: Path, open_page: Callable[..., AppTest], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    page = open_page("runs", filled, view="Flow runs")
    assert not page.exception
    assert "prefect_api" in page.info[0].value

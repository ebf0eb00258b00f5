"""Whether a Prefect server can be used: each way in which it cannot is one clear line."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from flows.cli import main
from flows.prefect_server import configured_api, provide_home, runs_on_server, server_problem
from metrology.errors import UsageError
from tests.support.users import as_user, only_root, open_to_all


class _Server(BaseHTTPRequestHandler):
    """A Prefect server whose pages answer to any address; what is asked through it as a proxy fails."""

    def do_GET(self) -> None:
        self.send_response(502 if self.path.startswith("http") else 200)
        self.end_headers()
        self.wfile.write(b"true" if self.path == "/api/health" else b"<html>")

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def address(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    for name in ("HTTP_PROXY", "http_proxy", "NO_PROXY", "no_proxy", "ALL_PROXY", "all_proxy"):
        monkeypatch.delenv(name, raising=False)
    server = HTTPServer(("127.0.0.1", 0), _Server)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


def test_a_server_that_answers_is_used(address: str) -> None:
    assert server_problem(f"{address}/api") is None


def test_an_address_without_api_is_named(address: str) -> None:
    with pytest.raises(UsageError, match=f"found {address}, expected {address}/api"):
        server_problem(address)


def test_a_proxy_in_the_way_is_named(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", address)
    with pytest.raises(UsageError, match=f"found the proxy {address} on the way .*NO_PROXY=127.0.0.1"):
        server_problem(f"{address}/api")
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    assert server_problem(f"{address}/api") is None


def test_something_else_at_the_address_is_no_server(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = server_problem(f"{address}/other/api")
    assert problem is not None
    assert "found an answer that is not Prefect's" in problem


@pytest.mark.parametrize("api", ["127.0.0.1:4200/api", "http://[::1/api", "ftp://host/api", "http:///api"])
def test_what_is_no_address_is_said(
    api: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PREFECT_API_URL", api)
    assert not runs_on_server(False)
    assert f"found {api!r} as PREFECT_API_URL" in capsys.readouterr().err
    with pytest.raises(UsageError, match="expected an address"):
        runs_on_server(True)


def test_no_home_is_no_server(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PREFECT_API_URL", "PREFECT_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", "/nonexistent")
    assert configured_api() is None


@only_root
def test_a_home_that_cannot_be_written_gives_way(tmp_path: Path) -> None:
    open_to_all(tmp_path)

    def provide() -> None:
        os.environ |= {"HOME": str(tmp_path), "PREFECT_HOME": ""}
        provide_home()
        assert os.access(os.environ["PREFECT_HOME"], os.W_OK)

    as_user(61001, provide)


@pytest.mark.parametrize("zone", ["Europe/Atlantis", "Europe", "../etc/passwd", "/etc/passwd", "CET\n"])
def test_a_bad_time_zone_is_said(zone: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", "--inbox", "i", "--store", "s", "--timezone", zone]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: --timezone: found ")
    assert said.count("\n") == 1

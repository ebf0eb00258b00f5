"""A dashboard's server and a browser to look at it with."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from week import ROOT

from dashboard.launch import command

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def wait(condition: Callable[[], bool], seconds: float = 60) -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.1)


def free_port() -> int:
    """A port of this machine that nobody listens on."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@contextmanager
def served(root: Path, port: int | None = None) -> Iterator[str]:
    """A dashboard's server on a store, started beside it; gives its address."""
    port = port or free_port()
    environment = {**os.environ, "FLUSHLINE_STORE": str(root), "PYTHONPATH": str(ROOT)}
    log = (root.parent / "server.log").open("wb")
    process = subprocess.Popen(command(port, "127.0.0.1"), env=environment, stdout=log, stderr=log, cwd=root.parent)
    try:
        wait(lambda: process.poll() is not None or _answers(port))
        yield f"http://localhost:{port}"
    finally:
        process.terminate()
        process.wait(20)
        log.close()
    said = (root.parent / "server.log").read_text()
    assert "Traceback" not in said, said


def _answers(port: int) -> bool:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/_stcore/health", timeout=2) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False


@contextmanager
def browser() -> Iterator[Any]:
    """A headless Chromium; skips the test where there is none."""
    driver_of = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not CHROMIUM:
        pytest.skip("no chromium on this machine: Debian has it as the package chromium")
    with driver_of.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield started
        started.close()


def new_page(browser: Any, scheme: str = "light", locale: str = "en-US") -> Any:
    """A page of the size of a small laptop."""
    context = browser.new_context(
        viewport={"width": 1366, "height": 768}, color_scheme=scheme, locale=locale, timezone_id="Europe/Berlin",
        accept_downloads=True,
    )  # fmt: skip
    page = context.new_page()
    page.set_default_timeout(60_000)
    return page


def settle(page: Any) -> None:
    """Wait until the page is drawn, and see that it holds no traceback."""
    page.wait_for_selector('[data-testid="stApp"][data-test-script-state="notRunning"]')
    page.wait_for_function(
        "!document.querySelector('[data-testid=\"stSkeleton\"]') && !document.querySelector('[data-stale=\"true\"]')"
    )
    assert page.locator('[data-testid="stException"]').count() == 0
    assert page.locator("text=Traceback").count() == 0
    page.wait_for_timeout(400)

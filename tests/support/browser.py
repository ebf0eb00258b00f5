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
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest

from dashboard.confinement import die_with
from dashboard.launch import command
from dashboard.warming import OFF_VARIABLE
from storage.review import Entry, ReviewLog
from tests.support.week import ROOT

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
def served(root: Path, port: int | None = None, ahead: bool = False) -> Iterator[str]:
    """A dashboard's server on a store, started beside it; gives its address. It ends with this process, too.

    Parameters
    ----------
    ahead : bool
        Whether it reads ahead, and has browsers load ahead what no page has asked for yet.
    """
    port = port or free_port()
    environment = {**os.environ, "FLUSHLINE_STORE": str(root), "PYTHONPATH": str(ROOT)}
    environment |= {} if ahead else {OFF_VARIABLE: "1"}
    log = (root.parent / "server.log").open("wb")
    process = subprocess.Popen(
        command(port, "127.0.0.1"), env=environment, stdout=log, stderr=log, cwd=root.parent,
        preexec_fn=partial(die_with, os.getpid()),
    )  # fmt: skip
    try:
        wait(lambda: process.poll() is not None or _answers(port), 180)
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


SMALL, LARGE, TABLET = (1366, 768), (1920, 1080), (1024, 768)
"""Screens: a laptop's, a desk's, and one of a tablet, which has touch."""


def new_page(
    browser: Any, scheme: str = "light", locale: str = "en-US", apart: bool = False, size: tuple[int, int] = SMALL
) -> Any:
    """A page; it has what pages like it have loaded, unless it is `apart`: no cookies."""
    page = (_new_context if apart else _context)(browser, scheme, locale, size).new_page()
    page.set_default_timeout(60_000)
    return page


def _new_context(browser: Any, scheme: str, locale: str, size: tuple[int, int]) -> Any:
    return browser.new_context(
        viewport={"width": size[0], "height": size[1]}, has_touch=size == TABLET, color_scheme=scheme, locale=locale,
        timezone_id="Europe/Berlin", accept_downloads=True, reduced_motion="reduce",
    )  # fmt: skip


_context = cache(_new_context)


_REST = """() => document.querySelector('[data-testid="stApp"][data-test-script-state="notRunning"]')
    && !document.querySelector('[data-testid="stSkeleton"]') && !document.querySelector('[data-stale="true"]')"""


def settle(page: Any) -> None:
    """Wait until the page is drawn and stays so, and see that it holds no traceback."""
    page.wait_for_function(_REST)
    page.wait_for_timeout(150)  # what a click begins begins by then
    page.wait_for_function(_REST)
    assert page.locator('[data-testid="stException"]').count() == 0
    assert page.locator("text=Traceback").count() == 0


def row_place(page: Any, row: int, table: int = 0, row_height: int = 35, tick: bool = False) -> tuple[float, float]:
    """Where a row of a table is drawn, in pixels of the page: its first cells, or its box for ticks."""
    box = page.locator('[data-testid="stDataFrame"]').nth(table).bounding_box()
    return box["x"] + (17 if tick else 75), box["y"] + 36 + row_height * row + row_height / 2


def click_row(page: Any, row: int, **where: Any) -> None:
    """Click a row of a table, or tick it."""
    place = row_place(page, row, **where)
    page.mouse.move(*place)
    page.wait_for_timeout(100)
    page.mouse.click(*place)
    page.wait_for_timeout(150)
    settle(page)


# Where Plotly drew a point that carries a name, in pixels of the page.
_POINT = """(k) => {
    for (const plot of document.querySelectorAll('.js-plotly-plot')) {
        const trace = (plot._fullData || []).find(t => t.customdata && t.customdata.length > k);
        if (!trace) continue;
        const box = plot.getBoundingClientRect(), x = plot._fullLayout.xaxis, y = plot._fullLayout.yaxis;
        return [box.x + x._offset + x.d2p(trace.x[k]), box.y + y._offset + y.d2p(trace.y[k])];
    }
    return null;
}"""


def click_point(page: Any, k: int) -> None:
    """Click a point of a chart."""
    page.wait_for_function(_POINT, arg=k)
    place = page.evaluate(_POINT, k)
    page.mouse.move(place[0] - 3, place[1])
    page.mouse.move(*place)
    page.locator(".hoverlayer .hovertext").filter(visible=True).first.wait_for()  # Plotly clicks what it hovers over
    page.mouse.click(*place)


def choose(page: Any, disposition: str, comment: str = "", who: str = "") -> None:
    """Choose a disposition, and say why and who."""
    if who:
        page.get_by_role("textbox", name="Your name").fill(who)
        page.get_by_role("textbox", name="Your name").press("Tab")
        settle(page)
    page.get_by_role("button", name=disposition).or_(page.get_by_role("radio", name=disposition)).first.click()
    page.get_by_role("button", name=f"Record {disposition}").wait_for()
    settle(page)
    if comment:
        page.get_by_label("Comment").fill(comment)  # a combobox once it offers earlier ones


def record(page: Any, button: str, said: str = "Recorded") -> None:
    """Click the button of this name, and wait for what the page says then."""
    page.get_by_role("button", name=button).click()
    page.get_by_text(said).filter(visible=True).first.wait_for()
    settle(page)


def entries_of(root: Path, begins: str) -> list[Entry]:
    """What the log has about scenes whose name begins so."""
    return [entry for entry in ReviewLog(root).read().entries if entry.scene_id.startswith(begins)]

"""Time the dashboard's pages on a store, as a person's browser sees them.

    python benchmarks/make_large_store.py STORE
    python benchmarks/bench_dashboard.py STORE

Starts a server, and when it has read ahead (`dashboard/warming.py`) opens the SQL page in headless Chromium, then, when
the browser has loaded ahead, too (`dashboard/loading_ahead.py`), every other one through the menu. With --cold neither
does: nothing of the store is in the server's caches, and no program of a table or chart in the browser's. First
content: a number, table or figure of the page is visible; complete: the page is at rest. Then changes a filter of the
pages that have one, from the click on its value until the page is at rest again. The SQL page's own figures are those
of loading the whole application by its address. Needs chromium and the extra `test`.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.support.browser import browser, new_page, served

START = "SQL"
PAGES = ("Overview", "Archive", "Panel", "Scan", "Tolerance review", "Trends", "Runs and rigs")
# What is changed on a page that is at rest: a field, its new value, and what the address then names.
CHANGED = {
    "Overview": ("New since", "New since last 7 days", "since"),
    "Archive": ("Scanned", "last 7 days", "period"),
    "Tolerance review": ("Scanned", "last 7 days", "period"),
    "Trends": ("Scanned", "last 30 days", "period"),
}
WORK = "Where work waits"
FIRST = ", ".join(
    f'[data-testid="{name}"]'
    for name in ("stMetricValue", "stDataFrame", "stPlotlyChart", "stImage", "stAlert", "stCode", "stTextArea")
)
SHOWN = """([title, selector]) => document.querySelector('h5')?.innerText.endsWith(title)
    && [...document.querySelectorAll(selector)].some(e => e.offsetParent && !e.closest('[data-stale="true"]'))"""
REST = """() => document.querySelector('[data-testid="stApp"][data-test-script-state="notRunning"]')
    && !document.querySelector('[data-testid="stSkeleton"]') && !document.querySelector('[data-stale="true"]')"""


Clock = Callable[[], float]


def processor_seconds() -> float:
    """What server and browser took of all processors so far."""
    total = 0.0
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):
            total += sum(process.cpu_times()[:2])
    return total


def wait_for_rest() -> None:
    """Wait until server and browser do nothing."""
    before, after = -1.0, processor_seconds()
    while after - before > 0.1:
        time.sleep(2)
        before, after = after, processor_seconds()


def main() -> None:
    """Time every page and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("--rounds", type=int, default=3, help="servers started, each with cold caches")
    parser.add_argument("--cpu", action="store_true", help="seconds of processors, for machines that others use")
    parser.add_argument("--cold", action="store_true", help="do not let the server read ahead")
    arguments = parser.parse_args()
    now = processor_seconds if arguments.cpu else time.perf_counter
    names = (START, *PAGES[:1], WORK, *PAGES[1:])
    figures: dict[str, list[tuple[float, float, float | None]]] = {name: [] for name in names}
    with browser() as chromium:
        for _ in range(arguments.rounds):
            with served(arguments.store.resolve(), ahead=not arguments.cold) as address:
                wait_for_rest()
                for name in PAGES:
                    page = new_page(chromium, apart=True)
                    loading = time_loading(page, address, now)
                    page.wait_for_timeout(3000)
                    wait_for_rest()
                    figures[name].append(time_page(page, name, now))
                    if name == PAGES[0]:
                        figures[WORK].append(time_work(page, now))
                    page.context.close()
                figures[START].append(loading)
    kind = "s of processors" if arguments.cpu else "s"
    print(f"{'page':18s} first content   complete   another filter   ({kind}, median of {arguments.rounds})")
    for name, rows in figures.items():
        first, complete = (_median([row[i] for row in rows]) for i in (0, 1))
        changed = [row[2] for row in rows if row[2] is not None]
        print(f"{name:18s} {first:13.2f} {complete:10.2f}   {f'{_median(changed):14.2f}' if changed else '':>14s}")


def time_loading(page: Any, address: str, now: Clock) -> tuple[float, float, None]:
    """Seconds to the first content and to rest of the page that asks nothing of the store."""
    start = now()
    page.goto(f"{address}/sql", wait_until="commit")
    page.wait_for_function(SHOWN, arg=[START, FIRST])
    first = now() - start
    page.wait_for_function(REST)
    return first, now() - start, None


def time_page(page: Any, name: str, now: Clock) -> tuple[float, float, float | None]:
    """Seconds to the first content and to rest, and to rest after a change of the period where the page has one."""
    start = now()
    page.get_by_role("link", name=name).click()
    page.wait_for_function(SHOWN, arg=[name, FIRST])
    first = now() - start
    page.wait_for_function(REST)
    complete = now() - start
    changed = None
    if name in CHANGED:
        field, value, named = CHANGED[name]
        page.get_by_role("combobox", name=field).click()
        option = page.get_by_role("option", name=value)
        option.wait_for()
        start = now()
        option.click()
        page.wait_for_function("(named) => location.search.includes(named)", arg=named)
        page.wait_for_function(REST)
        changed = now() - start
    return first, complete, changed


def time_work(page: Any, now: Clock) -> tuple[float, float, None]:
    """Seconds to the first content and to rest of the overview's other view."""
    start = now()
    page.get_by_text(WORK).first.click()
    page.get_by_text("Waiting for a person").first.wait_for()
    first = now() - start
    page.wait_for_function(REST)
    return first, now() - start, None


def _median(values: list[float]) -> float:
    return sorted(values)[len(values) // 2]


if __name__ == "__main__":
    main()

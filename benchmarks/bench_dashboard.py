"""Time the dashboard's pages on a store, as a person's browser sees them.

    python benchmarks/make_large_store.py STORE
    python benchmarks/bench_dashboard.py STORE

Starts a server and opens the SQL page in headless Chromium, then every other one through the menu; nothing of the store
is in the server's caches. First content: a number, table or figure of the page is visible; complete: the page is at
rest. Then changes the period on the pages that have one (until the page is at rest again). The SQL page's own figures
are those of loading the whole application by its address. Needs chromium and the extra `test`.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.support.browser import browser, new_page, served

START = "SQL"
PAGES = ("Overview", "Archive", "Scan", "Tolerance review", "Trends", "Runs and rigs")
FILTERED = ("Overview", "Archive", "Tolerance review")
FIRST = ", ".join(
    f'[data-testid="{name}"]'
    for name in ("stMetricValue", "stDataFrame", "stPlotlyChart", "stImage", "stAlert", "stCode", "stTextArea")
)
SHOWN = """([title, selector]) => document.querySelector('h5')?.innerText.endsWith(title)
    && [...document.querySelectorAll(selector)].some(e => e.offsetParent && !e.closest('[data-stale="true"]'))"""
REST = """() => document.querySelector('[data-testid="stApp"][data-test-script-state="notRunning"]')
    && !document.querySelector('[data-testid="stSkeleton"]') && !document.querySelector('[data-stale="true"]')"""


def main() -> None:
    """Time every page and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("--rounds", type=int, default=3, help="servers started, each with cold caches")
    arguments = parser.parse_args()
    figures: dict[str, list[tuple[float, float, float | None]]] = {name: [] for name in (START, *PAGES)}
    with browser() as chromium:
        for _ in range(arguments.rounds):
            with served(arguments.store.resolve()) as address:
                for name in PAGES:
                    page = new_page(chromium)
                    loading = time_loading(page, address)
                    figures[name].append(time_page(page, name))
                    page.context.close()
                figures[START].append(loading)
    print(f"{'page':18s} first content   complete   another period   (s, median of {arguments.rounds})")
    for name, rows in figures.items():
        first, complete = (_median([row[i] for row in rows]) for i in (0, 1))
        changed = [row[2] for row in rows if row[2] is not None]
        print(f"{name:18s} {first:13.2f} {complete:10.2f}   {f'{_median(changed):14.2f}' if changed else '':>14s}")


def time_loading(page: Any, address: str) -> tuple[float, float, None]:
    """Seconds to the first content and to rest of the page that asks nothing of the store."""
    start = time.perf_counter()
    page.goto(f"{address}/sql", wait_until="commit")
    page.wait_for_function(SHOWN, arg=[START, FIRST])
    first = time.perf_counter() - start
    page.wait_for_function(REST)
    return first, time.perf_counter() - start, None


def time_page(page: Any, name: str) -> tuple[float, float, float | None]:
    """Seconds to the first content and to rest, and to rest after a change of the period where the page has one."""
    start = time.perf_counter()
    page.get_by_role("link", name=name).click()
    page.wait_for_function(SHOWN, arg=[name, FIRST])
    first = time.perf_counter() - start
    page.wait_for_function(REST)
    complete = time.perf_counter() - start
    changed = None
    if name in FILTERED:
        start = time.perf_counter()
        page.get_by_role("combobox", name="Scanned").click()
        page.get_by_role("option", name="last 7 days").click()
        page.wait_for_function("() => location.search.includes('period')")
        page.wait_for_function(REST)
        changed = time.perf_counter() - start
    return first, complete, changed


def _median(values: list[float]) -> float:
    return sorted(values)[len(values) // 2]


if __name__ == "__main__":
    main()

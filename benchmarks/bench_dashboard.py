"""Time the dashboard's pages on a store, as a person's browser sees them.

    python benchmarks/make_large_store.py STORE
    python benchmarks/bench_dashboard.py STORE

Starts a server, then opens every page in headless Chromium with the server's caches cold (first content: the first
number, table or figure is visible; complete: the page is at rest), and changes a filter on the pages that have one
(until the page is at rest again). Needs chromium and the extra `test`.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "dashboard"))

from browser import browser, new_page, served

PAGES = {
    "Overview": "/",
    "Archive": "/archive",
    "Scene": "/scene",
    "Tolerance review": "/review",
    "Trends": "/trends",
    "Runs and rigs": "/runs",
    "SQL": "/sql",
}
FILTERS = {"Overview": "period=last+7+days", "Archive": "period=last+7+days", "Tolerance review": "period=last+7+days"}
FIRST = ", ".join(
    f'[data-testid="{name}"]'
    for name in ("stMetricValue", "stDataFrame", "stPlotlyChart", "stImage", "stAlert", "stCode", "stTextArea")
)
REST = """() => document.querySelector('[data-testid="stApp"][data-test-script-state="notRunning"]')
    && !document.querySelector('[data-testid="stSkeleton"]') && !document.querySelector('[data-stale="true"]')"""


def main() -> None:
    """Time every page and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("--rounds", type=int, default=3, help="servers started, each with cold caches")
    arguments = parser.parse_args()
    figures: dict[str, list[tuple[float, float, float | None]]] = {name: [] for name in PAGES}
    with browser() as chromium:
        for _ in range(arguments.rounds):
            with served(arguments.store.resolve()) as address:
                _warm_up(chromium, address)
                for name in PAGES:
                    figures[name].append(time_page(chromium, address, name))
    print(f"{'page':18s} first content   complete   another period   (s, median of {arguments.rounds})")
    for name, rows in figures.items():
        first, complete = (_median([row[i] for row in rows]) for i in (0, 1))
        changed = [row[2] for row in rows if row[2] is not None]
        print(f"{name:18s} {first:13.2f} {complete:10.2f}   {f'{_median(changed):14.2f}' if changed else '':>14s}")


def time_page(chromium: Any, address: str, name: str) -> tuple[float, float, float | None]:
    """Seconds to the first content and to rest, and to rest after a change of the period where the page has one."""
    page = new_page(chromium)
    start = time.perf_counter()
    page.goto(address + PAGES[name], wait_until="commit")
    page.wait_for_selector(FIRST, state="visible")
    first = time.perf_counter() - start
    page.wait_for_function(REST)
    complete = time.perf_counter() - start
    changed = None
    if name in FILTERS:
        start = time.perf_counter()
        page.get_by_role("combobox", name="Scanned").click()
        page.get_by_role("option", name="last 7 days").click()
        page.wait_for_function("() => location.search.includes('period')")
        page.wait_for_function(REST)
        changed = time.perf_counter() - start
    page.context.close()
    return first, complete, changed


def _warm_up(chromium: Any, address: str) -> None:
    """Let the server import what it needs once, on the page that asks least of the store."""
    page = new_page(chromium)
    page.goto(address + PAGES["SQL"])
    page.wait_for_function(REST)
    page.context.close()


def _median(values: list[float]) -> float:
    return sorted(values)[len(values) // 2]


if __name__ == "__main__":
    main()

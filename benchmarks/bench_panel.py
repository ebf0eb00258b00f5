"""What an assembled panel costs: twelve stations put together, and its page beside a fleet's rows.

    python benchmarks/bench_panel.py [--rivets 10000000]

Twelve simulated stations (3 × 4, each off by up to 15 mm and 5°) are stored and put together twice: the second assembly
goes on from the first. Then the index is filled with rows of 200 aircraft × 60 panels × 8 stations, all alike, and the
data of the panel's page is fetched, and a scene published. CPU seconds.
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import cv2
import duckdb
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from dashboard.data import Archive
from dashboard.panels import load_panel, stitched_pictures
from metrology.assembly.assemble import assembled
from metrology.assembly.picture import stitched
from metrology.results import PanelKey
from storage.archive import Store, generations
from storage.archive.files import locked
from storage.archive.panel_bundle import panel_document
from storage.archive.panel_changes import with_changes
from storage.archive.schema import PANEL_TABLES, PANELS
from storage.panel_picture import encoded
from tasks.panel import assemble
from tests.support.panel_scans import SIZE, SimulatedPanel, facing
from tests.support.panel_store import result_of

Made = TypeVar("Made")
KEY = PanelKey("MSN-1", "P")
AIRCRAFT, PANELS_EACH, STATIONS = 200, 60, 8


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rivets", type=int, default=10_000_000)
    options = parser.parse_args()
    logging.disable(logging.WARNING)  # Streamlit's, which misses a page to draw on
    rng = np.random.default_rng(1)
    panel = SimulatedPanel.made(rng, 17, (-210.0, -160.0, -110.0, -60.0, 60.0, 110.0, 160.0, 210.0))
    stands = [facing(x, y, rng) for y in (-150.0, 0.0, 150.0) for x in (-300.0, -100.0, 100.0, 300.0)]
    scans = [panel.seen(true, f"S{k:02d}", rng, expected=near) for k, (true, near) in enumerate(stands, 1)]
    grain = cv2.GaussianBlur(rng.integers(60, 200, SIZE[::-1], dtype=np.uint8), (0, 0), 1.5)
    assembly = assembled(scans)
    pictures = timed("stitched pictures", lambda: stitched(assembly, dict.fromkeys(range(len(scans)), grain)))
    timed("pictures as files", lambda: encoded(pictures))
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder) / "store")
        for scan in scans:
            store.publish(replace(result_of(scan), preview=grain))
        for _ in range(2):
            result = timed("assemble from the store", lambda: assemble(store, KEY))
            timed("compare and store", lambda: store.publish_panel(with_changes(store, panel_document(result))))  # noqa: B023
        with locked(store.layout.lock):
            generations.change(store.layout, lambda index: fill(index, options.rivets))
        archive = Archive(store.root)
        archive.rows("SELECT 1")
        view = timed("page's data", lambda: load_panel(archive, KEY.aircraft_serial, KEY.panel))
        timed("page's pictures", lambda: stitched_pictures(archive, view))  # type: ignore[arg-type]
        again = result_of(replace(scans[0], key=replace(scans[0].key, station="S99")))
        timed("publish a scene", lambda: store.publish(again))


def timed(name: str, work: Callable[[], Made]) -> Made:
    """Do something and say what it took."""
    start = time.process_time()
    made = work()
    print(f"{name:24s} {time.process_time() - start:6.2f} s", flush=True)
    return made


def fill(index: duckdb.DuckDBPyConnection, rivets: int) -> None:
    """Rows of a fleet, in the order of time: those of the one panel that is there, over and over."""
    n = AIRCRAFT * PANELS_EACH * STATIONS
    index.execute(
        "CREATE TEMP TABLE scene_keys AS SELECT *, concat_ws('~', aircraft_serial, panel, station) AS scene_id FROM ("
        f"SELECT 'MSN-' || (1000 + i // {PANELS_EACH * STATIONS}) AS aircraft_serial, 'P' || (i // {STATIONS} % "
        f"{PANELS_EACH}) AS panel, 'S' || (i % {STATIONS}) AS station, TIMESTAMPTZ '2026-01-01' + INTERVAL 1 MINUTE * "
        f"(i * 7919 % {n}) AS captured_at FROM range({n}) t(i)) ORDER BY captured_at"
    )
    index.execute(
        "CREATE TEMP TABLE panel_keys AS SELECT aircraft_serial, panel, NULL::VARCHAR AS station, max(captured_at) AS "
        "captured_at, aircraft_serial || '~' || panel AS scene_id FROM scene_keys GROUP BY ALL ORDER BY captured_at"
    )
    for table, keys, each in (("scenes", "scene_keys", 1), ("rivets", "scene_keys", rivets // n)):
        _repeat(index, table, keys, each)
    for table in PANEL_TABLES:
        _repeat(index, table.name, "panel_keys", 1 if table is PANELS else 10_000)


def _repeat(index: duckdb.DuckDBPyConnection, table: str, keys: str, most: int) -> None:
    """For each key up to so many of the rows that a table has, as often as it takes."""
    named = "aircraft_serial, panel, station, captured_at, scene_id"
    index.execute(
        f"CREATE OR REPLACE TEMP TABLE pattern AS SELECT r.* EXCLUDE ({named}) FROM {table} r, range(10) "
        f"WHERE r.aircraft_serial = 'MSN-1' LIMIT {min(most, 400)}"
    )
    index.execute(f"INSERT INTO {table} BY NAME SELECT * FROM {keys}, pattern")
    [(count,)] = index.execute(f"SELECT count(*) FROM {table}").fetchall()
    print(f"{table:24s} {count:10d} rows", flush=True)


if __name__ == "__main__":
    main()

"""How the archive bears 10 million rivets of 200 000 scenes: queries as the dashboard asks them, and storing a scene.

    python benchmarks/bench_archive.py [--scenes 200000] [--rivets 50] [--keep DIR]

The index is filled by SQL from one real result; what is timed goes the usual way (`Store.query`, `Store.publish`).
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from storage.archive import Store, index, snapshot
from storage.archive.files import locked
from tests.storage.results import small_key, small_result

AIRCRAFT, PANELS = 200, 50

QUERIES = {
    "rivets of one panel": "SELECT * FROM rivets WHERE aircraft_serial = 'MSN-0100' AND panel = 'P25'",
    "one rivet over all aircraft": "SELECT aircraft_serial, avg(height_mean_mm) FROM rivets "
    "WHERE panel = 'P25' AND rivet_id = 'R7' GROUP BY ALL ORDER BY ALL",
    "trend over all": "SELECT date_trunc('month', captured_at) AS month, panel, avg(height_mean_mm), "
    "stddev(height_mean_mm), quantile_cont(height_mean_mm, 0.95), count(*) FROM rivets GROUP BY ALL ORDER BY ALL",
    "summary of all panels": "SELECT * FROM panel_summary",
    "worst 100 rivets": "SELECT * FROM worst_rivets LIMIT 100",
}


def fill(store: Store, scenes: int, rivets: int) -> None:
    """Rows of many scenes, as if they had been inspected."""
    store.publish(small_result(small_key("S000"), rivets=1))
    per_aircraft, per_panel = max(1, scenes // AIRCRAFT), max(1, scenes // AIRCRAFT // PANELS)
    key = (
        f"printf('MSN-%04d', k // {per_aircraft}) AS aircraft_serial, "
        f"printf('P%02d', k % {per_aircraft} // {per_panel}) AS panel, printf('S%03d', k % {per_panel}) AS station, "
        "TIMESTAMPTZ '2024-01-01 00:00:00+00' + INTERVAL (5 * k) MINUTE AS captured_at, "
        "printf('%s~%s~%s~%d', aircraft_serial, panel, station, k) AS scene_id"
    )
    names = "aircraft_serial, panel, station, captured_at, scene_id"
    with locked(store.layout.lock):
        with index.writing(store.layout) as connection:
            connection.execute(
                f"INSERT INTO scenes BY NAME SELECT key.*, s.* EXCLUDE ({names}) "
                f"FROM (SELECT {key} FROM range({scenes}) t(k)) key, (SELECT * FROM scenes LIMIT 1) s"
            )
            connection.execute(
                f"INSERT INTO rivets BY NAME SELECT key.*, r.* EXCLUDE ({names}) REPLACE ("
                "printf('R%d', n) AS rivet_id, (hash(k, n) % 2000)::DOUBLE / 10000 - 0.1 AS height_mean_mm, "
                "r.u_px + n AS u_px, CASE WHEN hash(k, n) % 100 = 0 THEN 'fail' ELSE 'pass' END AS decision) "
                f"FROM (SELECT k, {key} FROM range({scenes}) t(k)) numbered, range({rivets}) m(n), "
                "(SELECT * FROM rivets LIMIT 1) r, LATERAL (SELECT numbered.* EXCLUDE (k)) key "
                "ORDER BY key.captured_at"
            )
        snapshot.publish(store.layout)


def timed(work: Callable[[], object], repeats: int = 5) -> str:
    """Median and best wall time, and the median CPU time of all threads, which a busy machine disturbs less."""
    wall, cpu = [], []
    for _ in range(repeats):
        start, start_cpu = time.perf_counter(), time.process_time()
        work()
        wall.append(1000 * (time.perf_counter() - start))
        cpu.append(1000 * (time.process_time() - start_cpu))
    return f"median {statistics.median(wall):6.0f} ms   best {min(wall):6.0f} ms   CPU {statistics.median(cpu):6.0f} ms"


def main() -> None:
    """Fill, time, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=200_000)
    parser.add_argument("--rivets", type=int, default=50, help="per scene")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="use or leave the store there")
    options = parser.parse_args()
    root = options.keep or Path(tempfile.mkdtemp(prefix="flushline-bench-"))
    store = Store(root / "store")
    if not store.layout.archive.exists():
        print(f"filling: {timed(lambda: fill(store, options.scenes, options.rivets), 1)}")
    count = store.query("SELECT (SELECT count(*) FROM scenes) AS s, (SELECT count(*) FROM rivets) AS r").to_pylist()[0]
    size = os.stat(store.layout.archive).st_size / 1e6
    print(f"{count['s']} scenes, {count['r']} rivets, index {size:.0f} MB, {os.cpu_count()} cores")
    for name, sql in QUERIES.items():
        print(f"{name:32s} {timed(partial(store.query, sql))}")
    print(f"{'storing one scene':32s} {timed(lambda: store.publish(small_result(small_key('S999'))))}")
    if not options.keep:
        shutil.rmtree(root)


if __name__ == "__main__":
    main()

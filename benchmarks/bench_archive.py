"""How the archive bears 10 million rivets of 200 000 scenes: queries as the dashboard asks them, and storing a scene.

    python benchmarks/make_large_store.py STORE --panels 100 --stations 10 --rivets 50
    python benchmarks/bench_archive.py STORE

What is timed goes the usual way (`Store.query`, `Store.publish`); publishing leaves a few scenes more in the store.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from storage.archive import Store
from tests.support.results import small_key, small_result

QUERIES = {
    "rivets of one panel": "SELECT * FROM rivets WHERE aircraft_serial = 'MSN-0100' AND panel = 'LH-F13'",
    "rivets of one scene": "SELECT * FROM rivets WHERE scene_id = (SELECT max(scene_id) FROM scenes)",
    "one rivet over all aircraft": "SELECT aircraft_serial, avg(height_mean_mm) FROM rivets "
    "WHERE panel = 'LH-F13' AND rivet_id = 'R07' GROUP BY ALL ORDER BY ALL",
    "trend over all": "SELECT date_trunc('month', captured_at) AS month, panel, avg(height_mean_mm), "
    "stddev(height_mean_mm), quantile_cont(height_mean_mm, 0.95), count(*) FROM rivets GROUP BY ALL ORDER BY ALL",
    "summary of one panel": "SELECT * FROM panel_summary WHERE aircraft_serial = 'MSN-0100' AND panel = 'LH-F13'",
    "summary of all panels": "SELECT * FROM panel_summary",
    "worst 100 rivets": "SELECT * FROM worst_rivets LIMIT 100",
}


def timed(work: Callable[[], object], repeats: int = 7) -> str:
    """Median and best wall time, and the median CPU time of all threads, which a busy machine disturbs less."""
    wall, cpu = [], []
    for _ in range(repeats):
        start, start_cpu = time.perf_counter(), time.process_time()
        work()
        wall.append(1000 * (time.perf_counter() - start))
        cpu.append(1000 * (time.process_time() - start_cpu))
    return f"median {statistics.median(wall):6.0f} ms   best {min(wall):6.0f} ms   CPU {statistics.median(cpu):6.0f} ms"


def main() -> None:
    """Time and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store", type=Path)
    store = Store(parser.parse_args().store)
    counted = ", ".join(f"(SELECT count(*) FROM {name}) AS {name}" for name in ("scenes", "rivets", "seam_stations"))
    count = store.query(f"SELECT {counted}").to_pylist()[0]
    size = os.stat(store.layout.archive).st_size / 1e6
    print(", ".join(f"{rows} {name}" for name, rows in count.items()), f"index {size:.0f} MB, {os.cpu_count()} cores")
    for name, sql in QUERIES.items():
        print(f"{name:32s} {timed(partial(store.query, sql))}")
    stations = iter(f"T{time.time_ns()}-{k}" for k in range(99))
    new = lambda: store.publish(small_result(small_key(next(stations))))  # noqa: E731
    print(f"{'storing a new scene':32s} {timed(new)}")
    again = partial(store.publish, small_result(small_key("AGAIN")))
    print(f"{'storing a scene again':32s} {timed(again)}")


if __name__ == "__main__":
    main()

"""Does a long review log slow anything down? Publishing, deciding and reading with many entries, beside a short log.

    python benchmarks/bench_reviews.py --entries 200000

Each figure is the median of some rounds in one process, and the ratio is to the same with a log of ten entries.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from metrology.results import SceneKey
from storage import review_keeping
from storage.archive import Store
from storage.archive.decisions import dispose, shown_finding, sign_off
from storage.archive.work import reviewed_features
from storage.review import Feature, ReviewLog, ShownFinding, ShownScene
from tests.support.results import small_key, small_result

ROUNDS = 7
_BATCH = 5000
_PER_SCENE = 40
Figures = dict[str, float]


def fill(store: Store, entries: int) -> None:
    """Dispositions of many scenes, as a year of reviews leaves them."""
    log = ReviewLog(store.root)
    values = {"decision": "fail", "value_mm": 0.061, "u95_mm": 0.008, "panel_spec": "LH-F12 B", "reason": "proud"}
    for start in range(0, entries, _BATCH):
        shown = [
            ShownFinding(
                f"MSN-{n // 4000}~P~S~{n // _PER_SCENE}", "run", Feature("rivet", f"R{n % _PER_SCENE}"), values
            )
            for n in range(start, min(start + _BATCH, entries))
        ]
        log.dispose("m.weber", shown, "rework" if start // _BATCH % 10 == 0 else "use as is", "as agreed")


def measure(folder: Path, entries: int) -> Figures:
    """Seconds of what people and inspections do."""
    store = Store(folder / f"store-{entries}")
    store.publish(small_result())
    fill(store, entries)
    log, figures = ReviewLog(store.root), Figures()
    keys = [small_key(f"S{number}") for number in range(10, 10 + ROUNDS)]
    runs: list[str] = []
    figures["publish a new scene"] = _median(
        [lambda k=key: runs.append(store.publish(small_result(k))) for key in keys]
    )
    figures["publish a scene again"] = _median([lambda: store.publish(small_result())] * ROUNDS)
    features = [Feature("seam station", f"M1@{s}") for s in ("0.0", "2.0")]

    def decide(key: SceneKey) -> None:
        connection = store.connect()
        shown = [shown_finding(connection, log.of_scenes([key.scene_id]), key.scene_id, f) for f in features]
        connection.close()
        dispose(store.root, "k.ito", [found for found in shown if found], "use as is")

    figures["dispose"] = _median([lambda k=key: decide(k) for key in keys])

    def sign(key: SceneKey, run: str) -> None:
        shown = ShownScene(key.scene_id, run, {}, log.of_scenes([key.scene_id]).last_of_scene(key.scene_id))
        sign_off(store.root, "k.ito", shown)

    figures["sign off"] = _median([lambda k=key, r=run: sign(k, r) for key, run in zip(keys, runs, strict=True)])
    figures["read all, first time"] = _median([lambda: (review_keeping._read_before.clear(), log.read())] * 3)
    dispose_more = [ShownFinding(f"more~P~S~{n}", "run", features[0]) for n in range(ROUNDS)]
    reading = []
    for shown in dispose_more:
        log.dispose("m.weber", [shown], "use as is")
        reading.append(_median([log.read]))
    figures["read what is new"] = median(reading)
    connection, review = store.connect(), log.read()
    figures["rows for the pages"] = _median([lambda: reviewed_features(connection, review)] * 3)
    connection.close()
    return figures


def _median(works: list[Callable[[], object]]) -> float:
    seconds = []
    for work in works:
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return median(seconds)


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--entries", type=int, default=200_000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        few, many = (measure(Path(folder), entries) for entries in (10, options.entries))
    print(f"{'':24s} {'10 entries':>12s} {f'{options.entries} entries':>16s}   ratio")
    for name, seconds in many.items():
        print(f"{name:24s} {few[name]:10.3f} s {seconds:14.3f} s {seconds / few[name]:7.1f}")


if __name__ == "__main__":
    main()

"""Writers of an archive that are killed at random while a reader checks every answer.

Every run of a scene gives all its rivets one height and a count that goes with it, so a reader can tell a mixture of
two runs, half a run or the same run twice from a whole one.
"""

from __future__ import annotations

import multiprocessing
import random
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime
from multiprocessing.context import ForkServerProcess
from pathlib import Path

from metrology.errors import StoreError
from storage.archive import Store, generations, maintenance, run_ids
from storage.archive.compaction import compact
from tests.support.results import small_key, small_result

SCENES = 12
_UPKEEP = 0.05  # share of turns that begin with pruning, compacting or making the index again
MAX_RIVETS = 9
_CONSISTENT = """
SELECT s.scene_id FROM scenes s
LEFT JOIN (SELECT scene_id, count(*) AS n, count(DISTINCT height_mean_mm) AS heights,
           round(max(height_mean_mm) * 1000) AS millis, count(DISTINCT rivet_id) AS ids
           FROM rivets GROUP BY scene_id) r USING (scene_id)
LEFT JOIN (SELECT scene_id, count(*) AS n FROM seam_stations GROUP BY scene_id) t USING (scene_id)
WHERE r.n IS DISTINCT FROM s.n_rivets OR r.heights <> 1 OR r.ids <> r.n OR t.n IS DISTINCT FROM s.n_stations
   OR (r.millis % 9) + 1 <> r.n
UNION ALL SELECT 'twice: ' || scene_id FROM scenes GROUP BY scene_id HAVING count(*) > 1
UNION ALL SELECT 'orphans: ' || scene_id FROM rivets ANTI JOIN scenes USING (scene_id)
"""


@dataclass
class Tally:
    """What happened."""

    reads: int = 0
    kills: int = 0
    full: int = 0
    runs: int = 0
    wrong: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        return (
            f"{self.runs} runs stored, {self.kills} kills, {self.reads} reads, {self.full} times no room, "
            f"{len(self.wrong)} wrong"
        )


def write_forever(root: str, seed: int, full: multiprocessing.sharedctypes.Synchronized[int]) -> None:  # type: ignore[name-defined]
    """Publish random runs of random scenes until killed; some turns prune, compact or rebuild, at another time."""
    rng = random.Random(seed)
    store = Store(Path(root))
    if seed % 2:  # half of the writers publish as into a large archive
        generations.WORTHWHILE_BYTES = 0
    while True:
        millis = rng.randrange(1, 1000)
        key = small_key(f"S{rng.randrange(SCENES):02d}", f"MSN-{rng.randrange(3)}")
        try:
            if rng.random() < _UPKEEP:
                _let_the_clock_jump(rng)
                rng.choice((maintenance.prune, maintenance.rebuild, compact))(store.layout)
            store.publish(small_result(key, height_mm=millis / 1000, rivets=millis % MAX_RIVETS + 1))
        except StoreError as problem:
            if "full" not in str(problem) and "space" not in str(problem):
                raise
            full.value += 1
            time.sleep(0.05)


def _let_the_clock_jump(rng: random.Random) -> None:
    """Let run ids be given at another time from now on."""
    moment = datetime(rng.randrange(1980, 2080), 1, 1, tzinfo=UTC)

    class Clock(datetime):
        """Says another time."""

        @classmethod
        def now(cls, tz: object = None) -> datetime:  # type: ignore[override]
            return moment

    run_ids.datetime = Clock  # type: ignore[misc]


def torment(
    store: Store, seconds: float, writers: int = 3, seed: int = 1, least_reads: int = 0, least_kills: int = 0
) -> Tally:
    """Kill writers at random for a while, reading all the time.

    Parameters
    ----------
    least_reads, least_kills : int
        Go on beyond `seconds`, however slow the machine, until there were that many.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.support.killing"])
    full = context.Value("i", 0)
    rng = random.Random(seed)
    tally = Tally()
    store.publish(small_result(small_key("S00"), height_mm=0.009, rivets=1))

    def start() -> ForkServerProcess:
        process = context.Process(target=write_forever, args=(str(store.root), rng.randrange(2**31), full), daemon=True)
        process.start()
        return process

    alive = [start() for _ in range(writers)]
    end = time.monotonic() + seconds
    next_kill = time.monotonic() + 1.0
    while time.monotonic() < end or tally.reads < least_reads or tally.kills < least_kills:
        _read(store, tally)
        if time.monotonic() >= next_kill:
            victim = rng.randrange(writers)
            alive[victim].kill()
            alive[victim].join()
            tally.kills += 1
            alive[victim] = start()
            next_kill = time.monotonic() + rng.uniform(0.05, 1.5)
    for process in alive:
        process.kill()
        process.join()
    tally.full = full.value
    return tally


def settle(store: Store, tally: Tally) -> Tally:
    """Recover, then say where index and bundles differ."""
    store.recover()
    _read(store, tally)
    found = maintenance.check(store.layout)
    tally.runs = found.runs
    tally.wrong += found.problems
    tally.wrong += [f"left behind: {path.name}" for path in store.layout.staging.iterdir()]
    return tally


def damage(store: Store, tally: Tally, seed: int = 2) -> None:
    """Spoil one file of a current run: the check must name it, and a rebuild must fall back to the run before."""
    rng = random.Random(seed)
    store.publish(small_result(small_key("S00"), height_mm=0.018, rivets=1))
    store.publish(small_result(small_key("S00"), height_mm=0.027, rivets=1))
    scenes = [scene for scene in sorted(store.layout.bundles.glob("*/*/*")) if len(list(scene.iterdir())) > 1]
    run = max(rng.choice(scenes).iterdir())
    path = run / "rivets.parquet"
    path.chmod(0o644)
    data = bytearray(path.read_bytes())
    data[rng.randrange(len(data))] ^= 0xFF
    path.write_bytes(data)
    if not any(str(path) in problem for problem in maintenance.check(store.layout).problems):
        tally.wrong.append(f"the check did not name {path}")
    if not any(str(path) in problem for problem in maintenance.rebuild(store.layout)):
        tally.wrong.append(f"the rebuild did not name {path}")
    _read(store, tally)
    shown = store.query("SELECT run_id FROM scenes WHERE scene_id = ?", [run.parent.name]).column(0).to_pylist()
    if not shown or shown[0] >= run.name:
        tally.wrong.append(f"the rebuild shows {shown} for {run.parent.name}, expected the run before {run.name}")


def _read(store: Store, tally: Tally) -> None:
    tally.wrong += store.query(_CONSISTENT).column(0).to_pylist()
    tally.reads += 1

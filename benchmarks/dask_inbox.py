"""An inbox on a Dask cluster of separate processes, one of them killed in the middle, the bundles on S3.

    python benchmarks/dask_inbox.py SCENE --rig RIG [--scenes 4]       (needs flushline[dask] and moto[server])

Copies a scene under several station names, inspects them as the flow `inspect_inbox` on a local Dask cluster, kills a
worker with SIGKILL as soon as the first scene is stored, and checks that every scene is stored once and the archive is
sound. The bundles go to an S3 emulator on the loopback. Exit code 1 where anything was wrong.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path

from distributed import LocalCluster
from prefect.testing.utilities import prefect_test_harness

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from flows.inbox_job import InboxJob, Outcome, Way
from flows.prefect_inbox import run_on_server
from metrology.errors import StoreError
from storage.archive import Store, maintenance
from tests.support.s3 import bundles_uri, emulated_s3


def copies(scene: Path, inbox: Path, count: int) -> None:
    """The scene under several station names."""
    for index in range(count):
        folder = inbox / f"scan-{index}"
        shutil.copytree(scene, folder)
        manifest = json.loads((folder / "scene.json").read_text(encoding="utf-8"))
        manifest["station"] = f"D{index}"
        (folder / "scene.json").write_text(json.dumps(manifest), encoding="utf-8")


def kill_one(cluster: LocalCluster, store: Store, killed: list[int]) -> None:
    """Kill a worker as soon as the first scene is stored."""
    while not killed:
        time.sleep(0.2)
        try:
            if store.query("SELECT count(*) FROM scenes").column(0)[0].as_py() > 0:
                pid = cluster.workers[0].pid
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)
        except StoreError:
            continue  # nothing stored yet


def main() -> int:
    """Run as the arguments say."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--rig", type=Path, required=True)
    parser.add_argument("--scenes", type=int, default=4)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    os.environ |= {"DO_NOT_TRACK": "1", "PREFECT_SERVER_ANALYTICS_ENABLED": "false"}
    root = Path(tempfile.mkdtemp(prefix="flushline-dask-"))
    store, outcomes, killed = Store(root / "store"), list[Outcome](), list[int]()
    copies(options.scene, root / "inbox", options.scenes)
    job = InboxJob(root / "inbox", store.root, options.rig.absolute(), settle_s=0.0)
    start = time.perf_counter()
    with (
        emulated_s3() as endpoint,
        prefect_test_harness(server_startup_timeout=180),
        LocalCluster(n_workers=options.workers, threads_per_worker=1, dashboard_address=None) as cluster,
    ):
        store.create(bundles_uri(endpoint, "dask"))
        killer = threading.Thread(target=kill_one, args=(cluster, store, killed), daemon=True)
        killer.start()
        run_on_server(job, Way("dask", options.workers, cluster.scheduler_address), outcomes.append)
        problems = list(maintenance.check(store.layout).problems)
        there = len(store.bundles.runs())
    stored = store.query("SELECT station FROM scenes ORDER BY ALL").column(0).to_pylist()
    if stored != [f"D{index}" for index in range(options.scenes)]:
        problems.append(f"found stations {stored}, expected {options.scenes}")
    if not killed:
        problems.append("no worker was killed in time")
    print(
        f"{len(stored)} scenes in {time.perf_counter() - start:.0f} s, {len(killed)} worker killed, {there} runs on S3"
    )
    for problem in (*problems, *(f"{o.folder.name}: {o.state} {o.text}" for o in outcomes if o.state != "inspected")):
        print(f"  {problem}")
    shutil.rmtree(root)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())

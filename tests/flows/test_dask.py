"""An inbox on a Dask cluster of separate processes, one of which is killed in the middle, its bundles on S3;
benchmarks/dask_inbox.py does the same with full-size scans."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from flows.inbox_job import InboxJob, Outcome, Way
from storage.archive import Store, maintenance
from storage.archive.remote import Remote
from tests.support.results import small_key
from tests.support.s3 import bundles_uri, emulated_s3
from tests.support.small_scene import write_small_scene

distributed = pytest.importorskip("distributed", reason="needs flushline[dask]")
pytest.importorskip("moto.server", reason="moto[server] emulates S3")

SCENES = 6


class FakeMetrology(distributed.WorkerPlugin):  # type: ignore[misc, name-defined]
    """Stands for metrology in a worker, a little slower than it needs to be."""

    def setup(self, worker: object) -> None:
        from tasks import steps
        from tests.support.small_scene import fake_metrology_in

        fake_metrology_in(setattr)
        measure = steps.rivets.measure_rivets

        def slowly(*arguments: object) -> object:
            time.sleep(0.5)
            return measure(*arguments)

        steps.rivets.measure_rivets = slowly


@pytest.fixture
def s3() -> Iterator[str]:
    with emulated_s3() as endpoint:
        yield bundles_uri(endpoint, "dask")


@pytest.fixture
def cluster(s3: str) -> Iterator[object]:
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        with distributed.Client(cluster) as client:
            client.register_plugin(FakeMetrology())
        yield cluster


@pytest.mark.services
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_worker_killed_in_the_middle_costs_no_scene(
    tmp_path: Path,
    rig_file: Path,
    fake_metrology: list[str],
    server: None,
    s3: str,
    cluster: object,
) -> None:
    from flows.prefect_inbox import run_on_server

    inbox, store = tmp_path / "inbox", Store(tmp_path / "store")
    store.create(s3)
    for index in range(SCENES):
        write_small_scene(inbox / f"scan-{index}", small_key(f"D{index}"))
    job = InboxJob(inbox, store.root, rig_file, settle_s=0.0)

    def kill() -> None:
        while not store.layout.archive.exists():
            time.sleep(0.05)
        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)  # type: ignore[attr-defined]

    killer = threading.Thread(target=kill)
    killer.start()
    outcomes: list[Outcome] = []
    run_on_server(job, Way("dask", 2, cluster.scheduler_address), outcomes.append)  # type: ignore[attr-defined]
    killer.join()
    assert {outcome.state for outcome in outcomes} == {"inspected"}
    stored = store.query("SELECT station FROM scenes ORDER BY ALL").column(0).to_pylist()
    assert stored == [f"D{index}" for index in range(SCENES)]
    assert maintenance.check(store.layout).problems == ()
    scenes = {small_key(f"D{k}").scene_id for k in range(SCENES)}
    assert {Path(run).parent.name for run in Remote(s3).runs()} == {*scenes, "MSN-1~LH-F12"}  # and their panel

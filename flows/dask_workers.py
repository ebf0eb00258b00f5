"""Processes of a Dask cluster, on this machine or on others, that inspect scenes."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager

from metrology.errors import UsageError


@contextmanager
def dask_workers(count: int, address: str | None) -> Iterator[tuple[Executor, int]]:
    """Workers of the cluster at `address`, or `count` processes of this machine; and how many scenes they take at once.

    Prefect's own runner for Dask would start Prefect in each worker and set it up again for every task, at a second per
    scene. Here its tasks are threads that wait for what Dask is given.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise UsageError(
            "--runner dask: found no distributed, expected it installed: pip install flushline[dask]"
        ) from None
    with ExitStack() as opened:
        cluster = address or opened.enter_context(
            LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None)
        )
        client = opened.enter_context(Client(cluster))
        yield client.get_executor(pure=False), max(count, sum(client.nthreads().values()))

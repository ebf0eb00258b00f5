"""Processes that inspect scenes side by side: one that dies takes nothing with it but the scene it was at."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

Result = TypeVar("Result")
_ATTEMPTS = 2


class ProcessDied(BrokenExecutor):
    """A piece of work whose process died each time it was tried."""


class Workers(Executor):
    """Processes that work on one thing at a time each.

    Each has a pool of its own: where a process dies, it is known what it was at, and nobody else notices. A new one
    takes its place, and the work is tried once more; where that one dies, too, its future says `ProcessDied`.
    """

    def __init__(self, count: int) -> None:
        self._threads = ThreadPoolExecutor(count)  # each waits for a process
        self._idle: queue.SimpleQueue[ProcessPoolExecutor] = queue.SimpleQueue()
        self._pools: set[ProcessPoolExecutor] = set()
        self._changing = threading.Lock()
        for _ in range(count):
            self._idle.put(self._new_pool())

    def submit(self, work: Callable[..., Result], /, *arguments: Any, **named: Any) -> Future[Result]:
        """Call `work` in the next process that is idle."""
        return self._threads.submit(self._call, partial(work, *arguments, **named))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave what has not begun if that is asked for, wait for what is at work, and end the processes."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for pool in self._pools:
            pool.shutdown(wait)

    def _call(self, work: Callable[[], Result]) -> Result:
        pool = self._idle.get()
        try:
            for _ in range(_ATTEMPTS):
                try:
                    return pool.submit(work).result()
                except BrokenExecutor:
                    pool.shutdown(wait=False)
                    pool = self._new_pool(instead_of=pool)
        finally:
            self._idle.put(pool)
        raise ProcessDied(f"the process at work on it died {_ATTEMPTS} times")

    def _new_pool(self, instead_of: ProcessPoolExecutor | None = None) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")  # threads of numerical libraries do not survive a fork
        pool = ProcessPoolExecutor(1, context, initializer=_follow_the_run)
        with self._changing:
            if instead_of:
                self._pools.remove(instead_of)
            self._pools.add(pool)
        return pool


@contextlib.contextmanager
def worker_processes(count: int) -> Iterator[Executor]:
    """Processes that inspect scenes. A run that is stopped waits for those at work and leaves the others."""
    workers = Workers(count)
    try:
        yield workers
    except KeyboardInterrupt:
        print("stopping as soon as the scenes at work are stored", file=sys.stderr)
        raise
    finally:
        workers.shutdown(cancel_futures=True)


def _follow_the_run() -> None:
    """Ctrl-C reaches all processes of a terminal: leave it to the run. Where the run itself is killed, go with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    run = multiprocessing.parent_process()

    def leave() -> None:
        if run:
            run.join()
            os._exit(1)

    threading.Thread(target=leave, daemon=True).start()

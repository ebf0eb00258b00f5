"""A process that dies takes nothing with it but the scene it was at, and that one is tried again."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path

import pytest

from flows.inbox import inspect_in
from flows.inbox_job import InboxJob
from flows.workers import ProcessDied, worker_processes


def die_unless(marker: Path) -> int:
    """Die like a process that the system kills, until a marker is there."""
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture(scope="module")
def processes() -> Iterator[Executor]:
    with worker_processes(2) as processes:
        yield processes


@pytest.mark.slow
def test_only_the_work_whose_process_dies_suffers(processes: Executor, tmp_path: Path) -> None:
    bad = [processes.submit(die), processes.submit(die)]
    good = [processes.submit(abs, -k) for k in range(6)]
    again = processes.submit(die_unless, tmp_path / "marker")
    assert [future.result(60) for future in good] == list(range(6))
    assert again.result(60) > 0
    for future in bad:
        with pytest.raises(ProcessDied, match="died 2 times"):
            future.result(60)


def test_a_scene_that_kills_its_process_is_put_aside(
    processes: Executor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "inbox" / "deadly"
    folder.mkdir(parents=True)
    monkeypatch.setattr("flows.inbox.inspect_folder", die_with)
    outcome = inspect_in(processes, InboxJob(tmp_path / "inbox", tmp_path / "store"), folder)
    assert outcome.state == "quarantined"
    assert f"{folder}: found that the process at work on it died 2 times" in outcome.text
    assert (tmp_path / "inbox" / "quarantine" / "deadly").is_dir()


def die_with(*_: object) -> None:
    die()

"""Fixtures that every room's tests share."""

from __future__ import annotations

import gc
import os
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

# Before numpy is loaded: two processes with two threads each would wait for each other, as `flushline` sets it too.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Tests that share what takes long to start run one after the other in one process; all others file by file.
_TOGETHER = {
    "tests/dashboard/test_browser": "browser",
    "tests/flows/test_prefect.py": "prefect server",
    "tests/flows/test_dask.py": "prefect server",
    "tests/metrology/test_rivet_measurement.py": "reference scans",
    "tests/metrology/test_seam_detection.py": "reference scans",
    "tests/storage/test_review": "postgresql",
}
_LONG = {"browser", "services", "slow"}
# Files without a slow test that take long all the same.
_LONG_TOGETHER = {
    "tests/dashboard/test_pages.py", "tests/flows/test_any_rig.py", "tests/flows/test_command_line.py",
    "tests/flows/test_inbox.py", "tests/flows/test_inbox_trouble.py", "tests/flows/test_verify.py",
    "tests/metrology/test_calibration_detect.py", "tests/metrology/test_calibration_solve.py",
    "tests/metrology/test_mix_ups.py", "tests/metrology/test_registration.py", "tests/storage/test_evidence.py",
    "tests/storage/test_fooling.py", "tests/tasks/test_frame_doubts.py",
}  # fmt: skip


def _group(nodeid: str) -> str:
    file = nodeid.partition("::")[0]
    return next((group for begins, group in _TOGETHER.items() if file.startswith(begins)), file)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Tests of one group share a process, and its fixtures.

    Not by `--dist loadgroup`: xdist 3.8 writes the group into a field of the test's name that pytest 9.2 no longer has.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Together(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return _group(nodeid)

    return Together(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, object, object]:
    """What is loaded to find the tests stays: Python need not look for garbage in it again and again."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_unconfigure() -> None:
    gc.unfreeze()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of several processes none waits long for the others at the end: groups that take long come first."""
    if not hasattr(config, "workerinput"):
        return
    long = {_group(item.nodeid) for item in items if any(mark.name in _LONG for mark in item.iter_markers())}
    long |= {_group(file) for file in _LONG_TOGETHER}
    items.sort(key=lambda item: _group(item.nodeid) not in long)


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder with the independently rendered scans and the real captures (FLUSHLINE_SHARED)."""
    folder = os.environ.get("FLUSHLINE_SHARED")
    if not folder:
        pytest.skip("FLUSHLINE_SHARED is not set: the folder with the reference scans is not at hand")
    return Path(folder)

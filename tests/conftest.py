"""Fixtures that every room's tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# Tests that share what takes long to start run one after the other in one process; all others file by file.
_TOGETHER = {
    "tests/dashboard/test_browser": "browser",
    "tests/flows/test_prefect.py": "prefect server",
    "tests/flows/test_dask.py": "prefect server",
}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Say which tests run in the same process (`--dist loadgroup`)."""
    for item in items:
        file = item.nodeid.partition("::")[0]
        group = next((group for begins, group in _TOGETHER.items() if file.startswith(begins)), file)
        item.add_marker(pytest.mark.xdist_group(group))


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder with the independently rendered scans and the real captures (FLUSHLINE_SHARED)."""
    folder = os.environ.get("FLUSHLINE_SHARED")
    if not folder:
        pytest.skip("FLUSHLINE_SHARED is not set: the folder with the reference scans is not at hand")
    return Path(folder)

"""Fixtures that every room's tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder with the independently rendered scans and the real captures (FLUSHLINE_SHARED)."""
    folder = os.environ.get("FLUSHLINE_SHARED")
    if not folder:
        pytest.skip("FLUSHLINE_SHARED is not set: the folder with the reference scans is not at hand")
    return Path(folder)

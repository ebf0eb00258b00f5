"""Writers killed at random for a few seconds; benchmarks/crash_archive.py does the same for minutes."""

from __future__ import annotations

from pathlib import Path

import pytest

from storage.archive import Store
from tests.support.killing import damage, settle, torment


@pytest.mark.slow
def test_killed_writers_never_spoil_a_read_or_the_archive(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    # At least 8 s, and on a slow machine as long as it takes to read and kill often enough.
    tally = settle(store, torment(store, seconds=8.0, least_reads=21, least_kills=6))
    assert tally.wrong == []
    assert tally.runs > 2  # that writers do store something between two kills
    damage(store, tally)
    assert tally.wrong == []

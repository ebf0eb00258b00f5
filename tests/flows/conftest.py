"""Fixtures of the flows' tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from storage.rig import save_rig
from tests.support.results import small_key, small_rig
from tests.support.small_scene import fake_metrology_in, write_small_scene


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    save_rig(small_rig(), tmp_path / "rig.json")
    return tmp_path / "rig.json"


@pytest.fixture
def scenes(tmp_path: Path) -> list[Path]:
    """Two sound scene folders."""
    return [write_small_scene(tmp_path / name, small_key(name)) for name in ("S1", "S2")]


@pytest.fixture
def fake_metrology(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Metrology replaced at its door, in a process without a Prefect server."""
    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    monkeypatch.setenv("PREFECT_HOME", "/nonexistent")
    return fake_metrology_in(monkeypatch.setattr)


@pytest.fixture(scope="session")
def server() -> Iterator[None]:
    """A Prefect server of the tests' own; it takes half a minute to start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DO_NOT_TRACK", "1")
        patch.setenv("PREFECT_SERVER_ANALYTICS_ENABLED", "false")
        patch.setenv("PREFECT_LOGGING_LEVEL", "ERROR")
        from prefect.testing.utilities import prefect_test_harness

        with prefect_test_harness(server_startup_timeout=180):
            yield

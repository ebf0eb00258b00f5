"""The same steps as a Prefect flow, against a server of the test's own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from flows.cli import main
from flows.prefect_server import answers, configured_api
from storage.archive import Store


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("DO_NOT_TRACK", "1")
    monkeypatch.setenv("PREFECT_SERVER_ANALYTICS_ENABLED", "false")
    monkeypatch.setenv("PREFECT_LOGGING_LEVEL", "ERROR")
    from prefect.testing.utilities import prefect_test_harness

    with prefect_test_harness(server_startup_timeout=180):
        yield


@pytest.mark.filterwarnings("ignore")
def test_scenes_run_as_a_flow_of_tasks(
    scenes: list[Path],
    rig_file: Path,
    tmp_path: Path,
    fake_metrology: list[str],
    server: None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from prefect.client.orchestration import get_client

    (scenes[0] / "right" / "e0_c0_s0.png").write_bytes(b"")
    store = tmp_path / "store"
    assert main(["inspect", *map(str, scenes), "--rig", str(rig_file), "--store", str(store), "--server"]) == 1
    assert "running as Prefect flow" in capsys.readouterr().err
    assert Store(store).query("SELECT station FROM scenes").to_pylist() == [{"station": "S2"}]
    with get_client(sync_client=True) as client:
        runs = client.read_flow_runs()
        assert [run.state_name for run in runs] == ["Completed"]
        names = {run.name.rsplit("-", 1)[0] for run in client.read_task_runs()}
    assert {"load", "reconstruct-scene", "measure-seams", "publish"} <= names


def test_a_configured_server_is_found_without_prefect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    monkeypatch.delenv("PREFECT_PROFILE", raising=False)
    monkeypatch.setenv("PREFECT_HOME", str(tmp_path))
    assert configured_api() is None
    (tmp_path / "profiles.toml").write_text(
        'active = "plant"\n[profiles.plant]\nPREFECT_API_URL = "http://127.0.0.1:9/api"\n'
    )
    assert configured_api() == "http://127.0.0.1:9/api"
    assert not answers("http://127.0.0.1:9/api")
    monkeypatch.setenv("PREFECT_API_URL", "http://plant/api")
    assert configured_api() == "http://plant/api"

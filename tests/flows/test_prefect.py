"""The same steps as a Prefect flow, against a server of the test's own."""

from __future__ import annotations

from pathlib import Path

import pytest

from flows.cli import main
from flows.prefect_server import answers, configured_api
from storage.archive import Store
from tests.support.exported import deliver_panels
from tests.support.results import small_key
from tests.support.small_scene import write_small_scene


@pytest.mark.services
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
        states = {run.name: run.state_name for run in client.read_flow_runs()}
        assert states[str(scenes[1])] == "Completed"
        names = {run.name.rsplit("-", 1)[0] for run in client.read_task_runs()}
    assert {"load", "reconstruct-scene", "measure-seams", "publish"} <= names


@pytest.mark.services
@pytest.mark.filterwarnings("ignore")
def test_an_inbox_runs_as_a_flow_with_pages_of_its_own(
    rig_file: Path, tmp_path: Path, fake_metrology: list[str], server: None, capsys: pytest.CaptureFixture[str]
) -> None:
    from prefect.client.orchestration import get_client

    inbox, store = tmp_path / "inbox", tmp_path / "store"
    for station in ("S1", "S2", "S3"):
        write_small_scene(inbox / station, small_key(station))
    (inbox / "S2" / "scene.json").write_text("{")
    Store(store).create()
    deliver_panels(Store(store), str(tmp_path / "spc"), "csv")
    arguments = ["run", "--inbox", str(inbox), "--store", str(store), "--rig", str(rig_file), "--settle", "0"]
    assert main([*arguments, "--server", "--runner", "threads", "--workers", "2", "--compact"]) == 1
    said = capsys.readouterr()
    assert said.out.endswith("2 inspected, 1 put aside\n")
    assert "broken JSON" in said.err
    assert len(list((store / "parquet" / "rivets").glob("*/*.parquet"))) == 1
    assert (tmp_path / "spc" / "MSN-1~LH-F12-rivets.csv").is_file()
    assert Store(store).query("SELECT count(*) FROM scenes").column(0).to_pylist() == [2]
    with get_client(sync_client=True) as client:
        pages = {artifact.key: str(artifact.data) for artifact in client.read_latest_artifacts()}
    assert "| R1 | 0.050 |" in pages["scene"]
    assert "data:image/jpeg;base64," in pages["scene"]
    assert "put aside" in pages["inbox-summary"]
    assert float(pages["inbox-progress"]) == 100.0
    assert main([*arguments, "--server", "--runner", "threads"]) == 0
    assert capsys.readouterr().out == "2 known already\n"


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


def test_the_deployment_for_a_work_pool_fits_the_flow() -> None:
    import inspect

    import yaml

    from flows.prefect_inbox import inspect_inbox_flow

    root = Path(__file__).parents[2]
    (deployment,) = yaml.safe_load((root / "prefect.yaml").read_text(encoding="utf-8"))["deployments"]
    file, _, name = deployment["entrypoint"].partition(":")
    assert (root / file).is_file()
    assert name == inspect_inbox_flow.fn.__name__
    inspect.signature(inspect_inbox_flow.fn).bind(**deployment["parameters"])


class KilledWorker(Exception):
    """As Dask says it, after several workers died at a task."""


class Ended:
    """A task's future that has only a problem."""

    def __init__(self, problem: Exception) -> None:
        self.problem = problem

    def result(self) -> None:
        raise self.problem


def test_what_ends_a_task_is_the_outcome_of_its_folder_alone(tmp_path: Path) -> None:
    from flows.inbox_job import InboxJob
    from flows.prefect_inbox import outcome_of

    job = InboxJob(tmp_path / "inbox", tmp_path / "store")
    folder = job.inbox / "scan"
    folder.mkdir(parents=True)
    failed = outcome_of(job, folder, Ended(MemoryError("too\nmuch")))  # type: ignore[arg-type]
    assert (failed.state, failed.text) == ("failed", f"{folder}: found MemoryError: too much")
    killed = outcome_of(job, folder, Ended(KilledWorker()))  # type: ignore[arg-type]
    assert killed.state == "quarantined"
    assert (job.inbox / "quarantine" / "scan.reason.txt").is_file()

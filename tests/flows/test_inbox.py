"""The inbox: new scenes are inspected once, broken ones are put aside with their reason, nothing stops the rest."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from flows.cli import main
from flows.inbox import inspect_folder, only_run, plan, scene_folders
from flows.inbox_job import InboxJob
from metrology.errors import UsageError
from storage.archive import Store
from storage.review import ReviewLog, ShownScene
from tasks import steps
from tests.support.results import small_key, small_result
from tests.support.small_scene import write_small_scene


@pytest.fixture
def job(tmp_path: Path, rig_file: Path) -> InboxJob:
    (tmp_path / "inbox").mkdir()
    return InboxJob(tmp_path / "inbox", tmp_path / "store", rig_file, settle_s=0.0)


def fill(inbox: Path, *stations: str) -> list[Path]:
    return [write_small_scene(inbox / f"scan-{station}", small_key(station)) for station in stations]


def run(job: InboxJob, *more: str) -> int:
    arguments = ["run", "--inbox", str(job.inbox), "--store", str(job.store), "--settle", str(job.settle_s)]
    return main([*arguments, *(["--rig", str(job.rig)] if job.rig else []), *more])


def stations(job: InboxJob) -> list[str]:
    return Store(job.store).query("SELECT station FROM scenes ORDER BY ALL").column(0).to_pylist()


def test_a_second_run_does_nothing(
    job: InboxJob, fake_metrology: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    fill(job.inbox, "S1", "S2")
    assert run(job) == 0
    assert capsys.readouterr().out.endswith("2 inspected\n")
    calls = len(fake_metrology)
    assert run(job) == 0
    assert capsys.readouterr().out == "2 known already\n"
    assert len(fake_metrology) == calls
    fill(job.inbox, "S3")
    assert run(job) == 0
    assert capsys.readouterr().out.endswith("2 known already, 1 inspected\n")


def test_tables_are_compacted_when_something_is_new(
    job: InboxJob, fake_metrology: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    fill(job.inbox, "S1")
    assert run(job, "--compact") == 0
    assert "tables for other engines" in capsys.readouterr().out
    compacted = os.readlink(job.store / "parquet")
    assert run(job, "--compact") == 0
    assert os.readlink(job.store / "parquet") == compacted


def test_other_settings_or_another_rig_make_a_scene_new(
    job: InboxJob, fake_metrology: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fill(job.inbox, "S1")
    assert run(job) == 0
    settings = tmp_path / "settings.toml"
    settings.write_text("[rivets]\nmin_score = 9.0\n")
    assert run(job, "--settings", str(settings)) == 0
    assert "1 inspected" in capsys.readouterr().out
    assert job.rig is not None
    document = json.loads(job.rig.read_text())
    document["projector"]["K"][0][2] += 0.5
    job.rig.write_text(json.dumps(document))
    assert run(job, "--settings", str(settings)) == 0
    assert "1 inspected" in capsys.readouterr().out


def test_a_signed_off_scene_keeps_its_result(
    job: InboxJob, fake_metrology: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, _ = fill(job.inbox, "S1", "S2")
    assert run(job) == 0
    store = Store(job.store)
    signed = store.query("SELECT run_id FROM scenes WHERE station = 'S1'").column(0)[0].as_py()
    ReviewLog(job.store).sign_off("k.ito", ShownScene(small_key("S1").scene_id, signed))
    settings = tmp_path / "settings.toml"
    settings.write_text("[rivets]\nmin_score = 9.0\n")
    assert run(job, "--settings", str(settings)) == 0
    assert capsys.readouterr().out.endswith("1 signed off earlier, 1 inspected\n")
    assert first.is_dir()
    arguments = ["inspect", str(first), "--rig", str(job.rig), "--store", str(job.store)]
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert "found it signed off by k.ito" in said
    assert store.query("SELECT run_id FROM scenes WHERE station = 'S1'").column(0).to_pylist() == [signed]


def big_header(folder: Path) -> None:
    import struct

    frame = folder / "left" / "e0_c0_s0.png"
    data = bytearray(frame.read_bytes())
    data[16:24] = struct.pack(">II", 100_000, 100_000)
    frame.write_bytes(data)


def sixteen_bit(folder: Path) -> None:
    frame = folder / "left" / "e0_c2_s1.png"
    cv2.imwrite(str(frame), cv2.imread(str(frame), cv2.IMREAD_UNCHANGED).astype(np.uint16))


def escape(folder: Path) -> None:
    manifest = folder / "scene.json"
    manifest.write_text(manifest.read_text().replace("left/e0_c0_s0.png", "../../secret.png"))


def manifest_folder(folder: Path) -> None:
    (folder / "scene.json").unlink()
    (folder / "scene.json").mkdir()


def emptied(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.mkdir()


def looped(folder: Path) -> None:
    shutil.rmtree(folder)
    os.symlink(folder.name, folder)


def looped_manifest(folder: Path) -> None:
    (folder / "scene.json").unlink()
    os.symlink("scene.json", folder / "scene.json")


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda folder: (folder / "left" / "e0_c0_s0.png").unlink(), "e0_c0_s0.png: found no such file"),
        (big_header, "100000×100000"),
        (sixteen_bit, "with 16 bit, expected 64×48 with 8 bit"),
        (escape, "expected one inside the folder"),
        (emptied, "found an empty folder"),
        (manifest_folder, "scene.json: found a directory"),
        (looped_manifest, "symbolic links"),
        (looped, "expected a scene folder"),
    ],
)
def test_a_broken_scene_is_put_aside_with_its_reason(
    job: InboxJob,
    fake_metrology: list[str],
    spoil: Callable[[Path], None],
    reason: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bad, _ = fill(job.inbox, "S1", "S2")
    spoil(bad)
    assert run(job) == 1
    assert stations(job) == ["S2"]
    quarantine = job.inbox / "quarantine"
    assert os.path.lexists(quarantine / bad.name)
    assert reason in (quarantine / f"{bad.name}.reason.txt").read_text()
    assert not os.path.lexists(bad)
    assert "put aside" in capsys.readouterr().out
    assert run(job) == 0


@pytest.mark.parametrize(("inbox", "store"), [("a", "a"), ("a", "a/store"), ("a/inbox", "a")])
def test_an_inbox_and_a_store_in_one_folder_are_refused(
    inbox: str, store: str, job: InboxJob, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mixed = replace(job, inbox=tmp_path / inbox, store=tmp_path / store)
    Store(mixed.store).publish(small_result())
    mixed.inbox.mkdir(exist_ok=True)
    before = sorted(mixed.store.rglob("*"))
    assert run(mixed) == 2
    assert "expected both apart" in capsys.readouterr().err
    assert sorted(mixed.store.rglob("*")) == before


def test_a_rig_with_nan_in_the_store_is_a_reason(job: InboxJob, fake_metrology: list[str]) -> None:
    fill(job.inbox, "S1", "S2")
    manifest = job.inbox / "scan-S1" / "scene.json"
    manifest.write_text(manifest.read_text().replace('"rig-a"', '"rig-nan"'))
    assert job.rig is not None
    assert main(["inspect", str(job.inbox / "scan-S2"), "--rig", str(job.rig), "--store", str(job.store)]) == 0
    document = job.rig.read_text().replace('"width": 64', '"width": 64, "residual": NaN', 1)
    (job.store / "rigs" / "rig-nan.json").write_text(document.replace("rig-a", "rig-nan"))
    assert run(replace(job, rig=None)) == 1
    assert "found NaN" in (job.inbox / "quarantine" / "scan-S1.reason.txt").read_text()


def test_a_scan_that_turns_out_broken_on_the_way_is_put_aside_too(job: InboxJob, fake_metrology: list[str]) -> None:
    bad, _ = fill(job.inbox, "S1", "S2")
    frame = bad / "right" / "e0_c1_s0.png"
    data = bytearray(frame.read_bytes())
    data[len(data) // 2] ^= 0xFF
    frame.write_bytes(data)
    assert run(job) == 1
    assert stations(job) == ["S2"]
    assert "damaged PNG" in (job.inbox / "quarantine" / "scan-S1.reason.txt").read_text()


def test_what_is_not_the_scenes_fault_leaves_it_in_the_inbox(
    job: InboxJob, fake_metrology: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (scene,) = fill(job.inbox, "S1")

    def fail(*_: object) -> None:
        raise OSError(5, "Input/output error", "disk")

    with monkeypatch.context() as patch:
        patch.setattr(steps.rivets, "measure_rivets", fail)
        assert run(job) == 1
    assert scene.is_dir()
    assert "left for the next run" in capsys.readouterr().err
    assert run(job) == 0
    assert stations(job) == ["S1"]


def test_a_scene_whose_rig_is_not_there_yet_waits(job: InboxJob, fake_metrology: list[str], rig_file: Path) -> None:
    (scene,) = fill(job.inbox, "S1")
    alone = replace(job, rig=None)
    assert run(alone) == 0
    assert scene.is_dir()
    assert not job.store.exists()
    assert [outcome.state for outcome in plan(alone).settled] == ["waiting"]


def test_what_is_still_being_copied_is_left_alone(job: InboxJob, fake_metrology: list[str]) -> None:
    done, copying = fill(job.inbox, "S1", "S2")
    (copying / "left" / "e0_c0_s0.png").unlink()
    for path in (copying, *copying.rglob("*")):
        os.utime(path, (0, 0))  # as copying tools do that keep times
    patient = replace(job, settle_s=1.5)
    assert [outcome.state for outcome in plan(patient).settled] == ["copying", "copying"]
    time.sleep(1.6)
    (copying / "right" / "e0_c0_s0.png").touch()
    planned = plan(patient)
    assert planned.ready == [done]
    assert [outcome.state for outcome in planned.settled] == ["copying"]


def test_scenes_are_found_in_folders_of_folders(job: InboxJob) -> None:
    write_small_scene(job.inbox / "MSN-1" / "night" / "S1", small_key("S1"))
    write_small_scene(job.inbox / "S2", small_key("S2"))
    (job.inbox / "empty").mkdir()
    (job.inbox / ".hidden").mkdir()
    (job.inbox / "quarantine").mkdir()
    (job.inbox / "notes.txt").write_text("")
    found = [str(folder.relative_to(job.inbox)) for folder in scene_folders(job.inbox)]
    assert found == ["MSN-1/night/S1", "S2", "empty"]


def test_a_run_killed_in_the_middle_goes_on_where_it_stopped(job: InboxJob, fake_metrology: list[str]) -> None:
    fill(job.inbox, "S1", "S2", "S3")
    inspect_folder(job, plan(job).ready[0])
    assert [folder.name for folder in plan(job).ready] == ["scan-S2", "scan-S3"]


def test_two_runs_do_not_meet(job: InboxJob) -> None:
    with only_run(job.inbox):
        assert run(job) == 2
    with pytest.raises(UsageError, match="found no such folder"), only_run(job.inbox / "none"):
        pass


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--workers", "0"], "--workers: found 0"),
        (["--settle", "-1"], "settle time"),
        (["--runner", "threads"], "found no Prefect server"),
    ],
)
def test_wrong_usage_is_said(
    job: InboxJob, fake_metrology: list[str], more: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(job, *more) == 2
    assert said in capsys.readouterr().err


def test_serving_needs_a_server(
    job: InboxJob, fake_metrology: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["serve", "--inbox", str(job.inbox), "--store", str(job.store)]
    assert main(arguments) == 2
    assert "found no Prefect server configured" in capsys.readouterr().err
    monkeypatch.setenv("PREFECT_API_URL", "http://127.0.0.1:9/api")
    assert main(arguments) == 2
    assert "found no answer from http://127.0.0.1:9/api" in capsys.readouterr().err


_RUN_WITH_WORKERS = """
import os, time
from flows.workers import worker_processes
if __name__ == "__main__":
    with worker_processes(2) as processes:
        print(processes.submit(os.getpid).result(), flush=True)
        time.sleep(600)
"""


def test_workers_go_with_a_run_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "run.py"
    script.write_text(_RUN_WITH_WORKERS)
    root = Path(__file__).parents[2]
    with subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": str(root)}
    ) as process:
        assert process.stdout is not None
        worker = int(process.stdout.readline())
        os.kill(worker, 0)  # it is there
        process.kill()
        # The workers hold the other end of the pipe: it ends when the last of them is gone.
        assert process.communicate(timeout=60)[0] == ""

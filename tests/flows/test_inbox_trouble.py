"""One broken folder never stops an inbox, two scans of one name never replace each other, and a wrong inbox is left."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from flows import inbox
from flows.cli import main
from flows.inbox_folders import check_is_inbox, put_aside, scene_folders
from flows.inbox_job import InboxJob
from metrology.errors import UsageError
from storage.archive import Store
from storage.panel_spec import load_panel_spec
from storage.scene_folder import SceneDocument
from storage.scene_models import SceneModel
from tests.support.results import small_key
from tests.support.small_scene import write_small_scene
from tests.support.users import as_user, only_root, open_to_all


@pytest.fixture
def job(tmp_path: Path, rig_file: Path) -> InboxJob:
    (tmp_path / "inbox").mkdir()
    return InboxJob(tmp_path / "inbox", tmp_path / "store", rig_file, settle_s=0.0)


def run(job: InboxJob, *more: str) -> int:
    arguments = ["run", "--inbox", str(job.inbox), "--store", str(job.store), "--settle", "0", "--rig", str(job.rig)]
    return main([*arguments, *more])


def stations(job: InboxJob) -> list[str]:
    return Store(job.store).query("SELECT station FROM scenes ORDER BY ALL").column(0).to_pylist()


def other_scan(folder: Path, station: str) -> Path:
    """A scan of another moment that was given the same key."""
    return write_small_scene(folder, small_key(station), seed=7)


# --- two scans of one name


@pytest.mark.parametrize("how", ["in one run", "in a later run", "after an inspection from elsewhere"])
def test_another_scan_under_a_known_key_is_put_aside(
    how: str, job: InboxJob, fake_metrology: list[str], tmp_path: Path
) -> None:
    if how == "after an inspection from elsewhere":
        first = write_small_scene(tmp_path / "first", small_key("S1"))
        assert main(["inspect", str(first), "--rig", str(job.rig), "--store", str(job.store)]) == 0
    else:
        write_small_scene(job.inbox / "a", small_key("S1"))
    if how == "in a later run":
        assert run(job) == 0
    other_scan(job.inbox / "b", "S1")
    assert run(job) == 1
    reason = (job.inbox / "quarantine" / "b.reason.txt").read_text()
    assert "found other frames than those stored as MSN-1~LH-F12~S1~20261120T081500Z" in reason
    assert str(job.inbox / "b") in reason
    assert stations(job) == ["S1"]
    assert len(Store(job.store).bundles.runs()) == 1
    assert (job.inbox / "a").is_dir() != (how == "after an inspection from elsewhere")


def test_the_same_scan_in_another_folder_is_known(
    job: InboxJob, fake_metrology: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    write_small_scene(job.inbox / "a", small_key("S1"))
    shutil.copytree(job.inbox / "a", job.inbox / "b")
    assert run(job) == 0
    assert capsys.readouterr().out.endswith("1 known already, 1 inspected\n")
    shutil.copytree(job.inbox / "a", job.inbox / "c")
    shutil.rmtree(job.inbox / "a")
    assert run(job) == 0
    assert capsys.readouterr().out.endswith("2 known already\n")


def test_frames_that_were_replaced_in_place_are_told(job: InboxJob, fake_metrology: list[str]) -> None:
    scene = write_small_scene(job.inbox / "a", small_key("S1"))
    assert run(job) == 0
    frame = other_scan(job.inbox.parent / "other", "S1") / "right" / "e0_c1_s2.png"
    shutil.copyfile(frame, scene / "right" / "e0_c1_s2.png")
    assert run(job) == 1
    assert (job.inbox / "quarantine" / "a").is_dir()


def test_known_scans_are_not_read_again(
    job: InboxJob, fake_metrology: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = write_small_scene(job.inbox / "a", small_key("S1"))
    assert run(job) == 0
    (job.inbox / "deeper").mkdir()
    scene.rename(job.inbox / "deeper" / "a")

    def read(*_: object) -> str:
        raise AssertionError("the frames were read again")

    monkeypatch.setattr(SceneModel, "digest", read)
    assert run(job) == 0


def test_inspect_refuses_the_second_of_two_scans_of_one_name(
    job: InboxJob, fake_metrology: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = write_small_scene(tmp_path / "a", small_key("S1")), other_scan(tmp_path / "b", "S1")
    arguments = ["--rig", str(job.rig), "--store", str(job.store)]
    assert main(["inspect", str(a), str(b), *arguments]) == 1
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error")]
    assert len(errors) == 1
    assert f"{b}: found other frames" in errors[0]
    assert main(["inspect", str(b), *arguments]) == 2
    assert main(["inspect", str(a), *arguments]) == 0  # the same again
    assert len(Store(job.store).bundles.runs()) == 2


# --- times


@pytest.mark.parametrize(
    ("captured_at", "said"), [(datetime(2036, 5, 1, tzinfo=UTC), "ahead of this computer's clock"),
                              (datetime(2026, 11, 1, tzinfo=UTC), "before rig 'rig-a' was calibrated")],
)  # fmt: skip
def test_a_time_that_cannot_be_true_is_warned_of(
    captured_at: datetime, said: str, job: InboxJob, fake_metrology: list[str], tmp_path: Path
) -> None:
    scene = write_small_scene(tmp_path / "a", replace(small_key("S1"), captured_at=captured_at))
    for _ in range(2):  # however often it is inspected
        assert main(["inspect", str(scene), "--rig", str(job.rig), "--store", str(job.store)]) == 0
        (warnings,) = Store(job.store).query("SELECT warnings FROM scenes").column(0).to_pylist()
        assert sum(said in warning for warning in warnings) == 1


@pytest.mark.parametrize("captured_at", ["20261128090000", "20261120", "2026-11-20T09:00:00", 1795000000, 1.5e9, True])
def test_what_is_no_time_with_a_zone_is_refused(
    captured_at: object, job: InboxJob, fake_metrology: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write_small_scene(tmp_path / "a", small_key("S1"))
    document = json.loads((scene / "scene.json").read_text())
    (scene / "scene.json").write_text(json.dumps(document | {"captured_at": captured_at}))
    assert main(["inspect", str(scene), "--rig", str(job.rig), "--store", str(job.store)]) == 2
    said = capsys.readouterr().err
    assert "captured_at: found" in said
    assert "with its zone" in said
    assert not job.store.exists()


# --- broken folders


@pytest.mark.parametrize("name", [b"scan-\xff", b"scan\nS1", b"scan\x1b[31m", "scan\u2028S1".encode()])
def test_a_name_that_cannot_be_printed_is_put_aside(
    name: bytes, job: InboxJob, fake_metrology: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    write_small_scene(job.inbox / os.fsdecode(name), small_key("S1"))
    write_small_scene(job.inbox / "good", small_key("S2"))
    assert run(job) == 1
    assert stations(job) == ["S2"]
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error")]
    assert line.isprintable()
    assert "scan" in line
    (note,) = (job.inbox / "quarantine").glob("*.reason.txt")
    assert str(note).isprintable()
    assert note.with_name(note.name.removesuffix(".reason.txt")).is_dir()


@pytest.mark.parametrize("problem", [ValueError("bad\nluck"), RecursionError("deep"), KeyError("x"), OSError(5, "EIO")])
def test_whatever_a_manifest_raises_is_its_own_outcome(
    problem: Exception, job: InboxJob, fake_metrology: list[str], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    write_small_scene(job.inbox / "bad", small_key("S1"))
    write_small_scene(job.inbox / "good", small_key("S2"))
    load = inbox.load_any_manifest

    def fail(manifest: Path) -> SceneDocument:
        if manifest.parent.name == "bad":
            raise problem
        return load(manifest)

    monkeypatch.setattr(inbox, "load_any_manifest", fail)
    assert run(job) == 1
    assert stations(job) == ["S2"]
    assert (job.inbox / "quarantine" / "bad").is_dir()
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error")]
    assert line.startswith(f"error: {job.inbox / 'bad'}: found ")


@only_root
def test_a_folder_that_may_not_be_read_does_not_stop_the_others(tmp_path: Path) -> None:
    open_to_all(tmp_path)
    place = tmp_path / "inbox"
    closed = write_small_scene(place / "a-closed", small_key("S1"))
    write_small_scene(place / "b-waiting", small_key("S2"))
    os.chown(place, 61001, 61001)
    closed.chmod(0)
    load_panel_spec()  # loads what another user could not, where Python lies in a folder of root's

    def look() -> None:
        planned = inbox.plan(InboxJob(place, tmp_path / "none", settle_s=0.0))
        states = [(outcome.folder.name, outcome.state) for outcome in planned.settled]
        assert states == [("a-closed", "failed"), ("b-waiting", "waiting")]

    as_user(61001, look)
    assert not list(place.glob("quarantine/*"))  # no note where nothing was moved


def test_names_in_the_quarantine_are_free_and_short(tmp_path: Path) -> None:
    for _ in range(2):
        folder = tmp_path / ("d" * 120) / ("e" * 240)
        folder.mkdir(parents=True)
        assert put_aside(tmp_path, folder, "no scene", None).state == "quarantined"
    assert len(list((tmp_path / "quarantine").glob("*.reason.txt"))) == 2


# --- what is no scene, and what is no inbox


def test_folders_of_the_system_are_nobodys_scene(job: InboxJob) -> None:
    names = (
        "lost+found", "$RECYCLE.BIN", "System Volume Information", "@eaDir", ".snapshot", "#recycle", ".Trash-1000",
        "Thumbs.db", "FOUND.000", "__MACOSX",
    )  # fmt: skip
    for name in names:
        (job.inbox / name).mkdir()
        (job.inbox / "MSN-1" / name).mkdir(parents=True)
    write_small_scene(job.inbox / "MSN-1" / "a", small_key("S1"))
    assert scene_folders(job.inbox) == [job.inbox / "MSN-1" / "a"]


def documents(inbox: Path) -> None:
    for name in ("letters", "photos", "taxes"):
        (inbox / name).mkdir()
        (inbox / name / "file.pdf").touch()


def project(inbox: Path) -> None:
    (inbox / "pyproject.toml").touch()
    (inbox / "source").mkdir()


def loose_files(inbox: Path) -> None:
    (inbox / "holidays").mkdir()
    (inbox / "holidays" / "list.txt").touch()
    for name in ("a.docx", "b.docx"):
        (inbox / name).touch()


@pytest.mark.parametrize("fill", [documents, project, loose_files])
def test_a_folder_of_other_things_is_refused_before_anything_is_moved(
    fill: Callable[[Path], None], job: InboxJob, fake_metrology: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    fill(job.inbox)
    before = sorted(job.inbox.rglob("*"))
    assert run(job) == 2
    said = capsys.readouterr().err
    assert "expected a folder that is for scans alone" in said
    assert said.count("error:") == 1
    assert sorted(job.inbox.rglob("*")) == before


def test_an_inbox_stays_one_whatever_arrives_in_it(job: InboxJob, fake_metrology: list[str]) -> None:
    documents(job.inbox)
    (job.inbox / "quarantine").mkdir()
    assert run(job) == 1
    assert len(list(job.inbox.glob("quarantine/*.reason.txt"))) == 3


def test_broken_scans_are_no_reason_to_refuse_an_inbox(job: InboxJob, fake_metrology: list[str]) -> None:
    for name in ("S1", "S2", "S3", "S4"):
        (write_small_scene(job.inbox / name, small_key(name)) / "scene.json").unlink()
    assert run(job) == 1


def test_homes_and_systems_are_no_inbox(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "people" / "me"))
    (tmp_path / "people" / "me" / "inbox").mkdir(parents=True)
    for place in (Path("/"), Path("/home"), Path("/home/someone"), tmp_path / "people" / "me", tmp_path / "people"):
        with pytest.raises(UsageError, match="nothing was moved"):
            check_is_inbox(place, [], 0.0)
    check_is_inbox(tmp_path / "people" / "me" / "inbox", [], 0.0)


# --- readers


@pytest.mark.parametrize(
    "command",
    [
        ["dashboard"], ["query", "SELECT 1"], ["report", "X", "--out", "r.html"], ["overlay", "X", "--out", "o.png"],
        ["panel", "show"], ["panel", "enrol", "X"], ["archive", "check"], ["archive", "rebuild"],
        ["archive", "compact"],
        ["archive", "prune"], ["archive", "export", "--to", "t"], ["archive", "ply", "X", "--out", "c.ply"],
    ],
)  # fmt: skip
def test_a_store_that_is_not_there_is_an_error_for_who_reads(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*command, "--store", "typo"]) == 2
    assert "error: typo: found no such folder, expected a store" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())

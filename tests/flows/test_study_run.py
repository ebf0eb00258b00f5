"""A whole study on a small panel: scans rendered and inspected once, taken up after a kill, told in a report."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from flows.inspect_scene import inspect_scene
from flows.study import workshop
from flows.study.renderer import Renderer
from flows.study.run import run_study
from flows.study.spec import Study, parse_study
from simulator import scene as simulator_scene
from simulator.scene import make_rig, simulate
from simulator.spec import SimulationSpec, read_spec
from storage.archive import Store
from storage.rig import save_rig
from tasks.settings import InspectionSettings
from tests.support.small_panel import PLACEMENTS, SEAM, SIMULATION

ACCURACY = """
format = "flushline-study/1"
study = "accuracy"
[standard_part]
simulation = "SIMULATION.toml"
scans = 2
"""

REPEATABILITY = """
format = "flushline-study/1"
study = "repeatability"
[skin]
simulation = "seam.toml"
scans = 2
positions = 3
[gage]
simulation = "seam-twice.toml"
trials = 2
positions = 3
"""


@pytest.fixture(scope="module")
def specs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with simulations and studies of them; the fewer features and scans, the sooner they are done."""
    folder = tmp_path_factory.mktemp("specs")
    for name, text in (
        ("rivets", SIMULATION),
        ("rivets-twice", SIMULATION + PLACEMENTS),
        ("seam", SIMULATION + SEAM),
        ("seam-twice", SIMULATION + SEAM + PLACEMENTS),
        ("accuracy", ACCURACY.replace("SIMULATION", "rivets")),
        ("accuracy-twice", ACCURACY.replace("SIMULATION", "rivets-twice")),
        ("repeatability", REPEATABILITY),
    ):
        (folder / f"{name}.toml").write_text(text)
    return folder


@pytest.fixture
def simulation(specs: Path) -> SimulationSpec:
    return read_spec(specs / "rivets-twice.toml")


def study(specs: Path, kind: str) -> Study:
    return parse_study((specs / f"{kind}.toml").read_text(), specs / f"{kind}.toml", kind)  # type: ignore[arg-type]


@pytest.fixture(autouse=True)
def no_capture(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small camera sees no board whole: the calibration finds a rig that is a little off."""

    def calibrate(shop: workshop.Workshop, simulation: SimulationSpec, path: Path, _say: object) -> None:
        rig = make_rig(simulation)
        path.parent.mkdir(parents=True, exist_ok=True)
        save_rig(replace(rig, id=path.stem, right=replace(rig.right, t=rig.right.t * 1.0005)), path)

    monkeypatch.setattr(workshop, "_calibrate", calibrate)
    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    monkeypatch.setenv("PREFECT_HOME", "/nonexistent")


@pytest.mark.slow
def test_accuracy_from_the_command_line(specs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["study", "accuracy", "--spec", str(specs / "accuracy-twice.toml"), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert said.count(": met") + said.count(": not met") == 3
    assert str(out / "report.html") in said

    with (out / "tables" / "table-1.csv").open(encoding="utf-8-sig") as file:
        rows = {row["rivet"]: row for row in csv.DictReader(file)}
    assert set(rows) == {"R01", "R02", "average"}
    for name, true in (("R01", 0.113), ("R02", -0.06)):
        assert float(rows[name]["truth"]) == pytest.approx(true)
        for rig in ("true rig", "calibrated rig"):
            assert abs(float(rows[name][f"{rig}: mean error"])) < 0.01
    assert rows["R01"]["paper: measured"] == "0.129"  # the first rivet has the truth of the paper's first
    assert rows["R02"]["paper: measured"] == ""

    found = Store(out / "store").query("SELECT station, rivet_id, height_mean_mm FROM rivets").to_pylist()
    assert {row["station"] for row in found} == {"S1-true", "S1-calibrated", "S2-true", "S2-calibrated"}
    assert {row["rivet_id"] for row in found} >= {"R01", "R02"}  # the simulation's names
    page = (out / "report.html").read_text()
    assert "simulated" in page
    assert "<script src" not in page  # needs no network
    assert "| R01 | 0.113 |" in (out / "report.md").read_text()
    assert not (out / "frames").exists()


@pytest.mark.slow
def test_repeatability_and_gage(specs: Path, tmp_path: Path) -> None:
    finished = run_study(study(specs, "repeatability"), tmp_path / "out", InspectionSettings())
    assert finished.problems == ()
    assert [bar.name.split(":")[0] for bar in finished.bars[:2]] == ["Table 3", "Table 3"]
    with (tmp_path / "out" / "tables" / "table-3.csv").open(encoding="utf-8-sig") as file:
        positions = [row for row in csv.DictReader(file) if row["position"] != "average"]
    assert len(positions) == 3
    for row in positions:
        assert abs(float(row["step: average"])) == pytest.approx(0.2, abs=0.01)
        assert float(row["width: average"]) == pytest.approx(2.0, abs=0.02)
    with (tmp_path / "out" / "tables" / "gage.csv").open(encoding="utf-8-sig") as file:
        gage = {row["quantity"]: row for row in csv.DictReader(file)}
    assert set(gage) == {"height", "step", "width"}
    assert int(gage["height"]["parts"]) == 2
    assert 0 < float(gage["height"]["%GRR of tolerance"]) < 50


@pytest.mark.slow
def test_a_killed_study_goes_on_where_it_stopped(specs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, out, inspected = study(specs, "accuracy"), tmp_path / "out", []

    def inspect(job: object, call: object, last: int = 1) -> object:
        if len(inspected) == last:
            raise KeyboardInterrupt
        inspected.append(job)
        return inspect_scene(job, call)  # type: ignore[arg-type]

    monkeypatch.setattr(workshop, "inspect_scene", inspect)
    with pytest.raises(KeyboardInterrupt):
        run_study(asked, out, InspectionSettings())
    assert not (out / "report.html").exists()
    monkeypatch.setattr(workshop, "inspect_scene", lambda job, call: inspect(job, call, last=99))
    told: list[tuple[int, int]] = []
    run_study(asked, out, InspectionSettings(), on_progress=lambda done, total, _: told.append((done, total)))
    assert len(inspected) == 4
    assert told[0][1] == 4
    assert told[-1] == (4, 4)

    monkeypatch.setattr(workshop.Renderer, "frames", None)  # nothing is rendered a third time
    run_study(asked, out, InspectionSettings())
    assert len(inspected) == 4


def test_another_study_does_not_mix_in(specs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "letter.txt").write_text("mine")
    command = ["study", "accuracy", "--spec", str(specs / "accuracy.toml"), "--out", str(out)]
    assert main(command) == 2
    assert "found something else than a study" in capsys.readouterr().err
    (out / "letter.txt").unlink()
    (out / "study.json").write_text(json.dumps({"format": "flushline-study/1", "study": "real"}))
    assert main(command) == 2
    assert "found another study" in capsys.readouterr().err


def test_a_scan_that_cannot_be_inspected_is_told(
    specs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from metrology.errors import SceneError

    def inspect(job: object, call: object) -> object:
        if job.folder.joinpath("scene.json").read_text().count("S1-true"):  # type: ignore[attr-defined]
            raise SceneError("too dark")
        return inspect_scene(job, call)  # type: ignore[arg-type]

    monkeypatch.setattr(workshop, "inspect_scene", inspect)
    out = tmp_path / "out"
    assert main(["study", "accuracy", "--spec", str(specs / "accuracy.toml"), "--out", str(out)]) == 1
    assert capsys.readouterr().err.count("too dark") == 2
    assert "Not inspected: " in (out / "report.md").read_text()
    assert (out / "tables" / "table-1.csv").exists()


def test_frames_are_the_simulators(simulation: SimulationSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    repeated = replace(simulation, repeats=2, placements=simulation.placements[1:])
    expected = list(simulate(repeated))
    traced = []
    monkeypatch.setattr("flows.study.renderer.set_up", lambda *args: traced.append(1) or simulator_scene.set_up(*args))
    renderer = Renderer()
    for repeat, scene in enumerate(expected):
        frames = renderer.frames(repeated, 0, repeat, lambda _: None)
        np.testing.assert_array_equal(frames["left"], scene.left)
        np.testing.assert_array_equal(frames["right"], scene.right)
    assert traced == [1]
    # Another gamma is the same view in another light, another skin is another view.
    renderer.frames(replace(repeated, projector=replace(repeated.projector, gamma=2.0)), 0, 0, lambda _: None)
    assert traced == [1]
    warm = replace(repeated, disturbances=replace(repeated.disturbances, warming_k=5.0))
    renderer.frames(warm, 0, 0, lambda _: None)
    assert traced == [1, 1]

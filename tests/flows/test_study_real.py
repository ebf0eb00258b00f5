"""What captured scenes tell without truth: here rendered ones, whose truth file is taken away."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from flows.simulate import simulate_folders
from flows.study.planes import Plane, read_planes
from metrology.errors import SpecError
from simulator.spec import parse_spec
from tests.support.small_panel import PLACEMENTS, SEAM, SIMULATION

PLANES = 'format = "flushline-planes/1"\n[[planes]]\nid = "plate"\nregion_px = [5, 10, 60, 200]\n'


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scan from each of two placements, with their rig."""
    folder = tmp_path_factory.mktemp("captured")
    scenes, _ = simulate_folders(parse_spec(SIMULATION + SEAM + PLACEMENTS, "x"), folder)
    for scene in scenes:
        (scene / "truth.json").unlink()
    return folder


@pytest.fixture
def captured(rendered: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    monkeypatch.setenv("PREFECT_HOME", "/nonexistent")
    return Path(shutil.copytree(rendered, tmp_path / "captured"))


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8-sig") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_repeatability_and_flatness(captured: Path, tmp_path: Path) -> None:
    planes = tmp_path / "planes.toml"
    planes.write_text(PLANES)
    out = tmp_path / "out"
    command = ["study", "real", str(captured), "--out", str(out), "--planes", str(planes)]
    assert main(command) == 0
    found = rows(out / "tables" / "rivets-a-small-s1.csv")
    assert len(found) == 2
    for row in found:
        assert row["scans"] == "2"  # both placements have the station of the scene
        assert 0 < float(row["sd, mm"]) < 0.01
    seams = rows(out / "tables" / "seams-a-small-s1.csv")
    assert {row["quantity"] for row in seams} == {"step", "width"}
    assert np.median([float(row["sd, mm"]) for row in seams if row["quantity"] == "step" and row["sd, mm"]]) < 0.01
    flat = rows(out / "tables" / "planes.csv")
    assert len(flat) == 2
    for row in flat:
        assert int(row["points"]) > 5000
        assert 5 < float(row["rms, µm"]) < 40
        assert float(row["bow, µm"]) < 10
        assert float(row["scatter / stated σ"]) == pytest.approx(1, abs=0.25)
    assert "nothing is known of their truth" in (out / "report.md").read_text()

    shutil.rmtree(next(captured.glob("*/left")))  # known scenes are not looked at again
    assert main(command) == 0


def test_a_broken_scene_does_not_stop_the_others(
    captured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(next(captured.glob("*/left")).parent, captured / "broken")
    shutil.rmtree(captured / "broken" / "left")
    scene = captured / "broken" / "scene.json"
    scene.write_text(scene.read_text().replace("2026-11-20", "2026-11-21"))  # a scan of another day
    settings = tmp_path / "settings.toml"
    settings.write_text('[seams]\nedges = "points"\n')  # sooner done
    command = ["study", "real", str(captured), "--out", str(tmp_path / "out"), "--settings", str(settings)]
    assert main(command) == 1
    assert capsys.readouterr().err.count("error:") == 1
    assert rows(tmp_path / "out" / "tables" / "rivets-a-small-s1.csv")[0]["scans"] == "2"


def test_bad_input_is_named(captured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    (captured / "planes.toml").write_text(PLANES.replace("[5, 10, 60, 200]", "[60, 10, 5, 200]"))
    for arguments, words in (
        ([str(empty)], "no scene folder"),
        ([str(captured), "--rig", str(empty / "rig.json")], "rig.json"),
        ([str(captured), "--planes", str(captured / "planes.toml")], "region_px: found [60, 10, 5, 200]"),
    ):
        assert main(["study", "real", *arguments, "--out", str(tmp_path / "out")]) == 2
        complaint = capsys.readouterr().err
        assert complaint.count("error:") == 1
        assert words in complaint
        assert not (tmp_path / "out").exists()


def test_planes_are_checked_key_by_key(tmp_path: Path) -> None:
    path = tmp_path / "planes.toml"
    path.write_text(PLANES)
    assert read_planes(path) == (Plane("plate", (5, 10, 60, 200)),)
    for text, words in (
        (PLANES + "statoin = 'S'", "statoin"),
        (PLANES.replace("planes/1", "plan/1"), "flushline-planes/1"),
    ):
        path.write_text(text)
        with pytest.raises(SpecError, match=words):
            read_planes(path)

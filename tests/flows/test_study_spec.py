"""Specifications of studies: what ships is sound, what is wrong is one line that names it."""

from __future__ import annotations

from pathlib import Path

import pytest

from flows.cli import main
from flows.study.run import blocks_of
from flows.study.spec import parse_study, read_study, shipped_study
from metrology.errors import SpecError

LEAST = 'format = "flushline-study/1"\nstudy = "accuracy"\n[standard_part]\nsimulation = "standard_part"\n'


@pytest.mark.parametrize(
    ("kind", "quick", "scans"),
    # Both rigs inspect the standard part; of the budget noise, vibration and all of them vary.
    [
        ("accuracy", True, 2 * 3), ("accuracy", False, 2 * 10 + 8 + 3 * 3 + 6 * 2),
        ("repeatability", True, 3), ("repeatability", False, 10 + 3 * 3),
    ],
)  # fmt: skip
def test_shipped_studies_are_sound(kind: str, quick: bool, scans: int) -> None:
    study = shipped_study(kind, quick)  # type: ignore[arg-type]
    series = [series for block in blocks_of(study) for series in block.series]
    assert sum(map(len, series)) == scans
    assert len({s.name for s in series}) == len(series)
    keys = [scan.key.scene_id for s in series for rig in s.rigs for scan in s.scans(rig)]
    assert len(set(keys)) == len(keys) == scans


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("format = 3", 'expected "flushline-study/1"'),
        (LEAST.replace("study/1", "panel/1"), 'found format "flushline-panel/1"'),
        (LEAST + "scnas = 3", "standard_part.scnas: found an unknown key"),
        (LEAST + "scans = 1", "standard_part: scans: found 1, expected 2 or more"),
        (LEAST + "scans = 'ten'", "standard_part.scans: found 'ten', expected a whole number"),
        (LEAST + "[calibration]\nposes = 0", "calibration: poses"),
        (LEAST.replace("[standard_part]", "tolerance_mm = 0.0\n[standard_part]"), "tolerance_mm: found 0"),
        (LEAST + "[detection]\nring_levels = []", "detection: ring_levels: found"),
        (LEAST.replace('"accuracy"', '"speed"'), "study: found 'speed'"),
        (LEAST.replace('"accuracy"', '"repeatability"'), "study: found 'repeatability', expected 'accuracy'"),
        (LEAST.replace('"standard_part"', '"nothing"'), "found 'nothing'"),
        (LEAST.replace('"standard_part"', '"nothing.toml"'), r"nothing\.toml"),
        ('format = "flushline-study/1"\nstudy = "accuracy"', "found no block"),
        ("[", "expected TOML"),
    ],
)
def test_mistakes_are_named(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(SpecError, match=message) as caught:
        parse_study(text, tmp_path / "mine.toml", "accuracy")
    assert "\n" not in str(caught.value)


def test_two_rigs_of_one_name_are_refused(tmp_path: Path) -> None:
    scene = 'format = "flushline-simulation/1"\n[scene]\naircraft_serial = "A"\npanel = "P"\nstation = "S"\n'
    scene += 'captured_at = "2026-11-20T08:00:00Z"\n[rig]\nid = "rig"\nseed = '
    for name in ("1", "2"):
        (tmp_path / f"{name}.toml").write_text(scene + name)
    text = LEAST.replace('standard_part"', '1.toml"') + '[budget]\nsimulation = "2.toml"\n'
    with pytest.raises(SpecError, match="found another rig 'rig'"):
        parse_study(text, tmp_path / "mine.toml", "accuracy")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match=r"none\.toml"):
        read_study(tmp_path / "none.toml", "accuracy")


@pytest.mark.parametrize("arguments", [["accuracy", "--spec", "none.toml"], ["real", "nowhere"]])
def test_bad_input_is_one_line_and_leaves_nothing(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    monkeypatch.setenv("PREFECT_HOME", "/nonexistent")
    assert main(["study", *arguments, "--out", "out"]) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("error:") == 1
    assert arguments[-1] in complaint
    assert not (tmp_path / "out").exists()

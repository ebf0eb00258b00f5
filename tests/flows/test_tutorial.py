"""The tutorial, run as it is printed: every command in its order, and what it says of heights is what comes out."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest

from flows.cli import main
from storage.archive import Store

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.slow
def test_the_tutorial_runs_from_a_clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").mkdir()
    shutil.copy(DOCS / "tutorial.toml", tmp_path / "docs")
    page = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    commands = re.findall(r"^flushline (.+)$", page, re.MULTILINE)
    assert [command.split()[0] for command in commands] == [
        "simulate", "calibrate", "inspect", "query", "query", "report", "overlay",
    ]  # fmt: skip
    for command in commands:
        assert main(shlex.split(command)) == 0, command

    folder = tmp_path / "tutorial"
    assert "TUT-0001 FWD-01 S1" in (folder / "report.html").read_text(encoding="utf-8")
    assert (folder / "overlay.png").is_file()
    (truth_file,) = folder.glob("S1-*/truth.json")
    true = sorted(rivet["height_mean_mm"] for rivet in json.loads(truth_file.read_text())["rivets"])
    connection = Store(folder / "store").connect()
    heights = connection.execute("SELECT height_mean_mm, height_u95_mm FROM rivets ORDER BY 1").fetchall()
    (step, width, u95) = connection.execute(
        "SELECT avg(step_mm), avg(width_mm), max(width_u95_mm) FROM seam_stations"
    ).fetchall()[0]
    connection.close()
    assert [height for height, _ in heights] == pytest.approx(true, abs=0.004)
    assert step == pytest.approx(-0.15, abs=0.005)
    assert abs(width - 2.4) < u95
    # What the page says in words.
    (words,) = re.findall(r"The heights are (.+?) mm;", page)
    said = [float(number.replace("−", "-")) for number in re.findall(r"[−+][\d.]+", words)]
    assert [height for height, _ in heights] == pytest.approx(said, abs=0.002)

"""A kind that is declared shows everywhere, and is nowhere taken for a seam; the stores of former versions take it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from metrology.kinds import KINDS

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Where a kind of the tests' own turned up (see third_kind.py)."""
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "tests.support.third_kind",
            str(ROOT / "tests/data"),
            str(tmp_path_factory.mktemp("marks")),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def test_an_old_store_takes_it_and_loses_nothing(found: dict[str, Any]) -> None:
    assert (found["lost before"], found["rows before"], found["lost after"]) == ([], 0, [])


def test_it_is_measured_judged_and_stored(found: dict[str, Any]) -> None:
    # Rivets are measured beside seams: they may begin last.
    named = [step for step in found["steps"] if step != "measure_rivets"]
    after_seams = named[named.index("measure_seams") + 1 :]
    others = [f"measure_{kind.table}" for kind in KINDS if kind.measure and not kind.on_request]
    assert after_seams[: len(others) + 1] == [*others, "measure_test_marks"]
    assert found["decisions"] == [["T1", "fail", "red"], ["T2", "pass", "green"], ["T3", "not measured", None]]
    assert found["in panel"] == [True, True, True]
    assert found["counted"] == {"n_test_marks": 3, "timed": True, "n_rivets": 3, "n_stations": 2}
    assert found["comment"] == ["middle of the mark in the rig frame (left camera), to the right, mm"]
    assert "3 marks (1 fail, 1 pass, 1 not measured)" in found["said"]


def test_it_is_in_views(found: dict[str, Any]) -> None:
    assert found["worst"] == ["T1", "T3"]
    assert found["panel"] == [{"n_test_marks": 3, "n_test_marks_failing": 1, "n_seam_stations": 6}]


def test_it_is_on_the_overlay_and_in_the_report(found: dict[str, Any]) -> None:
    assert "+0.30" in found["overlay"]
    assert "<h2>Marks</h2>" in found["report"]
    assert "T1: +0.3000 mm, fail" in found["report"]
    assert "depth of a test mark, mm" in found["report"]
    assert "Seam T1" not in found["report"]


def test_people_decide_on_it(found: dict[str, Any]) -> None:
    assert found["stand"] == {"T1": "waiting", "T3": "waiting"}
    assert found["decided"] == {"T1": "decided", "T3": "waiting"}


def test_pages_list_it(found: dict[str, Any]) -> None:
    assert found["listed"] == ["T3"]
    assert found["address"]
    assert found["subjects"] == ["depth"]
    assert found["figure"] == ["mark meets the limits", "mark not judged", "mark seriously outside"]
    assert found["required"] == [["depth", 0.1]]
    assert found["trend"] == [0.3]
    assert "T1" in found["worst feature"]

"""`flushline measure`: what is published of the thing that was scanned tells the scale that no scan tells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from metrology.fringe import FringeCode
from metrology.moments import moment_of
from metrology.results import SceneKey
from metrology.rig import Rig
from storage.rig import save_rig
from storage.scene import write_scene
from tests.support.rendered_fringes import PLANE_DISTANCE, PLANE_NORMAL, plane_depth, plane_scan, small_rig


def measured(folder: Path, rig: Rig, *more: str) -> int:
    save_rig(rig, folder / "rig.json")
    return main(["measure", str(folder / "scan"), "--rig", str(folder / "rig.json"), *more])


def test_a_published_distance_tells_a_wrong_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, code = replace(small_rig(), projector=None), FringeCode("x", 4, (13, 12, 11))
    left, right = plane_scan(small_rig(), code, np.random.default_rng(5), 1.0)
    key = SceneKey("A", "P", "S", moment_of("2026-11-01T00:00:00Z"))
    write_scene(tmp_path / "scan", key, "small", code, (1.0,), left, right)
    places = plane_depth(rig.left, PLANE_NORMAL, PLANE_DISTANCE)
    length = float(np.linalg.norm(places[160, 230] - places[90, 110]))
    points = ("--points", "110,90", "230,160")
    assert measured(tmp_path, rig, *points, "--expected", f"{length:.3f}") == 0
    assert f"(stated {length:.3f}".rstrip("0") in capsys.readouterr().out
    assert measured(tmp_path, rig, *points) == 0  # with nothing stated, nothing is judged
    larger = replace(rig, right=replace(rig.with_right(), t=1.01 * rig.with_right().t))
    assert measured(tmp_path, larger, *points, "--expected", f"{length:.3f}") == 1
    assert measured(tmp_path, rig, *points, "--expected", "1", "2") == 2
    assert "found 2 lengths, expected at most 1: point 1 to point 2" in capsys.readouterr().err
    assert measured(tmp_path, rig, "--points", "110,90") == 2
    assert measured(tmp_path, rig, "--board", "chessboard:9x6:25") == 2
    assert "scan" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        measured(tmp_path, rig, "--faces", "1,2,3")
    assert "expected column, row, width, height such as 100,80,60,40" in capsys.readouterr().err

"""`flushline measure`: what is published of the thing that was scanned tells the scale that no scan tells."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from flows.cli import main
from metrology.fringe import FringeCode
from metrology.moments import moment_of
from metrology.results import SceneKey
from metrology.rig import Rig
from storage.rig import save_rig
from storage.scene import write_scene
from tests.support.rendered_fringes import (
    PLANE_DISTANCE,
    PLANE_NORMAL,
    clean_frames,
    plane_depth,
    plane_scan,
    recorded,
    seen_coordinate,
    small_rig,
)


def measured(folder: Path, rig: Rig, *more: str) -> int:
    save_rig(rig, folder / "rig.json")
    return main(["measure", str(folder / "scan"), "--rig", str(folder / "rig.json"), *more])


def refused(folder: Path, rig: Rig, *more: str) -> bool:
    try:
        return measured(folder, rig, *more) == 2
    except SystemExit as left:
        return left.code == 2


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
    with pytest.raises(SystemExit):
        measured(tmp_path, rig, "--points", "nan,90", "230,160")
    for value in ("nan", "-3"):
        assert refused(tmp_path, rig, *points, "--expected", value)
    assert measured(tmp_path, rig, "--points", "110,-20", "230,160") == 2
    assert "found pixel 110,-20, expected a place in the left image of 320×240 pixels" in capsys.readouterr().err
    faces = ("--faces", "60,60,40,40", "180,120,40,40")
    assert measured(tmp_path, rig, *faces, "--expected", "0") in (0, 1)  # whether noise keeps to U95 is another test's
    assert "(stated 0)" in capsys.readouterr().out
    assert measured(tmp_path, rig, "--faces", "60,-50,40,10", "180,120,40,40") == 2
    assert "found the box 60,-50,40,10, expected a place in the left image" in capsys.readouterr().err


def grained_scan(folder: Path) -> None:
    """The plane with a grain of some millimetres, the same in both cameras."""
    rig, code, rng = small_rig(), FringeCode("x", 4, (13, 12, 11)), np.random.default_rng(5)
    waves = [(rng.normal(0, 0.7, 2), rng.uniform(0, 6.3)) for _ in range(40)]  # radians per millimetre
    views: list[NDArray[np.uint8]] = []
    for device in (rig.left, rig.with_right()):
        points = plane_depth(device, PLANE_NORMAL, PLANE_DISTANCE)
        grain = np.mean([np.sin(points[..., :2] @ along + phase) for along, phase in waves], axis=0)
        seen = seen_coordinate(rig, points, "x")
        clean = clean_frames(np.nan_to_num(seen), code, 320, 100 + 60 * grain, 60.0)
        views.append(recorded(np.where(np.isfinite(seen), clean, 4.0), rng, 1.0))
    key = SceneKey("A", "P", "S", moment_of("2026-11-01T00:00:00Z"))
    write_scene(folder, key, "small", code, (1.0,), views[0], views[1])


def test_a_check_says_what_two_cameras_would_not_show(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_rig(replace(small_rig(), projector=None), tmp_path / "rig.json")
    save_rig(small_rig(), tmp_path / "whole.json")
    grained_scan(tmp_path / "scan")
    assert main(["rig", "check", str(tmp_path / "rig.json"), str(tmp_path / "scan")]) == 0
    said = capsys.readouterr().out
    assert ": ok;" in said
    assert "not shown by this scan: a yaw below" in said
    assert "a wrong distance between the cameras (all lengths); flushline measure tells" in said
    assert main(["rig", "check", str(tmp_path / "whole.json"), str(tmp_path / "scan")]) == 0
    assert "not shown" not in capsys.readouterr().out


def test_a_check_asks_for_both_cameras(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_rig(small_rig(), tmp_path / "rig.json")
    code = FringeCode("x", 4, (13, 12, 11))
    left, right = plane_scan(small_rig(), code, np.random.default_rng(5), 1.0)
    key = SceneKey("A", "P", "S", moment_of("2026-11-01T00:00:00Z"))
    write_scene(tmp_path / "scan", key, "small", code, (1.0,), left, right)
    manifest = tmp_path / "scan" / "scene.json"
    document = json.loads(manifest.read_text())
    del document["frames"]["right"]
    manifest.write_text(json.dumps(document))
    assert main(["rig", "check", str(tmp_path / "rig.json"), str(tmp_path / "scan")]) == 2
    assert "found no frames of the right camera, expected both cameras'" in capsys.readouterr().err

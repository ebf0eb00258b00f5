"""Cameras alone by commands: from pairs of pictures and from lists of points."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from storage.rig import load_rig
from tests.support.board_pictures import chessboard_pictures
from tests.support.calibration_bench import SIZES, bench_rig, bench_state, see


@pytest.fixture(scope="module")
def seen() -> dict[int, dict[str, np.ndarray]]:
    """Board points and both cameras' pixels by pose, without dots' eccentricity."""
    rig, state = bench_rig(), bench_state(bench_rig())
    rng = np.random.default_rng(3)
    found: dict[int, dict[str, np.ndarray]] = {}
    for sighting in see(state, rng, devices=("left", "right"), dots=False):
        R, t = state.rotations[sighting.pose], state.translations[sighting.pose]
        points = sighting.known @ R[:, :2].T + t
        pixels = rig.devices[sighting.device].project(points) + rng.normal(0, 0.02, (len(points), 2))
        table = found.setdefault(sighting.pose, {})
        table[f"{sighting.device} index"], table[sighting.device] = sighting.index, pixels
        table[f"{sighting.device} known"] = sighting.known
    for table in found.values():
        _, a, b = np.intersect1d(table["left index"], table["right index"], return_indices=True)
        table["known"] = table["left known"][a]
        table["left"], table["right"] = table["left"][a], table["right"][b]
    return found


def write_csv(seen: dict[int, dict[str, np.ndarray]], path: Path) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["pose", "x_mm", "y_mm", "left_u", "left_v", "right_u", "right_v"])
        for pose, table in seen.items():
            writer.writerows([pose, *row] for row in np.hstack([table["known"], table["left"], table["right"]]))


def write_json(seen: dict[int, dict[str, np.ndarray]], path: Path) -> None:
    names = {"object_points": "known", "imgpoints_left": "left", "imgpoints_right": "right"}
    path.write_text(json.dumps({key: [table[name].tolist() for table in seen.values()] for key, name in names.items()}))


@pytest.mark.parametrize(("write", "name"), [(write_csv, "points.csv"), (write_json, "points.json")])
def test_points_make_a_rig_of_two_cameras(seen, write, name: str, tmp_path: Path, capsys) -> None:  # type: ignore[no-untyped-def]
    write(seen, tmp_path / name)
    size = "x".join(map(str, SIZES["left"]))
    out = tmp_path / "rig.json"
    assert main(["calibrate", str(tmp_path / name), "--points", "--size", size, "--out", str(out), "--id", "two"]) == 0
    assert "reprojection RMS" in capsys.readouterr().out
    rig, truth = load_rig(out), bench_rig()
    assert rig.projector is None
    assert np.linalg.norm(rig.right.centre) == pytest.approx(np.linalg.norm(truth.right.centre), rel=1e-3)
    assert rig.left.K[0, 0] == pytest.approx(truth.left.K[0, 0], rel=1e-3)
    assert (tmp_path / "rig.html").is_file()


def test_what_is_missing_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "points.csv").write_text("pose,x\n1,2\n")
    arguments = [str(tmp_path / "points.csv"), "--points", "--out", str(tmp_path / "rig.json")]
    assert main(["calibrate", *arguments]) == 2
    assert "found no --size" in capsys.readouterr().err
    assert main(["calibrate", *arguments, "--size", "64x48"]) == 2
    assert "expected a CSV with the columns pose, x_mm" in capsys.readouterr().err
    assert (
        main(["calibrate", str(tmp_path), "--pictures", "{camera}_{frame}.jpg", "--out", "x", "--board", "chess"]) == 2
    )
    assert "expected such as chessboard:9x6:25" in capsys.readouterr().err
    alone = ["--pictures", "{frame}.jpg", "--out", "x", "--board", "chessboard:9x6:25"]
    assert main(["calibrate", str(tmp_path), *alone]) == 2
    assert "one camera is calibrated together with its projector (--projector)" in capsys.readouterr().err


def test_pairs_of_pictures_make_a_rig(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chessboard_pictures(tmp_path, 150.0)
    out = tmp_path / "rig.json"
    arguments = ["calibrate", str(tmp_path), "--pictures", "{camera}_{frame}.jpg", "--board", "chessboard:9x6:25"]
    assert main([*arguments, "--out", str(out)]) == 0
    assert "JPEG" in capsys.readouterr().out
    rig = load_rig(out)
    assert np.linalg.norm(rig.right.centre) == pytest.approx(150.0, rel=5e-3)
    assert rig.left.K[0, 0] == pytest.approx(900, rel=5e-3)
    (tmp_path / "right_3.jpg").unlink()
    assert main([*arguments, "--out", str(out)]) == 2
    assert "no picture of the other camera for pose '3'" in capsys.readouterr().err

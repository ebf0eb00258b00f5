"""The page "bring your own rig": its commands that need no pictures run as they are written, from its inputs."""

from __future__ import annotations

import csv
import re
import shlex
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from flows.cli import main
from storage.opencv_rig import save_opencv_rig
from storage.rig import load_rig
from tests.support.calibration_bench import bench_rig, bench_state, see

PAGE = Path(__file__).parents[2] / "docs" / "any-rig.md"
ALONE = ("flushline patterns", "flushline rig import", "flushline calibrate points.csv")


def commands() -> list[str]:
    blocks = re.findall(r"^```\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    return [line for block in blocks for line in block.splitlines() if line.startswith(ALONE)]


def write_points(path: Path) -> None:
    rows: dict[tuple[int, int], dict[str, list[float]]] = {}
    for sighting in see(bench_state(bench_rig()), np.random.default_rng(1), devices=("left", "right"), dots=False):
        for index, known, pixels in zip(sighting.index, sighting.known, sighting.pixels, strict=True):
            rows.setdefault((sighting.pose, int(index)), {"known": list(known)})[sighting.device] = list(pixels)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["pose", "x_mm", "y_mm", "left_u", "left_v", "right_u", "right_v"])
        for (pose, _), row in rows.items():
            if len(row) == 3:
                writer.writerow([pose, *row["known"], *row["left"], *row["right"]])


def write_ros(folder: Path) -> None:
    """A parallel pair, 120 mm apart."""
    for name, shift in (("left", 0.0), ("right", -0.12)):

        def matrix(rows: list[list[float]]) -> dict[str, object]:
            return {"rows": len(rows), "cols": len(rows[0]), "data": [float(v) for row in rows for v in row]}

        K = [[1800.0, 0, 640], [0, 1800.0, 512], [0, 0, 1]]
        document = {
            "image_width": 1280, "image_height": 1024, "camera_name": name, "camera_matrix": matrix(K),
            "distortion_coefficients": matrix([[0.0] * 5]), "rectification_matrix": matrix(np.eye(3).tolist()),
            "projection_matrix": matrix([[1800, 0, 640, 1800 * shift], [0, 1800, 512, 0], [0, 0, 1, 0]]),
        }  # fmt: skip
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(document))


def write_inputs(folder: Path) -> None:
    save_opencv_rig(replace(bench_rig(), projector=None), folder / "stereo.yml")
    write_points(folder / "points.csv")
    write_ros(folder)
    model = folder / "colmap-model"
    model.mkdir()
    (model / "cameras.txt").write_text("1 PINHOLE 1280 1024 1800 1800 640.5 512.5\n")
    (model / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 -1 0 0 1 b.png\n\n")
    storage = cv2.FileStorage(str(folder / "procam.yml"), cv2.FILE_STORAGE_WRITE)
    turn = cv2.Rodrigues(np.radians([0.0, 8.0, 0.0]))[0]
    for name, value in (("cam_K", [[1800.0, 0, 640], [0, 1800.0, 512], [0, 0, 1]]), ("cam_kc", [[0.0] * 5]),
                        ("proj_K", [[1400.0, 0, 512], [0, 1400.0, 500], [0, 0, 1]]), ("proj_kc", [[0.0] * 5]),
                        ("R", turn), ("T", turn @ [[-150.0], [0.0], [0.0]])):  # fmt: skip
        storage.write(name, np.array(value, float))
    storage.release()


def test_the_page_s_commands_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_inputs(tmp_path)
    monkeypatch.chdir(tmp_path)
    run = commands()
    assert len(run) == 10
    for command in run:
        assert main(shlex.split(command)[1:]) == 0, command
        if command.startswith("flushline rig import"):
            assert load_rig(Path("rig.json")).id == "my-rig"

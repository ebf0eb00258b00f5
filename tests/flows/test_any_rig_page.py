"""The page "bring your own rig": its commands run as they are written, from inputs made for them.

Of calibrations from a code on a board, real captures' are; the other one is run alike by tests/flows/test_own_rig.py.
"""

from __future__ import annotations

import csv
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from flows.cli import build_parser, main
from flows.code_options import fringe_model
from metrology.fringe import FringeCode
from storage.opencv_rig import save_opencv_rig
from storage.rig import load_rig, save_rig
from tests.support.board_pictures import chessboard_pictures
from tests.support.calibration_bench import bench_rig, bench_state, see
from tests.support.rendered_fringes import PLANE_DISTANCE, PLANE_NORMAL, plane_depth, seen_coordinate, small_rig
from tests.support.roof_scan import roof_scan

PAGE = Path(__file__).parents[2] / "docs" / "any-rig.md"
REAL = re.compile("box-3freq-8step|procam-graycode")  # captures
ALONE = ("flushline patterns", "flushline rig import", "flushline calibrate points.csv")


def commands() -> list[str]:
    return [line for start in ALONE for line in lines(start)]


def frames_commands() -> list[str]:
    """Those that make, check and inspect scans, in the page's order."""
    starts = ("flushline scene", "flushline capture check", "flushline inspect", "flushline measure")
    return [line for line in lines("flushline ") if line.startswith(starts) and not REAL.search(line)]


def lines(start: str) -> list[str]:
    """The page's commands that begin so, in whatever block."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    return [line for block in blocks for line in block.splitlines() if line.startswith(start)]


def write_frames(command: str) -> None:
    """The frames that a command's pattern and code speak of, with those that it skips."""
    options = build_parser().parse_args(shlex.split(command)[1:])
    code = fringe_model(options).code
    shown = scan(code, 320, ("left", "right") if "{camera}" in options.pattern else ("left",))
    shutil.rmtree("scan", ignore_errors=True)
    called = getattr(options, "labels", None) or options.periods or code.counts
    for camera, frames in shown.items():
        blocks = {"fringes": frames[: code.fringe_frames], "gray": frames[code.fringe_frames :],
                  "white": frames[:0], "black": frames[:0], "skip:1": frames[:1], "skip:10": frames[:10]}  # fmt: skip
        if "white" in (options.sequence or ()):
            blocks |= {"white": frames[-2:-1], "black": frames[-1:], "gray": frames[code.fringe_frames : -2]}
        if options.sequence:
            frames = np.concatenate([blocks[token] for token in options.sequence])
        for time in ("5", "10") if "{exposure}" in options.pattern else ("10",):
            for number, frame in enumerate(frames):
                told = {"camera": camera[0].upper(), "exposure": time, "frame": f"{number:02d}"}
                if "{count}" in options.pattern:
                    told |= {"count": str(called[code.count_of[number]]), "step": str(code.step_of[number])}
                path = Path("scan") / options.pattern.format(**told)
                path.parent.mkdir(parents=True, exist_ok=True)
                assert cv2.imwrite(str(path), (frame * (int(time) / 10)).round().astype(np.uint8))


def scan(code: FringeCode, size: int, cameras: tuple[str, ...]) -> dict[str, NDArray[np.uint8]]:
    """Each camera's frames of a plane before the small rig; patterns are taken between the projector's pixels."""
    rig, rng = small_rig(), np.random.default_rng(5)
    views = {}
    for camera in cameras:
        seen = seen_coordinate(rig, plane_depth(rig.devices[camera], PLANE_NORMAL, PLANE_DISTANCE), "x")
        across = np.nan_to_num(np.gradient(seen, axis=1))
        parts = [np.nan_to_num(seen) + share * across for share in (-0.5, -0.25, 0.0, 0.25, 0.5)]  # a pixel is no point
        taken = [code.lines((part.ravel() + 0.5) / (code.size_px or size)) for part in parts]
        lines = np.mean(taken, axis=0).reshape(-1, *seen.shape)
        levels = np.where(np.isfinite(seen), 30 + 160 * lines, 4) + rng.normal(0, 1.0, lines.shape)
        views[camera] = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    return views


@pytest.mark.slow
def test_the_page_s_scans_are_made_checked_and_inspected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    save_rig(replace(small_rig(), projector=None, id="my-rig"), tmp_path / "rig.json")
    save_rig(replace(small_rig(), right=None, id="my-rig"), tmp_path / "one-camera.json")
    run = frames_commands()
    assert len(run) == 15
    write_frames(next(command for command in run if "--pattern" in command))
    for number, command in enumerate(run):
        if "--pattern" in command:
            write_frames(command)
        store = ["--store", f"store-{number}"] if command.startswith("flushline inspect") else []
        assert main(shlex.split(command)[1:] + store) == 0, command


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
    K = np.array([[1800.0, 0, 640], [0, 1800.0, 512], [0, 0, 1]])
    storage = cv2.FileStorage(str(folder / "procam.yml"), cv2.FILE_STORAGE_WRITE)
    turn = cv2.Rodrigues(np.radians([0.0, 8.0, 0.0]))[0]
    for name, value in (("cam_K", K), ("cam_kc", [[0.0] * 5]),
                        ("proj_K", [[1400.0, 0, 512], [0, 1400.0, 500], [0, 0, 1]]), ("proj_kc", [[0.0] * 5]),
                        ("R", turn), ("T", turn @ [[-150.0], [0.0], [0.0]])):  # fmt: skip
        storage.write(name, np.array(value, float))
    storage.release()
    (folder / "matrices").mkdir()
    beside = np.array([[-120.0], [0.0], [0.0]])
    none = np.zeros((1, 5))
    for name, value in (("K_left", K), ("K_right", K), ("dist_left", none), ("dist_right", none), ("R", np.eye(3)),
                        ("T", beside)):  # fmt: skip
        np.savetxt(folder / "matrices" / f"{name}.txt", value)
    for name, shift in (("P1", 0 * beside), ("P2", beside)):
        np.savetxt(folder / f"{name}.txt", K @ np.column_stack([np.eye(3), shift]))


def test_the_page_s_commands_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_inputs(tmp_path)
    monkeypatch.chdir(tmp_path)
    run = commands()
    assert len(run) == 14
    for command in run:
        assert main(shlex.split(command)[1:]) == 0, command
        if command.startswith("flushline rig import"):
            assert load_rig(Path("rig.json")).id == "my-rig"


@pytest.mark.slow
def test_cameras_and_projector_are_found_as_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Pairs of pictures; then scans of two stations, of a rig with a projector of the size that the page names."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pictures").mkdir()
    chessboard_pictures(tmp_path / "pictures", 150.0, "png")
    (pictures,) = lines("flushline calibrate pictures")
    assert main(shlex.split(pictures)[1:]) == 0
    for pose in re.findall(r"warning: pose (\d)", said := capsys.readouterr().out):
        assert f"note: pose {pose} is left_{pose}.png" in said
    small = small_rig()
    beam = small.with_projector().K * np.array([[4.0], [4.0], [1.0]])
    rig = replace(small, projector=replace(small.with_projector(), width=1280, height=800, K=beam))
    save_rig(replace(rig, projector=None), tmp_path / "rig.json")
    for number, apart in ((1, 0.0), (2, 90.0)):
        roof_scan(tmp_path / f"scan-{number}", rig, "x", apart, f"S{number}")
    (fit,) = lines("flushline rig fit-projector")
    assert main(shlex.split(fit)[1:]) == 0
    found, true = load_rig(tmp_path / "whole.json").with_projector(), rig.with_projector()
    np.testing.assert_allclose(found.centre[[0, 2]], true.centre[[0, 2]], atol=1.0)  # its rows are assumed
    assert found.K[0, 0] == pytest.approx(true.K[0, 0], rel=1e-3)


@pytest.mark.slow
def test_real_captures_become_scenes_as_the_page_says(
    shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("box-3freq-8step", "procam-graycode"):
        shutil.copytree(shared / "real" / name, tmp_path / name)
    run = [line for line in lines("flushline ") if REAL.search(line)]
    assert len(run) == 7
    for command in run:
        assert main(shlex.split(command)[1:]) == 0, command
    said = capsys.readouterr().out
    assert said.count("phase offset 0 rad") == 2
    assert "3 of 3 poses" in said


def test_every_command_of_the_page_is_run() -> None:
    known = {*commands(), *frames_commands(), *filter(REAL.search, lines("flushline "))}
    known |= {*lines("flushline calibrate pictures"), *lines("flushline rig fit-projector")}
    assert [line for line in lines("flushline ") if line not in known] == [
        "flushline calibrate raw --pictures '{camera}/{pose}/{frame}.png' --board charuco:14x10:20:15:DICT_5X5_100 "
        "--projector 1280x800 --periods 16 18 21 --out rig.json"
    ]

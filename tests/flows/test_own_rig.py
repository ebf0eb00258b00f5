"""From a box of parts: a code on a board calibrates, a capture is checked, scans find the projector."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from flows.cli import build_parser, main
from flows.code_options import both_fringe_models
from flows.fit_projector import describe_fit
from metrology.calibration.projector_fit import FittedProjector
from metrology.fringe import GrayCode
from metrology.rig import Device, Rig
from storage.rig import load_rig, save_rig
from tests.support.rendered_fringes import small_rig
from tests.support.roof_scan import roof_scan

PAGE = Path(__file__).parents[2] / "docs" / "any-rig.md"
WHEN = "2026-11-01T00:00:00Z"


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


# A chessboard before one camera and a projector.
COLS, ROWS, SQUARE = 8, 6, 20.0
BEAM = (256, 192)
CAMERA = Device(
    480, 360, np.array([[620.0, 0, 241.3], [0, 622.0, 178.2], [0, 0, 1]]), np.zeros(5), np.eye(3), np.zeros(3)
)
TILTS = ((0, 12, 3), (22, 0, -9), (-20, 18, 14), (15, -25, -4), (-15, -12, 10))


def lamp() -> Device:
    turn = np.asarray(cv2.Rodrigues(np.radians([2.0, 14.0, 1.0]))[0])
    K = np.array([[330.0, 0, 127.5], [0, 330.0, 150.0], [0, 0, 1]])
    return Device(*BEAM, K, np.zeros(5), turn, -turn @ np.array([120.0, 15.0, 10.0]))


def board_and_light(pose: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(h, w) reflectance and (h, w, 2) projector pixels of what the camera sees of a pose."""
    R = np.asarray(cv2.Rodrigues(np.radians(np.array(TILTS[pose], float)))[0])
    wide, tall = (COLS - 1) * SQUARE, (ROWS - 1) * SQUARE
    t = np.array([8.0 * (pose % 3 - 1), 6.0 * (pose % 2), 420.0 + 15 * pose]) - R @ np.array([wide / 2, tall / 2, 0])
    fine = 3
    v, u = (np.mgrid[: fine * CAMERA.height, : fine * CAMERA.width] + 0.5) / fine - 0.5
    rays = CAMERA.rays(np.stack([u, v], -1))
    points = rays * ((R[:, 2] @ t) / (rays @ R[:, 2]))[..., None]
    x, y = np.moveaxis((points - t) @ R[:, :2], -1, 0)
    white = (np.floor(x / SQUARE) + np.floor(y / SQUARE)) % 2 == 0
    on = (x > -SQUARE) & (x < wide + SQUARE) & (y > -SQUARE) & (y < tall + SQUARE)
    grey = np.where(on, np.where(white, 0.9, 0.15), 0.6)

    def binned(image: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(cv2.resize(image, (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_AREA))

    return binned(grey), binned(lamp().project(points))


def code_on_board(folder: Path) -> None:
    rng = np.random.default_rng(3)
    for pose in range(len(TILTS)):
        grey, light = board_and_light(pose)
        frames = []
        for along, stripes in enumerate(BEAM):
            position = (light[..., along] + 0.5) / stripes
            frames += list(GrayCode(stripes, True).lines(position.ravel()).reshape(-1, *position.shape))
        frames += [np.ones_like(grey), np.zeros_like(grey)]
        (folder / f"capture_{pose}").mkdir(parents=True)
        for number, frame in enumerate(frames):
            level = grey * (12 + 200 * cv2.GaussianBlur(frame, (0, 0), 0.5)) + rng.normal(0, 0.8, grey.shape)
            cv2.imwrite(
                str(folder / f"capture_{pose}" / f"graycode_{number:02d}.png"),
                np.clip(level, 0, 255).round().astype(np.uint8),
            )


@pytest.mark.slow
def test_fringes_on_a_charuco_board_calibrate_two_cameras_and_a_projector(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command of the page "bring your own rig", as it is written there."""
    (command,) = (line for line in PAGE.read_text(encoding="utf-8").splitlines() if "calibrate raw" in line)
    words = shlex.split(command)[1:]
    codes = both_fringe_models(build_parser().parse_args(words))
    kind = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    printed = cv2.aruco.CharucoBoard((14, 10), 20.0, 15.0, kind).generateImage((14 * 160, 10 * 160)) / 255.0
    rig, rng = fringes_rig(), np.random.default_rng(4)
    monkeypatch.chdir(tmp_path)
    for pose, tilt in enumerate(TILTS[:4]):
        for name, camera in rig.cameras.items():
            grey, light = printed_and_light(camera, rig.with_projector(), printed, 160 / 20.0, pose, tilt)
            along_x, along_y = np.moveaxis(light + 0.5, -1, 0) / np.reshape([1280, 800], (2, 1, 1))
            lines = [codes["x"].code.lines(along_x.ravel()), codes["y"].code.lines(along_y.ravel())]
            frames = np.concatenate(lines).reshape(-1, *grey.shape)
            level = grey * (10 + 190 * frames) + rng.normal(0, 0.8, frames.shape)
            (folder := tmp_path / "raw" / name / str(pose)).mkdir(parents=True)
            for number, frame in enumerate(np.clip(level, 0, 255).round().astype(np.uint8)):
                cv2.imwrite(str(folder / f"{number:02d}.png"), frame)
    assert main(words) == 0
    assert "4 of 4 poses" in capsys.readouterr().out
    found = load_rig(tmp_path / "rig.json")
    for name, true in rig.devices.items():
        assert found.devices[name].K[0, 0] == pytest.approx(true.K[0, 0], rel=3e-3), name
        assert np.linalg.norm(found.devices[name].centre - true.centre) < 1.5, name


def fringes_rig() -> Rig:
    """Two cameras and a projector of 1280 × 800 pixels that look at a board half a metre away."""

    def device(width: int, height: int, focal: float, centre: list[float], yaw: float) -> Device:
        turn = np.asarray(cv2.Rodrigues(np.radians([0.0, yaw, 0.0]))[0]).T
        K = np.array([[focal, 0, width / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1]])
        return Device(width, height, K, np.zeros(5), turn, -turn @ np.array(centre))

    left, right = device(512, 384, 720.0, [0, 0, 0], 0.0), device(512, 384, 724.0, [140.0, 0, 0], -15.0)
    return Rig("true", WHEN, left, right, device(1280, 800, 1500.0, [70.0, 10.0, 0], -7.0))


def printed_and_light(
    camera: Device, projector: Device, printed: NDArray[np.float64], per_mm: float, pose: int, tilt: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(h, w) reflectance and (h, w, 2) projector pixels of what a camera sees of a printed board."""
    R = np.asarray(cv2.Rodrigues(np.radians(0.8 * np.array(tilt)))[0])
    middle = np.array([printed.shape[1], printed.shape[0], 0.0]) / per_mm / 2
    t = np.array([8.0 * (pose % 3 - 1), 6.0 * (pose % 2), 500.0 + 15 * pose]) - R @ middle
    fine = 2
    v, u = (np.mgrid[: fine * camera.height, : fine * camera.width] + 0.5) / fine - 0.5
    rays = camera.rays(np.stack([u, v], -1))
    normal, origin = R[:, 2], camera.centre
    points = origin + rays * ((normal @ (t - origin)) / (rays @ normal))[..., None]
    at = ((points - t) @ R[:, :2] * per_mm - 0.5).astype(np.float32)
    grey = cv2.remap(printed.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=0.8)
    size = (camera.width, camera.height)
    grey = cv2.resize(grey * 0.8 + 0.1, size, interpolation=cv2.INTER_AREA).astype(float)
    return grey, np.asarray(cv2.resize(projector.project(points), size, interpolation=cv2.INTER_AREA))


def test_a_code_on_a_board_calibrates_one_camera_and_a_projector(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code_on_board(tmp_path / "raw")
    out = tmp_path / "rig.json"
    arguments = ["calibrate", tmp_path / "raw", "--pictures", "capture_{pose}/graycode_{frame}.png"]
    arguments += ["--board", f"chessboard:{COLS}x{ROWS}:{SQUARE}", "--inverse", "--out", out]
    assert run(*arguments, "--projector", f"{BEAM[0]}x{BEAM[1]}", "--gray", *BEAM) == 0
    said = capsys.readouterr().out
    assert "5 of 5 poses" in said
    found = load_rig(out)
    assert found.right is None
    assert found.with_projector().K[0, 0] == pytest.approx(330, rel=5e-3)
    assert found.left.K[0, 0] == pytest.approx(620, rel=5e-3)
    assert np.linalg.norm(found.with_projector().centre - lamp().centre) < 3
    assert run(*arguments, "--projector", "256x192", "--gray", 1024, 192) == 2  # ten bits along x
    assert "found 34 frames, expected 38: x y white black" in capsys.readouterr().err
    assert run(*arguments, "--projector", "256x192", "--gray", *BEAM, "--sequence", "x", "skip:18") == 2
    assert "no y" in capsys.readouterr().err


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    """A rig file without a projector; scans along x and y of a station, and along x of another one."""
    folder = tmp_path_factory.mktemp("own")
    save_rig(replace(small_rig(), projector=None), folder / "cameras.json")
    stations = (("x1", "x", 0.0, "S1"), ("y1", "y", 0.0, "S1"), ("x2", "x", 90.0, "S2"))
    made = [roof_scan(folder / name, small_rig(), axis, apart, station) for name, axis, apart, station in stations]
    return folder / "cameras.json", made


def test_scans_find_the_projector(
    scans: tuple[Path, list[Path]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras, folders = scans
    out = tmp_path / "rig.json"
    assert run("rig", "fit-projector", *folders, "--rig", cameras, "--out", out) == 2
    assert "--size WxH" in capsys.readouterr().err
    assert run("rig", "fit-projector", *folders, "--rig", cameras, "--size", "320x240", "--out", out) == 0
    assert "focal length" in capsys.readouterr().out
    found, true = load_rig(out), small_rig().with_projector()
    assert found.screen is not None
    assert np.linalg.norm(found.with_projector().centre - true.centre) < 5
    points = np.array([[x, y, 690.0 + x / 4] for x in (-80, 0, 80) for y in (-60, 0, 60)])
    assert np.abs(found.with_projector().project(points) - true.project(points)).max() < 0.5
    assert run("rig", "check", out, folders[0]) == 0
    assert run("rig", "fit-projector", folders[1], "--rig", cameras, "--size", "320x240", "--out", out) == 2
    assert "fringes along x of the same station before it" in capsys.readouterr().err


@pytest.mark.parametrize(("height", "told"), [(1.0, False), (4 / 3, True)])
def test_pixels_that_are_no_squares_are_told(height: float, told: bool) -> None:
    """As where 768 rows were said to be what the code's 1024 are."""
    true = small_rig().with_projector()
    device = replace(true, K=np.diag([1, 1 / height, 1]) @ true.K)
    sigma = dict.fromkeys(("fx", "fy", "cx", "cy"), 0.1)
    lines = describe_fit(FittedProjector(device, sigma, 0.01, 500, (), (), None, 0.1, 0.0))
    assert any("pixels are 1.33" in line and "--over, --periods" in line for line in lines) == told


def test_columns_alone_are_no_screen(
    scans: tuple[Path, list[Path]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras, (first, _, second) = scans
    out = tmp_path / "rig.json"
    assert run("rig", "fit-projector", first, second, "--rig", cameras, "--size", "320x240", "--out", out) == 0
    assert "rows are assumed" in capsys.readouterr().out
    found = load_rig(out)
    assert found.projector is not None
    assert found.screen is None


def test_another_rigs_projector_is_the_culprit(
    scans: tuple[Path, list[Path]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras, folders = scans
    moved = small_rig().with_projector()
    other = replace(small_rig(), id="elsewhere", projector=replace(moved, t=moved.t + np.array([6.0, 0.0, 0.0])))
    save_rig(other, tmp_path / "other.json")
    assert run("rig", "export", tmp_path / "other.json", "--out", tmp_path / "cv.json") == 0
    left, right = small_rig().left, small_rig().with_right()
    np.savez(
        tmp_path / "stereo.npz", K1=left.K, D1=left.distortion, K2=right.K, D2=right.distortion, R=right.R, T=right.t,
        image_size=np.array([320, 240]),
    )  # fmt: skip
    mixed = tmp_path / "mixed.json"
    taken = ("--projector-of", tmp_path / "other.json")
    assert run("rig", "import", tmp_path / "stereo.npz", "--id", "mixed", "--out", mixed, *taken) == 0
    run("rig", "check", mixed, folders[0])
    said = capsys.readouterr().out
    assert "the projector was taken from rig 'elsewhere'" in said
    assert cameras.is_file()


def test_a_capture_is_checked(
    scans: tuple[Path, list[Path]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, folders = scans
    assert run("capture", "check", folders[0]) == 0
    assert "left: lit" in capsys.readouterr().out
    assert run("capture", "check", tmp_path) == 2
    assert "found no scene.json" in capsys.readouterr().err
    names = ("--pattern", "{camera}/e0_c{count}_s{step}.png", "--counts", 13, 12, 11)
    assert run("capture", "check", folders[0], *names) == 0

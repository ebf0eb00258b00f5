"""Scans of other programs by commands alone: names, conventions, rigs without a projector."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from flows.cli import main
from flows.contact_sheet import residuals
from metrology.fringe import FringeCode, GrayCode
from metrology.one_camera import triangulate_one
from metrology.reconstruct import decode
from storage.rig import load_rig, save_rig
from storage.scene import load_scene
from tests.support.other_programs import measured, save, scan
from tests.support.rendered_fringes import PLANE_DISTANCE, PLANE_NORMAL, small_rig


def run(*arguments: str | Path) -> int:
    return main([str(argument) for argument in arguments])


COUNTS = [f"{{camera}}/f{count}_{step}.png" for count in (7, 6, 5) for step in range(4)]
SINGLE = [f"{{camera}}_{number}.png" for number in range(40)]


@pytest.mark.parametrize(
    ("code", "sign", "names", "arguments", "said"),
    [
        (
            FringeCode("x", 4, (7, 6, 5), None, (-np.pi / 2,) * 3), 1, COUNTS,
            ("--pattern", "{camera}/f{count}_{step}.png", "--counts", "7", "6", "5"), "phase offset -1.571 rad",
        ),
        (
            FringeCode("x", 4, (16,), GrayCode(16, True, shift=0.3)), -1, SINGLE,
            ("--pattern", "{camera}_{frame}.png", "--counts", "16", "--gray", "16", "--inverse"), "steps backward",
        ),
        (
            FringeCode("x", 4, (16,), GrayCode(32, False, True, shift=0.5)), 1, SINGLE,
            ("--pattern", "{camera}_{frame}.png", "--counts", "16", "--gray", "32", "--references"), "+0.5",
        ),
        (
            FringeCode("x", 0, (), GrayCode(160, True)), 1, SINGLE,
            ("--pattern", "{camera}_{frame}.png", "--counts", "--gray", "160", "--inverse"), "from the coarsest",
        ),
    ],
    ids=["sine", "backward", "borders between", "stripes alone"],
)  # fmt: skip
def test_a_scene_is_made_of_names_and_measures(
    code: FringeCode, sign: int, names: list[str], arguments: tuple[str, ...], said: str,
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    folder = save(tmp_path, scan(code, sign), names[: code.frames])
    assert run("scene", "new", folder, *arguments, "--rig", "small") == 0
    assert said in capsys.readouterr().out
    assert (folder / "contact-sheet.png").is_file()
    off = measured(folder)
    assert len(off) > 0.25 * 320 * 240
    assert abs(np.median(off)) < 0.1
    assert np.quantile(np.abs(off), 0.99) < (3.0 if not code.counts else 1.5)
    assert run("scene", "guess", folder) == 0
    assert "agreement" in capsys.readouterr().out


def test_bits_from_the_finest_on_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = FringeCode("x", 4, (16,), GrayCode(32, False, False))
    views = {camera: np.concatenate([frames[:4], frames[:3:-1]]) for camera, frames in scan(code).items()}
    folder = save(tmp_path, views, SINGLE[: code.frames])
    arguments = ("--pattern", "{camera}_{frame}.png", "--counts", "16", "--gray", "32")
    assert run("scene", "new", folder, *arguments, "--rig", "small") == 0
    assert "from the finest bit on" in capsys.readouterr().out
    assert np.quantile(np.abs(measured(folder)), 0.99) < 1.5


def test_inverses_that_come_first_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = FringeCode("x", 4, (16,), GrayCode(32, True))
    turned = [*range(4), *(4 + (i ^ 1) for i in range(10))]
    views = {camera: frames[turned] for camera, frames in scan(code).items()}
    folder = save(tmp_path, views, SINGLE[: code.frames])
    arguments = ("--pattern", "{camera}_{frame}.png", "--counts", "16", "--gray", "32", "--inverse")
    assert run("scene", "new", folder, *arguments, "--rig", "small") == 0
    assert "each bit's inverse first" in capsys.readouterr().out
    assert json.loads((folder / "scene.json").read_text())["fringe"]["gray"]["inverse_first"]
    assert np.quantile(np.abs(measured(folder)), 0.99) < 1.5


def test_stripes_finer_than_the_camera_are_left_aside(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = FringeCode("x", 0, (), GrayCode(1024, True))
    rng = np.random.default_rng(4)
    views = {}
    for camera, frames in scan(code).items():
        blurred = np.stack([cv2.GaussianBlur(frame.astype(np.float32), (0, 0), 1.2) for frame in frames])
        clipped = 1.4 * blurred  # bright stripes at the end of the range: a frame and its inverse still cross
        views[camera] = np.clip(np.rint(clipped + rng.normal(0, 1, blurred.shape)), 0, 255).astype(np.uint8)
    folder = save(tmp_path, views, SINGLE[: code.frames])
    arguments = ("--pattern", "{camera}_{frame}.png", "--counts", "--gray", "1024", "--inverse")
    assert run("scene", "new", folder, *arguments, "--rig", "small") == 0
    off = measured(folder)
    assert len(off) > 0.2 * 320 * 240
    assert np.quantile(np.abs(off), 0.95) < 3


def test_several_exposures_are_told_by_their_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    views = scan(FringeCode("x", 4, (7, 6, 5)))
    for time in (5, 10):
        darker = {
            camera: (frames.astype(float) * time / 10).round().astype(np.uint8) for camera, frames in views.items()
        }
        save(tmp_path, darker, [f"t{time}/{name}" for name in COUNTS])
    arguments = ("--pattern", "t{exposure}/{camera}/f{count}_{step}.png", "--counts", "7", "6", "5", "--rig", "small")
    assert run("scene", "new", tmp_path, *arguments) == 0
    assert json.loads((tmp_path / "scene.json").read_text())["exposures"] == [5.0, 10.0]
    assert np.quantile(np.abs(measured(tmp_path)), 0.99) < 1.5
    assert run("scene", "new", tmp_path, *arguments, "--exposures", "3") == 2
    assert "found 1 times of the exposures 5, 10, expected 2" in capsys.readouterr().err
    assert run("capture", "check", tmp_path) == 0


def test_one_count_without_gray_code_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("patterns", "--out", tmp_path, "--counts", "64") == 2
    assert "found 64 alone, whose fringes nothing tells apart" in capsys.readouterr().err


def test_wrong_declarations_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = save(tmp_path, scan(FringeCode("x", 4, (7, 6, 5))), COUNTS)
    pattern = ("--pattern", "{camera}/f{count}_{step}.png", "--rig", "small")
    assert run("scene", "new", folder, *pattern, "--counts", "9", "8", "5", "--labels", "7", "6", "5") == 2
    assert "contradict each other" in capsys.readouterr().err
    assert run("scene", "new", folder, *pattern, "--counts", "7", "6") == 2
    assert "found the counts 5, 6, 7, expected 2" in capsys.readouterr().err
    assert run("scene", "new", folder, "--pattern", "{cam}/x.png", "--rig", "small") == 2
    assert "found {cam}, expected camera" in capsys.readouterr().err
    (folder / "R" / "f6_2.png").unlink()
    assert run("scene", "new", folder, *pattern, "--counts", "7", "6", "5") == 2
    assert "count 6: found 3 steps (0, 1, 3), expected 4" in capsys.readouterr().err
    assert not (folder / "scene.json").exists()


def test_names_that_tell_no_order_are_put_in_order_by_the_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [f"{{camera}}/{label}_{step * 90}.png" for label in ("high", "mid", "low") for step in range(4)]
    folder = save(tmp_path, scan(FringeCode("x", 4, (7, 6, 1))), names)
    arguments = ("--pattern", "{camera}/{count}_{step}.png", "--counts", "7", "6", "1", "--rig", "small")
    assert run("scene", "new", folder, *arguments) == 2
    assert "they agree with --labels high mid low" in capsys.readouterr().err
    assert run("scene", "new", folder, *arguments, "--labels", "high", "mid", "low") == 0


def test_periods_name_the_counts_and_are_over_what_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert small_rig().with_projector().width == 320
    names = [f"p{period}/{{camera}}{step:02d}.png" for period in (48, 36, 32) for step in range(4)]
    folder = save(tmp_path, scan(FringeCode("x", 4, (6, 8, 9), size_px=288)), names)
    arguments = ("--pattern", "p{count}/{camera}{step}.png", "--rig", "small")
    assert run("scene", "new", folder, *arguments, "--periods", "48", "36", "32", "--over", "288") == 0
    assert "left: 'L', 12 frames from L00.png to L03.png" in capsys.readouterr().out
    assert json.loads((folder / "scene.json").read_text())["fringe"]["counts"] == [6, 8, 9]
    assert run("scene", "new", folder, *arguments, "--periods", "48", "--gray", "12") == 2
    assert "found --over nowhere, expected a multiple of the periods" in capsys.readouterr().err


def test_frames_too_many_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = save(tmp_path, scan(FringeCode("x", 4, (7, 6, 5))), [f"{{camera}}{i:03d}.png" for i in range(12)])
    for camera in "LR":
        cv2.imwrite(str(folder / f"{camera}012.png"), np.full((240, 320), 190, np.uint8))
    arguments = ("--pattern", "{camera}{frame}.png", "--counts", "7", "6", "5", "--rig", "small")
    assert run("scene", "new", folder, *arguments) == 2
    assert "found 13 frames, from L000.png to L012.png, expected 12" in capsys.readouterr().err
    assert run("scene", "new", folder, *arguments, "--sequence", "fringes", "white") == 0


def test_a_contact_sheet_shows_where_frames_do_not_bear_out_what_was_decoded() -> None:
    code, rng = FringeCode("x", 4, (7, 6, 5), GrayCode(64)), np.random.default_rng(2)
    truth = 4 + np.arange(300.0) * np.ones((40, 1))
    frames = (
        100
        + 80 * (2 * code.lines((truth.ravel() + 0.5) / 320).reshape(-1, 40, 300) - 1)
        + rng.normal(0, 2, (code.frames, 40, 300))
    )
    frames[5, :, 100:120] = 100
    off = residuals(frames, np.where(truth < 290, truth, np.nan), code, 320)
    assert 0.015 < np.nanmedian(off) < 0.04
    assert np.median(off[:, 100:120]) > 0.1
    assert np.isnan(off[:, 288:]).all()


def test_a_step_that_was_shown_twice_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = FringeCode("x", 4, (16,), GrayCode(32, True))
    views = scan(code)
    arguments = ("--pattern", "{camera}_{frame}.png", "--counts", "16", "--gray", "32", "--inverse", "--rig", "small")
    folder = save(tmp_path / "sound", views, SINGLE[: code.frames])
    assert run("scene", "new", folder, *arguments) == 0
    assert "will be refused" not in capsys.readouterr().out
    rng = np.random.default_rng(1)
    for frames in views.values():  # the projector showed the first step once more in place of the fourth
        frames[3] = np.clip(frames[0] + rng.integers(-2, 3, frames[0].shape), 0, 255)
    folder = save(tmp_path / "twice", views, SINGLE[: code.frames])
    assert run("scene", "new", folder, *arguments) == 0
    assert "note: these frames will be refused: " in (said := capsys.readouterr().out)
    assert all(name in said for name in ("L_3.png", "R_3.png")), said


def test_colour_becomes_grey_with_a_note(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    views = {camera: np.repeat(f[..., None], 3, -1) for camera, f in scan(FringeCode("x", 4, (7, 6, 5))).items()}
    folder = save(tmp_path, views, COUNTS)
    arguments = ("--pattern", "{camera}/f{count}_{step}.png", "--counts", "7", "6", "5")
    assert run("scene", "new", folder, *arguments, "--rig", "small") == 0
    assert "colour was turned to grey" in capsys.readouterr().out
    assert np.quantile(np.abs(measured(folder)), 0.99) < 1.5


def test_every_code_of_patterns_is_one_that_scenes_accept(tmp_path: Path) -> None:
    for arguments in (
        ["--periods", "16", "18", "21"],
        ["--counts", "1", "8", "64", "--steps", "3", "4", "8", "--offset", "0.5"],
        ["--counts", "32", "--gray", "64", "--lsb", "--inverse", "--references", "--direction", "-1"],
        ["--counts", "--gray", "160"],
        ["--counts", "--gray", "160", "--inverse-first", "--references"],
    ):
        out = tmp_path / "-".join(arguments)
        assert run("patterns", "--out", out, "--size", "320", "8", *arguments) == 0
        assert "axis" in json.loads((out / "fringe.json").read_text())
        assert len(list(out.glob("*.png"))) > 8


def test_a_rig_without_projector_inspects_by_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_rig(replace(small_rig(), projector=None), tmp_path / "small.json")
    assert load_rig(tmp_path / "small.json").projector is None
    folder = save(tmp_path / "scan", scan(FringeCode("x", 4, (7, 6, 5))), COUNTS)
    arguments = ("--pattern", "{camera}/f{count}_{step}.png", "--counts", "7", "6", "5")
    assert run("scene", "new", folder, *arguments, "--rig", "small", "--captured-at", "2026-11-01T00:00:00Z") == 0
    assert run("inspect", folder, "--rig", tmp_path / "small.json", "--store", tmp_path / "store") == 0
    said = capsys.readouterr()
    assert "no calibrated projector" in said.out + said.err


def test_fringes_along_the_line_between_the_cameras_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_rig(replace(small_rig(), projector=None), tmp_path / "small.json")
    views, v = {}, np.arange(240.0)[:, None] * np.ones((240, 320))
    code = FringeCode("x", 4, (7, 6, 5))
    for camera in ("left", "right"):
        lines = code.lines((v.ravel() + 40) / 320).reshape(-1, 240, 320)
        noise = np.random.default_rng(len(camera)).normal(0, 1.5, lines.shape)
        views[camera] = np.clip(30 + 160 * lines + noise, 0, 255).astype(np.uint8)
    folder = save(tmp_path / "scan", views, COUNTS)
    arguments = ("--pattern", "{camera}/f{count}_{step}.png", "--counts", "7", "6", "5", "--rig", "small")
    assert run("scene", "new", folder, *arguments) == 0
    assert "the coordinate changes down the image" in capsys.readouterr().out
    assert run("inspect", folder, "--rig", tmp_path / "small.json", "--store", tmp_path / "store") == 2
    assert "most likely these are of axis 'y'" in capsys.readouterr().err


def test_what_one_camera_cannot_tell_of_the_steps_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_rig(replace(small_rig(), right=None), tmp_path / "one.json")
    code = FringeCode("x", 4, (1, 4, 16), None, (0.3,) * 3)
    folder = save(
        tmp_path / "scan", {"left": scan(code, -1)["left"]}, [f"f{n}_{i}.png" for n in (1, 4, 16) for i in range(4)]
    )
    arguments = ("--pattern", "f{count}_{step}.png", "--counts", "1", "4", "16", "--rig", "small")
    assert run("scene", "new", folder, *arguments) == 2
    assert "agree with the phase offsets" in capsys.readouterr().err
    assert run("scene", "new", folder, *arguments, "--offset", "-0.3") == 0
    inspect = ("inspect", folder, "--rig", tmp_path / "one.json", "--store", tmp_path / "store")
    assert run(*inspect) == 2
    assert "most likely the steps were shown backward" in capsys.readouterr().err
    assert run("scene", "new", folder, *arguments, "--offset", "0.3", "--direction", "-1", "--replace") == 0
    assert json.loads((folder / "scene.json").read_text())["fringe"]["direction"] == -1
    scene, rig = load_scene(folder), load_rig(tmp_path / "one.json")
    cloud = triangulate_one(decode(scene.frames("left"), scene.code, 320), rig, scene.code, 320)
    off = (cloud.points @ PLANE_NORMAL - PLANE_DISTANCE)[cloud.flags == 0]
    assert abs(np.median(off)) < 0.1


def test_another_scene_json_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = save(tmp_path / "scan", scan(FringeCode("x", 4, (7, 6, 5))), COUNTS)
    pattern = ("--pattern", "{camera}/f{count}_{step}.png", "--counts", "7", "6", "5")
    assert run("scene", "new", folder, *pattern, "--rig", "small") == 0
    kept = (folder / "scene.json").read_bytes()
    assert run("scene", "new", folder, *pattern, "--rig", "small") == 0
    assert "scene.json: says so already" in capsys.readouterr().out
    assert run("scene", "new", folder, *pattern, "--rig", "large") == 2
    assert "found another scene there already (other rig), expected none: --replace" in capsys.readouterr().err
    assert (folder / "scene.json").read_bytes() == kept
    assert run("scene", "new", folder, *pattern, "--rig", "large", "--replace") == 0
    assert json.loads((folder / "scene.json").read_text(encoding="utf-8"))["rig"] == "large"


@pytest.mark.parametrize(
    ("changed", "key"),
    [(("--rig", "other"), "rig"), (("--counts", "9", "8", "7"), "fringe"), (("--axis", "y"), "fringe")],
)
def test_another_scene_json_is_kept_before_frames_are_read(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    changed: tuple[str, ...],
    key: str,
) -> None:
    folder = save(tmp_path / "scan", scan(FringeCode("x", 4, (7, 6, 5))), COUNTS)
    arguments = ("--pattern", "{camera}/f{count}_{step}.png", "--counts", "7", "6", "5", "--rig", "small")
    assert run("scene", "new", folder, *arguments) == 0
    monkeypatch.setattr("flows.new_scene.read_stack", None)
    named = ("--labels", "7", "6", "5") if changed[0] == "--counts" else ()
    assert run("scene", "new", folder, *arguments, *changed, *named) == 2
    assert f"found another scene there already (other {key}), expected none" in capsys.readouterr().err


def test_one_camera_and_its_projector_inspect_by_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_rig(replace(small_rig(), right=None), tmp_path / "small.json")
    views = {"left": scan(FringeCode("x", 4, (7, 6, 5)))["left"]}
    folder = save(tmp_path / "scan", views, [name.removeprefix("{camera}/") for name in COUNTS])
    arguments = ("--pattern", "f{count}_{step}.png", "--counts", "7", "6", "5", "--captured-at", "2026-11-01T00:00:00Z")
    assert run("scene", "new", folder, *arguments, "--rig", "small") == 0
    assert "the only camera, 12 frames" in capsys.readouterr().out
    assert run("scene", "guess", folder) == 0
    assert run("inspect", folder, "--rig", tmp_path / "small.json", "--store", tmp_path / "store") == 0
    said = capsys.readouterr()
    assert "nothing is seen twice" in said.out + said.err
    save_rig(replace(small_rig(), projector=None), tmp_path / "cameras.json")
    assert run("inspect", folder, "--rig", tmp_path / "cameras.json", "--store", tmp_path / "store") == 2
    assert "found one camera to measure with" in capsys.readouterr().err


@pytest.mark.parametrize("inverse", [False, True])
def test_gray_code_alone_from_the_finest_bit_on(
    inverse: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = FringeCode("x", 0, (), GrayCode(160, inverse))
    views = {
        camera: np.stack([cv2.GaussianBlur(frame, (0, 0), 0.7) for frame in frames])
        for camera, frames in scan(code).items()
    }
    per_bit = 2 if inverse else 1
    order = [per_bit * bit + i for bit in reversed(range(8)) for i in range(per_bit)]
    folder = save(tmp_path, {camera: frames[order] for camera, frames in views.items()}, SINGLE[: code.frames])
    arguments = ("--pattern", "{camera}_{frame}.png", "--counts", "--gray", "160", "--rig", "small")
    assert run("scene", "new", folder, *arguments, *(["--inverse"] if inverse else [])) == 0
    assert "from the finest bit on" in capsys.readouterr().out
    assert abs(np.median(measured(folder))) < 0.1


def test_a_folder_tells_the_command_that_makes_a_scene_of_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = FringeCode("x", 4, (16,), GrayCode(32, True))
    uniform = {
        side: np.stack([np.full_like(frames[0], level) for level in (190, 30)]) for side, frames in scan(code).items()
    }
    views = {side: np.concatenate([uniform[side], frames[4:], frames[:4]]) for side, frames in scan(code, -1).items()}
    folder = save(tmp_path / "raw", views, [f"cam_{{camera}}/IMG {k + 1}.bmp" for k in range(code.frames + 2)])
    assert run("scene", "guess", folder) == 0
    said = capsys.readouterr().out
    assert "steps backward" in said
    assert "frames 3 to 12: stripes along x, each followed by its inverse" in said
    (command,) = [line.strip() for line in said.splitlines() if "scene new" in line and "--counts" in line]
    assert "--counts 16 --steps 4 --gray 32 --inverse --sequence white black gray fringes" in command
    assert run(*shlex.split(command.replace("--rig ID", "--rig small"))[1:]) == 0
    assert np.quantile(np.abs(measured(folder)), 0.99) < 1.5


def test_what_the_frames_of_a_folder_do_not_tell_is_left_open(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    views = scan(FringeCode("x", 4, (7, 6, 5)))
    save(tmp_path / "numbered", views, SINGLE[:12])
    save(tmp_path / "named", views, COUNTS)
    assert run("scene", "guess", tmp_path / "numbered") == 0
    said = capsys.readouterr().out
    assert "--counts COUNT1 COUNT2 COUNT3 --steps 4" in said
    assert "the frames do not tell" in said
    assert run("scene", "guess", tmp_path / "named") == 0
    assert "--counts 5 6 7 --steps 4" in capsys.readouterr().out
    assert run("scene", "guess", tmp_path / "numbered" / "nowhere") == 2

"""Raw folders in other people's layouts: what `scene guess` says makes scenes of them that measure."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from flows.cli import main
from metrology.errors import SceneError
from metrology.fringe import FringeCode, GrayCode
from storage.frames import FrameHeader, read_frame
from tests.support.other_programs import measured, save, scan

Views = dict[str, NDArray[np.uint8]]
HETERODYNE = FringeCode("x", 4, (7, 6, 5))
GRAY = FringeCode("x", 0, (), GrayCode(160, True))
BOTH = FringeCode("x", 4, (16,), GrayCode(32))
REFERENCES = FringeCode("x", 4, (16,), GrayCode(32, False, True))


def numbered(count: int, form: str = "{{camera}}/{0}.png") -> list[str]:
    return [form.format(k) for k in range(count)]


def by_step(views: Views) -> Views:
    return {side: frames[[k * 4 + step for step in range(4) for k in range(3)]] for side, frames in views.items()}


def as_tiff(folder: Path, views: Views) -> None:
    for side, frames in views.items():
        assert cv2.imwritemulti(str(folder / f"{side}.tif"), list(frames))


def as_arrays(folder: Path, views: Views) -> None:
    for side, frames in views.items():
        np.save(folder / f"images_{side[0].upper()}.npy", np.moveaxis(frames, 0, -1))


def in_two_words(folder: Path, views: Views) -> None:
    """L/fringesleft01.bmp, L/grayleft01.bmp …, and pictures of a board beside them."""
    for side, frames in views.items():
        own = {"left": "L", "right": "R"}[side]
        names = [f"{own}/fringes{side}{k + 1:02d}.bmp" for k in range(4)]
        save(folder, {side: frames}, names + [f"{own}/gray{side}{k + 1:02d}.bmp" for k in range(5)])
        board = np.random.default_rng(1).integers(0, 255, (16, 60, 80)).astype(np.uint8)
        save(folder, {side: board}, [f"board/{own}/{side}{k + 1:02d}.bmp" for k in range(16)])


def by_turns(folder: Path, views: Views) -> None:
    """1.png of the left camera, 2.png of the right one, and so on."""
    for first, frames in enumerate(views.values()):
        for k, frame in enumerate(frames):
            cv2.imwrite(str(folder / f"{2 * k + first + 1}.png"), frame)


def in_halves(folder: Path, views: Views) -> None:
    for k, frame in enumerate(np.concatenate(list(views.values()))):
        cv2.imwrite(str(folder / f"img_{k:03d}.bmp"), frame)


@dataclass(frozen=True)
class Layout:
    """A folder of another program."""

    code: FringeCode
    names: list[str] | Callable[[Path, Views], None]
    said: str
    binary: bool = False
    shown: Callable[[Views], Views] = dict
    counts: str = ""
    """What is to be filled in."""


NAMED = [f"{{camera}}/{word}.png" for word in ("black", "white")]
LAYOUTS = {
    "plain binary": Layout(
        GRAY, numbered(16, "{{camera}}_bin_{0:02d}.bmp"), "plain binary from the coarsest bit", True
    ),
    "plain binary beside fringes": Layout(
        BOTH, numbered(9, "cam_{{camera}}/img{0:02d}.png"), "plain binary from the coarsest", True
    ),
    "pages": Layout(HETERODYNE, as_tiff, "left.tif: 12 frames of 320×240", counts="7 6 5"),
    "arrays": Layout(HETERODYNE, as_arrays, "pages/images_{camera}/{frame}.png", counts="7 6 5"),
    "step by step": Layout(
        HETERODYNE, numbered(12), "all counts of a step one after the other", shown=by_step, counts="7 6 5"
    ),
    "decimals and a folder of each kind": Layout(
        BOTH,
        [f"{{camera}}/fringes/phase_{k * 1.5707963267948966:.16g}.bmp" for k in range(4)]
        + [f"{{camera}}/stripes/gray_{k}.bmp" for k in range(5)],
        "--pattern '{camera}/{path}.bmp'",
    ),
    "white and black by name": Layout(
        REFERENCES, numbered(9, "{{camera}}/p{0:02d}.png") + NAMED[::-1], "--sequence black fringes gray white"
    ),
    "bits and inverses by name": Layout(
        GRAY,
        [f"{{camera}}/{sign}_{bit}.png" for bit in range(8) for sign in ("pos", "neg")],
        "--sequence gray inverse",
    ),
    "two words for the camera": Layout(
        BOTH, in_two_words, "--pattern '{camera}/{frame}.bmp' --counts 16 --steps 4 --gray 32 --sequence fringes gray"
    ),
    "fringes and stripes by turns": Layout(BOTH, by_turns, "--cameras turns --counts 16 --steps 4 --gray 32"),
    "stripes by turns": Layout(GRAY, by_turns, "--cameras turns --counts --gray 256 --inverse"),
    "one camera after the other": Layout(BOTH, in_halves, "--cameras halves --counts 16 --steps 4 --gray 32"),
    "times": Layout(
        HETERODYNE,
        [f"{{camera}}_2019082109{3809 + k}_{100 + 37 * k % 900}.bmp" for k in range(12)],
        "--pattern '{camera}_{frame}.bmp'",
        counts="7 6 5",
    ),
    "steps before counts": Layout(
        HETERODYNE,
        [f"{{camera}}/phase{step}_freq{count}.png" for count in (7, 6, 5) for step in range(4)],
        "phase{step}_freq{count}.png' --counts 5 6 7",
    ),
    "periods": Layout(
        FringeCode("x", 4, (15, 12, 10), size_px=360),
        [f"{{camera}}/T{period}_{step}.png" for period in (24, 30, 36) for step in range(4)],
        "--periods 24 30 36 --steps 4",
    ),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_becomes_a_scene_by_what_the_guess_says(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    layout = LAYOUTS[name]
    views = layout.shown(scan(layout.code, binary=layout.binary))
    if callable(layout.names):
        layout.names(tmp_path, views)
    else:
        save(tmp_path, views, layout.names)
    assert main(["scene", "guess", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert layout.said in said
    command = next(line.strip() for line in said.splitlines() if line.strip().startswith("flushline scene new"))
    for number, count in enumerate(layout.counts.split(), start=1):
        command = command.replace(f"COUNT{number}", count)
    assert main([*shlex.split(command.replace("--rig ID", "--rig small"))[1:]]) == 0
    off = measured(tmp_path)
    assert len(off) > 0.25 * 320 * 240
    assert abs(np.median(off)) < 0.1
    assert np.quantile(np.abs(off), 0.99) < (3.0 if not layout.code.counts else 1.5)


def test_a_code_shown_twice_is_of_one_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    once, again = scan(BOTH)["left"], scan(BOTH)["left"] // 2
    in_halves(tmp_path, {"left": once, "right": again})
    assert main(["scene", "guess", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "one camera" in said
    assert "--cameras" not in said


def test_inverses_alone_are_no_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    inverses = {side: frames[1::2] for side, frames in scan(GRAY).items()}
    save(tmp_path, inverses, numbered(8))
    assert main(["scene", "guess", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "found stripes whose numbers jump between neighbouring pixels" in said
    assert "flushline scene new" not in said


def test_several_captures_are_guessed_one_by_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number in ("01", "02"):
        save(tmp_path / f"part{number}", scan(HETERODYNE), numbered(12))
    assert main(["scene", "guess", str(tmp_path)]) == 0
    assert f"guess one: flushline scene guess {tmp_path / 'part01'}" in capsys.readouterr().out


def test_pages_are_not_taken_for_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for k, frames in enumerate(np.split(scan(HETERODYNE)["left"], 3)):
        for side in "LR":
            assert cv2.imwritemulti(str(tmp_path / f"{side}_{k}.tif"), list(frames))
    arguments = ["--pattern", "{camera}_{frame}.tif", "--counts", "--gray", "8", "--rig", "small"]
    assert main(["scene", "new", str(tmp_path), *arguments]) == 2
    assert "found a TIFF of several pages, expected one frame per file (scene guess" in capsys.readouterr().err


def test_what_the_guess_left_open_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["scene", "new", str(tmp_path), "--pattern", "{frame}.png", "--counts", "COUNT1", "--rig", "small"])
    assert "found 'COUNT1', which scene guess left open, expected how many fringes" in capsys.readouterr().err


def test_sixteen_bits_of_noise_are_no_contradiction(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    views = {
        side: np.clip(frames.astype(float) * 257 + rng.normal(0, 250, frames.shape), 0, 65535).astype(np.uint16)
        for side, frames in scan(HETERODYNE).items()
    }
    save(tmp_path, views, [f"{{camera}}/{count}_{step}.png" for count in (7, 6, 5) for step in range(4)])  # type: ignore[arg-type]
    arguments = ["--pattern", "{camera}/{count}_{step}.png", "--counts", "7", "6", "5", "--rig", "small"]
    assert main(["scene", "new", str(tmp_path), *arguments]) == 0


def test_pictures_that_are_to_be_turned_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tags = Image.Exif()
    tags[274] = 3
    for side, frames in scan(HETERODYNE).items():
        (tmp_path / side).mkdir()
        for number, frame in enumerate(frames):
            Image.fromarray(frame).save(tmp_path / side / f"{number:02d}.jpg", quality=98, exif=tags)
    assert main(["scene", "guess", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "00.jpg: found an orientation in its Exif data by which it is to be turned" in said
    assert "flushline scene new" not in said
    command = ["--pattern", "{camera}/{frame}.jpg", "--counts", "7", "6", "5", "--rig", "small"]
    assert main(["scene", "new", str(tmp_path), *command]) == 2
    assert "00.jpg: found an orientation in its Exif data" in capsys.readouterr().err
    assert not (tmp_path / "scene.json").exists()


def test_a_picture_that_one_camera_has_is_left_aside(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    views = scan(BOTH)
    save(tmp_path, views, numbered(9))
    cv2.imwrite(str(tmp_path / "L" / "texture.png"), views["left"][0])
    assert main(["scene", "guess", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "note: texture.png is left aside: one camera alone has a picture of this name" in said
    command = next(line.strip() for line in said.splitlines() if line.strip().startswith("flushline scene new"))
    assert main([*shlex.split(command.replace("--rig ID", "--rig small"))[1:]]) == 0
    assert len(measured(tmp_path)) > 0.25 * 320 * 240
    (tmp_path / "scene.json").unlink()
    cv2.imwrite(str(tmp_path / "L" / "99.png"), views["left"][0])
    assert main(["scene", "guess", str(tmp_path)]) == 0
    assert "found 10 of the left camera, 9 of the right camera, expected as many of either" in capsys.readouterr().out


def test_a_guess_reads_each_frame_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One camera, of whose frames the guess first asks whether they are of two, and then tries three counts."""
    views = scan(FringeCode("x", 4, (16,), GrayCode(32)))
    save(tmp_path, {"left": np.concatenate([views["left"], views["left"][:1]])}, [f"{k}.png" for k in range(10)])
    read: list[Path] = []

    def counting(path: Path, header: FrameHeader, error: type[SceneError]) -> NDArray:
        read.append(path)
        return read_frame(path, header, error)

    monkeypatch.setattr("flows.folder_guess.read_frame", counting)
    assert main(["scene", "guess", str(tmp_path)]) == 0
    assert "frames 1 to 4: fringes along x" in capsys.readouterr().out
    assert sorted(read) == sorted(tmp_path.glob("*.png"))

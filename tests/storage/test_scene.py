"""Scene folders: what was written is read back, and every bad input is one line that names file, found, expected."""

from __future__ import annotations

import json
import os
import struct
import time
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from metrology.errors import SceneError
from metrology.fringe import FringeCode, GrayCode
from metrology.results import SceneKey
from metrology.rig import Rig
from storage.scene import load_scene, write_scene

FRAME = "left/e0_c1_s2.png"


def edit(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    manifest = folder / "scene.json"
    document = json.loads(manifest.read_text())
    change(document)
    manifest.write_text(json.dumps(document))


def png(width: int, height: int, bits: int = 8, colour: int = 0) -> bytes:
    """A PNG that claims a size and holds next to nothing."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        body = kind + content
        return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))

    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    data = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 10)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + data


def test_what_was_written_is_read_back(tmp_path: Path, rig: Rig, code: FringeCode, key: SceneKey) -> None:
    rng = np.random.default_rng(2)
    left, right = rng.integers(0, 2**16, (2, 3, code.frames, 48, 64), np.uint16)
    write_scene(tmp_path / "s", key, rig.id, code, [0.2, 1, 5], left, right, truth={"rivets": []}, operator="Jö")
    scene = load_scene(tmp_path / "s")
    scene.check_fits(rig)
    assert (scene.key, scene.code, scene.exposures, scene.operator) == (key, code, (0.2, 1.0, 5.0), "Jö")
    with ThreadPoolExecutor(2) as threads:
        assert np.array_equal(scene.frames("left", threads), left)
    assert np.array_equal(scene.frames("right"), right)


def test_gray_code_frames_follow_the_fringes(tmp_path: Path, rig: Rig, key: SceneKey) -> None:
    code = FringeCode("x", 4, (8,), GrayCode(16, inverse=True))
    frames = np.zeros((1, code.frames, 48, 64), np.uint8)
    write_scene(tmp_path / "s", key, rig.id, code, [1.0], frames, frames)
    assert load_scene(tmp_path / "s").code == code
    edit(tmp_path / "s", lambda d: d["fringe"].update(gray={"stripes": 32, "inverse": True}))
    with pytest.raises(SceneError, match=r"expected 14 \(1 counts × 4 steps \+ 10 of Gray code\)"):
        load_scene(tmp_path / "s")
    edit(tmp_path / "s", lambda d: d["fringe"].update(gray={"stripes": 4}))
    with pytest.raises(SceneError, match="gray stripes: found 4, expected at least 8"):
        load_scene(tmp_path / "s")


@pytest.mark.parametrize("suffix", [".tiff", ".bmp", ".npy"])
def test_other_image_formats_hold_the_same(scene_folder: Path, suffix: str) -> None:
    before = load_scene(scene_folder).frames("left")
    for path in sorted((scene_folder / "left").glob("*.png")):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if suffix == ".npy":
            np.save(path.with_suffix(suffix), image)
        else:
            cv2.imwrite(str(path.with_suffix(suffix)), image)
        path.unlink()

    def rename(document: dict[str, Any]) -> None:
        document["frames"]["left"] = [
            [name.replace(".png", suffix) for name in names] for names in document["frames"]["left"]
        ]

    edit(scene_folder, rename)
    assert np.array_equal(load_scene(scene_folder).frames("left"), before)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.update(exposure=[1]), "unknown key 'exposure', expected 'exposures'"),
        (lambda d: d.update(exposure=d.pop("exposures")), "unknown key 'exposure', expected 'exposures'"),
        (lambda d: d["fringe"].update(step=4), "unknown key 'fringe.step', expected 'steps'"),
        (lambda d: d.pop("panel"), "no key 'panel'"),
        (lambda d: d.update(format="flushline-scene/2"), 'found format "flushline-scene/2"'),
        (lambda d: d.update(captured_at="20 Nov 2026"), 'captured_at: found "20 Nov 2026", expected an ISO 8601'),
        (lambda d: d.update(captured_at="2026-11-20T08:15:00"), "ISO 8601 time with its zone"),
        (lambda d: d.update(captured_at=1763626500), "ISO 8601 time with its zone"),
        (lambda d: d.update(aircraft_serial="../../etc"), "letters, digits"),
        (lambda d: d.update(panel=".hidden"), "without a leading dot"),
        (lambda d: d.update(station=""), "station"),
        (lambda d: d.update(panel="P\n"), "letters, digits"),
        (lambda d: d["fringe"].update(steps=4.0), "fringe.steps: found 4.0, expected a valid integer"),
        (lambda d: d["fringe"].update(counts=[70, 64, 60]), "common factor"),
        (lambda d: d.update(exposures=[]), "exposures: found [], expected a list of at least 1"),
        (lambda d: d.update(exposures=1.0), "exposures: found 1.0, expected a list"),
        (lambda d: d.update(exposures=["1.0"]), 'exposures.0: found "1.0", expected a valid number'),
        (lambda d: d.update(fringe=None), "fringe: found null, expected a table of keys"),
        (lambda d: d.update(panel="P" * 65), "expected at most 64 characters"),
        (lambda d: d.update(captured_at="9999-12-31T23:59:59-12:00"), "expected a time that UTC has, too"),
        (lambda d: d.update(operator="a\x1b[31m"), "expected one line of printable text"),
        (lambda d: d.update(operator="\ud800"), "expected one line of printable text"),
        (lambda d: d["frames"].update(left=[["a.png"]]), "scene.json: found 1 frames in frames.left.0"),
        (lambda d: d.update(exposures=[-1.0]), "exposures.0: found -1.0, expected greater than 0"),
        (lambda d: d.update(exposures=[1.0, 2.0]), "for 1 exposures, expected 2"),
        (lambda d: d.update(exposures=[1e-9, 2.0]), "expected the longest at most 1,000,000 times the shortest"),
        (lambda d: d["frames"]["left"][0].__setitem__(0, "C:\\data\\f.png"), "expected one inside the folder"),
        (lambda d: d["frames"]["left"][0].__setitem__(0, "..\\f.png"), "expected one inside the folder"),
        (lambda d: d["frames"]["left"][0].__setitem__(0, "left/a\nb.png"), "expected one inside the folder"),
        (lambda d: d["frames"]["left"][0].__setitem__(0, "./" + FRAME), "listed more than once"),
        (lambda d: d["frames"]["left"][0].extend(f"f{k}.png" for k in range(9000)), "a list of at most 4096"),
        (lambda d: d.update(panel="P\u202e" * 999), '"P\\u202eP\\u202e'),
        (lambda d: d["frames"]["left"][0].pop(), "found 11 frames in frames.left.0, expected 12"),
        (lambda d: d["frames"]["left"][0].__setitem__(0, "../secret.png"), "expected one inside the folder"),
        (lambda d: d["frames"]["left"][0].__setitem__(0, "/etc/passwd"), "expected one inside the folder"),
        (lambda d: d["frames"]["left"][0].__setitem__(0, FRAME), "listed more than once"),
        (lambda d: d["frames"]["left"][0].__setitem__(0, "left"), "found a directory, expected a file"),
        (lambda d: d["frames"]["left"][0].__setitem__(0, "left/none.png"), "no such file"),
    ],
)
def test_a_wrong_manifest_is_named(scene_folder: Path, change: Callable[[dict[str, Any]], None], said: str) -> None:
    edit(scene_folder, change)
    with pytest.raises(SceneError) as caught:
        load_scene(scene_folder)
    assert said in str(caught.value)
    assert str(scene_folder) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b'{"format": "flushline-scene/1",', "broken JSON at line 1"),
        (b'{"format": "flushline-scene/1", "format": "x"}', "key 'format' twice"),
        (b'{"exposures": [NaN]}', "found NaN"),
        (b"[1, 2]", "expected a JSON object"),
        (b"\xff\xfe{}", "not UTF-8"),
        (b"[" * 200_000, "JSON"),
        (b'{"a": ' + b"9" * 5000 + b"}", "scene.json"),
        (b"", "broken JSON"),
    ],
)
def test_a_file_that_is_no_manifest_is_named(scene_folder: Path, content: bytes, said: str) -> None:
    (scene_folder / "scene.json").write_bytes(content)
    with pytest.raises(SceneError, match=r"scene\.json") as caught:
        load_scene(scene_folder)
    assert said in str(caught.value)


def test_a_megabyte_of_keys_is_checked_in_no_time(scene_folder: Path) -> None:
    keys = ",".join(f'"key{k}": 1' for k in range(60_000))
    (scene_folder / "scene.json").write_text(f'{{{keys}, "key5": 2}}')
    began = time.process_time()
    with pytest.raises(SceneError, match="key 'key5' twice"):
        load_scene(scene_folder)
    assert time.process_time() - began < 3.0
    (scene_folder / "scene.json").write_text(f"{{{keys}, {keys}}}")
    with pytest.raises(SceneError, match="bytes, expected at most"):
        load_scene(scene_folder)


def test_paths_of_windows_and_times_in_a_unit_are_understood(scene_folder: Path) -> None:
    before = load_scene(scene_folder)

    def as_on_windows(document: dict[str, Any]) -> None:
        document["exposures"] = [20000.0]
        for camera, exposures in document["frames"].items():
            document["frames"][camera] = [[name.replace("/", "\\") for name in names] for names in exposures]

    edit(scene_folder, as_on_windows)
    assert replace(load_scene(scene_folder), files_state=before.files_state) == before


def test_folders_that_are_no_scene_are_named(tmp_path: Path, scene_folder: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "odd").mkdir()
    (tmp_path / "odd" / "scene.json").mkdir()
    (tmp_path / "loop").mkdir()
    os.symlink("scene.json", tmp_path / "loop" / "scene.json")
    for name, said in (
        ("empty", "an empty folder"),
        ("odd", "found a directory"),
        ("loop", "symbolic links"),
        ("none", "no such folder"),
        ("scene/scene.json", "found a file"),
    ):
        with pytest.raises(SceneError, match=said):
            load_scene(tmp_path / name)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "empty file"),
        (b"hello", "image signatures"),
        (b"\x89PNG\r\n\x1a\n\0\0", "truncated header"),
        (png(100_000, 100_000), "100000×100000"),
        (png(0, 48), "0×48"),
        (png(64, 48, bits=16), "found 64×48 with 16 bit, expected 64×48 with 8 bit"),
        (png(64, 48, colour=2), "found a colour PNG"),
        (png(32, 48), "found 32×48 with 8 bit, expected 64×48 with 8 bit"),
        (b"BM" + b"\0" * 10, "header"),
        (b"II*\0" + struct.pack("<I", 2**31), "header"),
        (b"\x93NUMPY\1\0\2\0{}", "npy header"),
    ],
)
def test_a_bad_frame_is_found_before_anything_is_decoded(scene_folder: Path, content: bytes, said: str) -> None:
    (scene_folder / FRAME).write_bytes(content)
    with pytest.raises(SceneError, match=FRAME) as caught:
        load_scene(scene_folder)
    assert said in str(caught.value)


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".bmp", ".npy"])
@pytest.mark.parametrize("kept", [0.999, 0.5])
def test_a_truncated_frame_is_never_read_in_part(scene_folder: Path, suffix: str, kept: float) -> None:
    path = (scene_folder / FRAME).with_suffix(suffix)
    image = cv2.imread(str(scene_folder / FRAME), cv2.IMREAD_UNCHANGED)
    if suffix == ".npy":
        np.save(path, image)
    else:
        cv2.imwrite(str(path), image)
    edit(scene_folder, lambda d: d["frames"]["left"][0].__setitem__(6, str(path.relative_to(scene_folder))))
    assert load_scene(scene_folder).left[6] == path
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * kept)])
    with pytest.raises(SceneError, match="truncated"):
        load_scene(scene_folder)


def test_a_frame_damaged_inside_is_refused(scene_folder: Path) -> None:
    data = bytearray((scene_folder / FRAME).read_bytes())
    data[len(data) // 2] ^= 0xFF
    (scene_folder / FRAME).write_bytes(data)
    scene = load_scene(scene_folder)
    with pytest.raises(SceneError, match=rf"{FRAME}: found a damaged PNG"):
        scene.frames("left")


def test_a_frame_replaced_after_the_check_is_refused(scene_folder: Path) -> None:
    scene = load_scene(scene_folder)
    (scene_folder / FRAME).write_bytes(png(100_000, 100_000))
    with pytest.raises(SceneError, match="100000×100000"):
        scene.frames("left")


def test_a_rig_of_other_sizes_does_not_fit(scene_folder: Path, rig: Rig) -> None:
    scene = load_scene(scene_folder)
    other = replace(rig, right=replace(rig.right, width=65))
    with pytest.raises(SceneError, match="found 64×48 pixels, expected 65×48 as the right camera of rig 'rig-a' has"):
        scene.check_fits(other)


def test_fringes_that_the_projector_cannot_show_are_refused(scene_folder: Path, rig: Rig) -> None:
    finest = rig.projector.width // 2
    for count, fits in ((finest, True), (finest + 1, False), (10**30, False)):
        edit(scene_folder, lambda d, count=count: d["fringe"]["counts"].__setitem__(0, count))  # type: ignore[misc]
        scene = load_scene(scene_folder)
        if fits:
            scene.check_fits(rig)
            continue
        with pytest.raises(SceneError, match=rf"scene.json: found {count} fringes, expected at most {finest} across"):
            scene.check_fits(rig)

"""Files of many frames: written out whole or not at all, within the folder, and anew where the file is newer."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from metrology.errors import SceneError
from storage import frame_pages
from storage.frame_pages import write_pages
from storage.frame_patterns import name_patterns

FRAMES = np.random.default_rng(1).integers(0, 255, (5, 40, 60), np.uint8)


def first(folder: Path, inside: str) -> np.ndarray:
    return cv2.imread(str(folder / "pages" / inside / "001.png"), cv2.IMREAD_UNCHANGED)


def test_a_newer_file_is_written_out_anew(tmp_path: Path) -> None:
    path = tmp_path / "left.npy"
    np.save(path, FRAMES)
    write_pages(tmp_path)
    written = (tmp_path / "pages/left").stat().st_mtime
    np.save(path, FRAMES[1:])
    os.utime(path, (written + 10, written + 10))
    write_pages(tmp_path)
    assert np.array_equal(first(tmp_path, "left"), FRAMES[1])
    assert [one.name for one in sorted((tmp_path / "pages/left").iterdir())] == [f"00{k}.png" for k in range(1, 5)]
    assert [one.name for one in (tmp_path / "pages").iterdir()] == ["left"]


def test_files_that_differ_in_their_ending_alone_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "left.npy", FRAMES)
    write_pages(tmp_path)
    cv2.imwritemulti(str(tmp_path / "left.tif"), list(FRAMES[1:]))
    with pytest.raises(SceneError, match=r"left\.tif: found that left\.npy has the same name.*rename one"):
        write_pages(tmp_path)
    assert np.array_equal(first(tmp_path, "left"), FRAMES[0])


def test_half_of_the_frames_are_never_taken_for_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, frame: np.ndarray) -> None:
        if path.name == "003.png":
            raise KeyboardInterrupt
        path.write_bytes(b"")

    np.save(tmp_path / "left.npy", FRAMES)
    with monkeypatch.context() as patch:
        patch.setattr(frame_pages, "write_frame", full)
        with pytest.raises(KeyboardInterrupt):
            write_pages(tmp_path)
    assert not (tmp_path / "pages/left").exists()
    write_pages(tmp_path)
    assert np.array_equal(first(tmp_path, "left"), FRAMES[0])


def test_what_a_kill_left_is_no_picture(tmp_path: Path) -> None:
    np.save(tmp_path / "left.npy", FRAMES)
    write_pages(tmp_path)
    (tmp_path / "pages/left").rename(tmp_path / "pages/.tmp1")
    write_pages(tmp_path)
    assert [one.pattern for one in name_patterns(tmp_path)] == ["pages/left/{frame}.png"]


@pytest.mark.parametrize("name", ["../../outside", "/outside"])
def test_names_of_arrays_do_not_lead_out_of_the_folder(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "scan"
    folder.mkdir()
    np.savez(folder / "x.npz", **{name: FRAMES})
    write_pages(folder)
    assert len(list((folder / "pages/x").rglob("*.png"))) == len(FRAMES)
    assert [one.name for one in tmp_path.iterdir()] == ["scan"]


@pytest.mark.parametrize("damage", ["cut", "bit", "empty", "text"])
def test_a_damaged_file_of_arrays_is_passed_over_with_a_word(damage: str, tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    np.savez(path, a=FRAMES)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 255
    path.write_bytes({"cut": data[: len(data) // 2], "bit": data, "empty": b"", "text": b"hello"}[damage])
    assert write_pages(tmp_path) == ["x.npz: found no whole file of arrays, passed over"]


def test_large_arrays_of_another_kind_are_named(tmp_path: Path) -> None:
    np.save(tmp_path / "x.npy", np.zeros((4, 100, 100)))
    (line,) = write_pages(tmp_path)
    assert line.startswith("x.npy: found float64 of shape (4, 100, 100), passed over; expected (frames, rows, columns)")


def test_objects_beside_frames_are_left_alone(tmp_path: Path) -> None:
    np.savez(tmp_path / "x.npz", settings=np.array([{}], dtype=object), left=FRAMES)
    write_pages(tmp_path)
    assert np.array_equal(first(tmp_path, "x/left"), FRAMES[0])


@pytest.mark.parametrize("orientation", [3, 6])
def test_pages_that_are_to_be_turned_are_refused(orientation: int, tmp_path: Path) -> None:
    pages = [Image.fromarray(frame) for frame in FRAMES]
    pages[0].save(tmp_path / "x.tif", save_all=True, append_images=pages[1:], tiffinfo={274: orientation})
    with pytest.raises(SceneError, match=f"x.tif: found orientation tag {orientation}"):
        write_pages(tmp_path)

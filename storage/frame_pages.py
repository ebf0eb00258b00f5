"""Many frames in one file, TIFF of several pages or an array of frames, written out as one PNG each."""

from __future__ import annotations

import contextlib
import re
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import BadZipFile

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.errors import SceneError
from storage.frame_source import BadFrame, open_source
from storage.frames import write_frame
from storage.tiff import TiffDirectory, check_orientation

PAGES = "pages"
"""The folder beside the files that the frames are written into."""
_TIFF = (".tif", ".tiff")
_ARRAYS = (".npy", ".npz")
_LEAST_PAGES = 3
_FEW_PIXELS = 10_000


def write_pages(folder: Path) -> list[str]:
    """Write the frames of all files of many into `folder`/pages, but those that are there and no older.

    Returns
    -------
    list of str
        What was found, a line per file.

    Raises
    ------
    SceneError
        Where a file's pages are no frames, or two files' frames would lie in one folder.
    """
    lines: list[str] = []
    source: dict[Path, str] = {}
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder)
        if inside.parts[0] == PAGES or path.suffix.lower() not in (*_TIFF, *_ARRAYS) or not path.is_file():
            continue
        for name, frames in _stacks(path, lines):
            target = pages_of(folder, path) / name
            if (other := source.setdefault(target, inside.as_posix())) != inside.as_posix():
                raise SceneError(
                    f"{path}: found that {other} has the same name but for its ending, so that the frames of both "
                    f"would lie in {target.relative_to(folder).as_posix()}, expected names that differ: rename one"
                )
            if not target.is_dir() or target.stat().st_mtime < path.stat().st_mtime:
                _write(target, frames)
            height, width = frames[0].shape
            shown = (target.relative_to(folder) / "001.png").as_posix()
            lines.append(f"{inside.as_posix()}: {len(frames)} frames of {width}×{height}, written as {shown} and so on")
    return lines


def _write(target: Path, frames: Sequence[NDArray]) -> None:
    """The frames in a folder that gets its name when all are there."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".", dir=target.parent, ignore_cleanup_errors=True) as beside:
        whole = Path(beside, "whole")
        whole.mkdir()
        for number, frame in enumerate(frames, start=1):
            write_frame(whole / f"{number:03d}.png", frame)
        if target.is_dir():  # of what the file was before
            target.rename(Path(beside, "old"))
        whole.rename(target)


def pages_of(folder: Path, path: Path) -> Path:
    """Where the frames of a file of many are written."""
    return folder / PAGES / path.relative_to(folder).with_suffix("")


def _stacks(path: Path, lines: list[str]) -> Iterator[tuple[str, list[NDArray]]]:
    """The frames in a file, and what their array is called; nothing of a file that holds one frame or none.

    `lines` get what large arrays are passed over.
    """
    if path.suffix.lower() in _TIFF:
        if cv2.imcount(str(path)) >= _LEAST_PAGES:
            yield "", [_grey(page, path) for page in _tiff_pages(path)]
        return
    for name, array in _arrays(path, lines):
        called = f"{path.name} {name}".rstrip()
        if array.ndim == 3 and array.dtype in (np.uint8, np.uint16):
            across = int(np.argmin(array.shape))  # frames are fewer than rows or columns
            if array.shape[across] >= _LEAST_PAGES and not (across == 2 and array.shape[2] in (3, 4)):  # colours
                yield re.sub(r"[^\w-]+", "_", name), [np.ascontiguousarray(f) for f in np.moveaxis(array, across, 0)]
        elif array.ndim >= 3 and array.size >= _LEAST_PAGES * _FEW_PIXELS:
            lines.append(
                f"{called}: found {array.dtype} of shape {array.shape}, passed over; expected (frames, rows, columns) "
                "of 8 or 16 bits of whole numbers"
            )


def _arrays(path: Path, lines: list[str]) -> list[tuple[str, NDArray]]:
    """What a file of numpy holds, by name; nothing but arrays is loaded."""
    found: list[tuple[str, NDArray]] = []
    try:
        with path.open("rb") as file:
            loaded = np.load(file, allow_pickle=False)
            if isinstance(loaded, np.ndarray):
                return [("", loaded)]
            for name in loaded.files:
                with contextlib.suppress(ValueError):  # objects
                    found.append((name, loaded[name]))
    except (OSError, ValueError, EOFError, MemoryError, zlib.error, BadZipFile):
        lines.append(f"{path.name}: found no whole file of arrays, passed over")
        return []
    return found


def _tiff_pages(path: Path) -> list[NDArray]:
    try:
        with open_source(path) as source:
            check_orientation(TiffDirectory.read(source))
    except BadFrame as problem:
        raise SceneError(f"{path}: {problem}") from None
    read, pages = cv2.imreadmulti(str(path), flags=cv2.IMREAD_UNCHANGED)
    if not read or len({page.shape[:2] for page in pages}) != 1:
        raise SceneError(f"{path}: found a TIFF whose pages are not frames of one size, expected one frame per page")
    return list(pages)


def _grey(page: NDArray, path: Path) -> NDArray:
    if page.dtype not in (np.uint8, np.uint16):
        raise SceneError(f"{path}: found pages of {page.dtype}, expected 8 or 16 bits of whole numbers")
    return page if page.ndim == 2 else np.asarray(cv2.cvtColor(page[..., :3], cv2.COLOR_BGR2GRAY))

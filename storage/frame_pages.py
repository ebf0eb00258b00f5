"""Many frames in one file, TIFF of several pages or an array of frames, written out as one PNG each."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.errors import SceneError
from storage.frames import write_frame

PAGES = "pages"
"""The folder beside the files that the frames are written into."""
_TIFF = (".tif", ".tiff")
_ARRAYS = (".npy", ".npz")
_LEAST_PAGES = 3


def write_pages(folder: Path) -> list[str]:
    """Write the frames of all files of many into `folder`/pages, but those that are there already.

    Returns
    -------
    list of str
        What was found, a line per file.
    """
    lines = []
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder)
        if inside.parts[0] == PAGES or path.suffix.lower() not in (*_TIFF, *_ARRAYS) or not path.is_file():
            continue
        for name, frames in _stacks(path):
            target = pages_of(folder, path) / name
            if not target.is_dir():
                target.mkdir(parents=True)
                for number, frame in enumerate(frames, start=1):
                    write_frame(target / f"{number:03d}.png", frame)
            height, width = frames[0].shape
            shown = (target.relative_to(folder) / "001.png").as_posix()
            lines.append(f"{inside.as_posix()}: {len(frames)} frames of {width}×{height}, written as {shown} and so on")
    return lines


def pages_of(folder: Path, path: Path) -> Path:
    """Where the frames of a file of many are written."""
    return folder / PAGES / path.relative_to(folder).with_suffix("")


def _stacks(path: Path) -> Iterator[tuple[str, list[NDArray]]]:
    """The frames in a file, and what their array is called; nothing of a file that holds one frame or none."""
    if path.suffix.lower() in _TIFF:
        if cv2.imcount(str(path)) >= _LEAST_PAGES:
            yield "", [_grey(page, path) for page in _tiff_pages(path)]
        return
    try:
        loaded = np.load(path, allow_pickle=False)
    except (OSError, ValueError):
        return
    arrays = {"": loaded} if isinstance(loaded, np.ndarray) else {name: loaded[name] for name in loaded.files}
    for name, array in arrays.items():
        if array.ndim == 3 and array.dtype in (np.uint8, np.uint16):
            across = int(np.argmin(array.shape))  # frames are fewer than rows or columns
            if array.shape[across] >= _LEAST_PAGES and not (across == 2 and array.shape[2] in (3, 4)):  # colours
                yield name, [np.ascontiguousarray(frame) for frame in np.moveaxis(array, across, 0)]


def _tiff_pages(path: Path) -> list[NDArray]:
    read, pages = cv2.imreadmulti(str(path), flags=cv2.IMREAD_UNCHANGED)
    if not read or len({page.shape[:2] for page in pages}) != 1:
        raise SceneError(f"{path}: found a TIFF whose pages are not frames of one size, expected one frame per page")
    return list(pages)


def _grey(page: NDArray, path: Path) -> NDArray:
    if page.dtype not in (np.uint8, np.uint16):
        raise SceneError(f"{path}: found pages of {page.dtype}, expected 8 or 16 bits of whole numbers")
    return page if page.ndim == 2 else np.asarray(cv2.cvtColor(page[..., :3], cv2.COLOR_BGR2GRAY))

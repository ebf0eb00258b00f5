"""Calibrations of cameras alone: pairs of pictures of a board by their names, and published lists of points."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from metrology.arrays import Array
from metrology.calibration.board import Board
from metrology.calibration.frames import CameraName
from metrology.calibration.observations import Sighting
from metrology.errors import CalibrationError
from storage.calibration_documents import flat, numbers, read_document
from storage.frames import Frame, read_as_grey
from storage.scene_names import cameras_of, matching, natural

_COLUMNS = ("pose", "x_mm", "y_mm", "left_u", "left_v", "right_u", "right_v")
_NAMES = {
    "known": ("object", "object_points", "objpoints", "board", "world", "worldPoints", "obj"),
    "left": ("left", "left_points", "imgpoints_left", "imagePoints1", "imgpoints_l", "left_px"),
    "right": ("right", "right_points", "imgpoints_right", "imagePoints2", "imgpoints_r", "right_px"),
}
_FIRST_SIGMA_PX = 0.1


def parse_board(text: str | None) -> Board:
    """A board such as ``chessboard:9x6:25`` (mm), ``circles:7x7:20:10``, ``charuco:8x6:30:22:DICT_5X5_100``."""
    kind, *rest = (text or "").split(":")
    size = re.fullmatch(r"(\d+)x(\d+)", rest[0]) if len(rest) >= 2 else None
    try:
        if size is None:
            raise ValueError
        more: dict[str, Any] = {}
        if kind == "charuco":
            more = {"marker_mm": float(rest[2]), "dictionary": rest[3]}
        elif kind != "chessboard":
            more = {"dot_diameter_mm": float(rest[2])}
        return Board(kind, int(size[1]), int(size[2]), float(rest[1]), **more)  # type: ignore[arg-type]
    except (ValueError, IndexError):
        raise CalibrationError(
            f"--board: found {text or 'none'!r}, expected such as chessboard:9x6:25 (inner corners, mm), "
            "circles:7x7:20:10 (spacing, diameter) or charuco:8x6:30:22:DICT_5X5_100 (squares, side, marker, "
            "dictionary)"
        ) from None


def picture_pairs(folder: Path, pattern: str, left: str | None = None) -> list[dict[CameraName, Path]]:
    """Pairs of pictures of one pose each, told by {frame} in names such as ``{camera}_{frame}.jpg``."""
    if "{camera}" not in pattern:
        raise CalibrationError(
            f"--pictures: found {pattern!r}, expected {{camera}} in it: pairs of two cameras; one camera is calibrated "
            "together with its projector (--projector)"
        )
    found = matching(folder, pattern)
    named = cameras_of(found, left)
    poses: dict[str, dict[CameraName, Path]] = {}
    for path, values in found.items():
        for camera, name in named.items():
            if values["camera"] == name:
                poses.setdefault(values.get("frame", ""), {})[camera] = path
    for pose, pair in poses.items():
        if len(pair) != 2:
            (only,) = pair.values()
            raise CalibrationError(f"{only}: found no picture of the other camera for pose {pose!r}, expected pairs")
    return [poses[pose] for pose in sorted(poses, key=natural)]


def read_picture(path: Path) -> Frame:
    """A picture of a board in grey, whatever its format."""
    picture = read_as_grey(path, CalibrationError)
    if picture is None:
        raise CalibrationError(f"{path}: found no picture that can be read, expected PNG, TIFF, BMP or JPEG")
    return picture


def read_points(path: Path) -> list[Sighting]:
    """Points of the board and where both cameras saw them: CSV with named columns, JSON, MAT or NPZ by poses."""
    tables = _csv(path) if path.suffix.lower() == ".csv" else _arrays(path)
    sightings = []
    for pose, (known, left, right) in enumerate(tables):
        index, none = np.arange(len(known)), np.zeros(len(known))
        for camera, pixels in (("left", left), ("right", right)):
            seen = np.isfinite(pixels).all(1)
            sightings.append(
                Sighting("board", camera, pose, index, known, none, pixels, _FIRST_SIGMA_PX).only(seen)  # type: ignore[arg-type]
            )
    return sightings


def _csv(path: Path) -> list[tuple[Array, Array, Array]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
        table = {name: np.array([float(row[name] or "nan") for row in rows]) for name in _COLUMNS[1:]}
        poses = [row["pose"] for row in rows]
    except (OSError, UnicodeDecodeError, KeyError, ValueError, TypeError) as problem:
        raise CalibrationError(
            f"{path}: found {problem}, expected a CSV with the columns {', '.join(_COLUMNS)}"
        ) from None
    by_pose = [np.array([one == pose for one in poses]) for pose in dict.fromkeys(poses)]
    pairs = [_COLUMNS[i : i + 2] for i in (1, 3, 5)]
    return [
        tuple(np.column_stack([table[a][own], table[b][own]]) for a, b in pairs)  # type: ignore[misc]
        for own in by_pose
    ]


def _arrays(path: Path) -> list[tuple[Array, Array, Array]]:
    values = flat(read_document(path))
    known, left, right = (_per_pose(values, names, path) for names in _NAMES.values())
    if len(known) == 1 and len(left) > 1:  # one board for all poses, as MATLAB has it
        known = known * len(left)
    if not len(known) == len(left) == len(right):
        raise CalibrationError(
            f"{path}: found {len(known)}, {len(left)} and {len(right)} poses, expected as many of each"
        )
    for pose, (a, b, c) in enumerate(zip(known, left, right, strict=True)):
        if not len(a) == len(b) == len(c):
            raise CalibrationError(f"{path}: pose {pose}: found {len(a)}, {len(b)}, {len(c)} points, expected as many")
    return [(a[:, :2], b[:, :2], c[:, :2]) for a, b, c in zip(known, left, right, strict=True)]


def _per_pose(values: Mapping[str, Any], names: Sequence[str], path: Path) -> list[Array]:
    """One (n, 2 or 3) array per pose."""
    name = next((name for name in names if name in values), None)
    if name is None:
        raise CalibrationError(f"{path}: found no {names[0]!r}, expected board points, left and right by these names")
    whole = numbers(values[name])
    poses = [whole] if whole is not None and whole.ndim == 2 else list(values[name])
    arrays = [numbers(pose) for pose in poses]
    if any(array is None or array.shape[-1] not in (2, 3) for array in arrays):
        raise CalibrationError(f"{path}: {name}: found no lists of points, expected x, y (and z = 0) by pose")
    return [array.reshape(-1, array.shape[-1]) for array in arrays if array is not None]

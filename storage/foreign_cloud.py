"""Clouds as other scanners export them: PLY, PCD, E57, npz and depth maps, each with its grid where it has one."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.errors import SceneError, UsageError
from storage.documents import check_regular_file
from storage.point_cloud import load_open3d

MM_PER_METRE = 1000.0
_COLOURS = tuple(tuple(name.split()) for name in ("red green blue", "r g b", "colorRed colorGreen colorBlue"))
_GREYS = ("intensity", "texture", "grey", "gray", "quality", "reflectance", "scalar_intensity")
_SIGMAS = ("sigma_z_mm", "sigma_mm", "sigma_z", "sigma")
# As exporters write the grid's size in comments: "num_cols 1920", "width: 1920", "columns=1920".
_PLY_GRID = re.compile(
    r"(?im)^(?:comment|obj_info)\b.*?\b(num_?cols|cols|columns|width|num_?rows|rows|height)[ :=]+(\d+)"
)
_PCD_GRID = re.compile(r"(?m)^(WIDTH|HEIGHT) (\d+)")
_HEADER_BYTES = 65536
_RGB_TO_GREY = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True)
class ForeignCloud:
    """A cloud as its file has it."""

    points: Array
    """(n, 3): in the file's unit; NaN where a cell of the grid is empty. Row by row where there is a grid."""
    grid: tuple[int, int] | None = None
    """(int, int) or None: rows and columns; None where the points have no order."""
    grey: NDArray[Any] | None = None
    """(n,) of uint8 or uint16, or None: brightness of the points, where the file has it."""
    sigma: Array | None = None
    """(n,) or None: standard deviation of depth, in the file's unit, where the file has it."""
    mm: float = 1.0
    """What the file's kind of unit usually is."""


def read_foreign_cloud(path: Path) -> ForeignCloud:
    """Read a cloud by the ending of its name."""
    path = Path(path)
    check_regular_file(path, SceneError)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        endings = ", ".join(sorted(_READERS))
        raise UsageError(f"{path}: found the ending {path.suffix!r}, expected a cloud: {endings}; or a depth map")
    package = _PACKAGES.get(path.suffix.lower())
    if package and find_spec(package) is None:
        raise UsageError(f"{path}: found no {package}, expected it installed: pip install flushline[export]")
    try:
        found = reader(path)
    except SceneError:
        raise
    except Exception as problem:  # what a damaged file makes of four libraries
        said = " ".join(str(problem).split())[:120] or type(problem).__name__
        raise SceneError(f"{path}: found a file that cannot be read ({said}), expected a cloud") from None
    if not np.isfinite(found.points).all(axis=1).any():
        raise SceneError(f"{path}: found no points, expected a cloud")
    return found


def read_depth_map(path: Path) -> Array:
    """(h, w) depths in the file's unit, NaN where they are 0 or none; PNG, TIFF or npy."""
    check_regular_file(path, SceneError)
    try:
        if path.suffix.lower() == ".npy":
            depth = np.load(path, allow_pickle=False)
        else:
            depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    except (ValueError, OSError, EOFError, cv2.error):
        depth = None
    if depth is None or depth.ndim != 2 or depth.dtype == np.uint8 or depth.dtype.kind not in "uif":
        found = "no picture" if depth is None else f"{depth.dtype} of shape {depth.shape}"
        raise SceneError(f"{path}: found {found}, expected a depth map: one channel of 16 bit or of floats")
    depth = depth.astype(float)
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.nan)


def _ply(path: Path) -> ForeignCloud:
    return _by_open3d(path, _told_grid(_header(path, "end_header"), _PLY_GRID))


def _pcd(path: Path) -> ForeignCloud:
    grid = _told_grid(_header(path, "DATA"), _PCD_GRID)
    return _by_open3d(path, grid if grid and grid[0] > 1 else None)


def _by_open3d(path: Path, grid: tuple[int, int] | None) -> ForeignCloud:
    """Every property of the points as Open3D reads them, in the file's order."""
    open3d = load_open3d()
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        cloud = open3d.t.io.read_point_cloud(str(path))
    if "positions" not in cloud.point or not len(cloud.point.positions):
        raise SceneError(f"{path}: found no points, expected a whole {path.suffix[1:].upper()} file")
    values = {name: cloud.point[name].numpy() for name in cloud.point}
    columns = {name: value.ravel() for name, value in values.items() if value.ndim == 1 or value.shape[1] == 1}
    columns |= dict(zip("xyz", values["positions"].T, strict=True))
    if "colors" in values:
        columns |= dict(zip(_COLOURS[0], values["colors"].T, strict=True))
    return _from_columns(columns, grid)


def _header(path: Path, end: str) -> str:
    """The text before a file's numbers."""
    with path.open("rb") as file:
        text, found, _ = file.read(_HEADER_BYTES).decode("latin-1").partition(end)
    if not found:
        raise SceneError(f"{path}: found no {end} in its first {_HEADER_BYTES} bytes, expected a whole file")
    return text


def _e57(path: Path) -> ForeignCloud:
    import pye57

    file = pye57.E57(str(path))
    try:
        if file.scan_count != 1:
            raise SceneError(f"{path}: found {file.scan_count} scans, expected one")
        raw = file.read_scan_raw(0)
    finally:
        file.close()
    values = {name.removeprefix("cartesian").lower() if "cartesian" in name else name: v for name, v in raw.items()}
    if "cartesianinvalidstate" in (key.lower() for key in raw):
        bad = np.asarray(raw["cartesianInvalidState"]) != 0
        for axis in "xyz":
            values[axis] = np.where(bad, np.nan, values[axis])
    if "rowIndex" not in raw or "columnIndex" not in raw:
        return _from_columns(values, None, MM_PER_METRE)
    row, column = (np.asarray(raw[name], np.int64) for name in ("rowIndex", "columnIndex"))
    row, column = row - min(row.min(), 0), column - min(column.min(), 0)
    grid = int(row.max()) + 1, int(column.max()) + 1
    laid = {}
    for name, value in values.items():
        full = np.full(grid[0] * grid[1], _empty(value), value.dtype)
        full[row * grid[1] + column] = value
        laid[name] = full
    return _from_columns(laid, grid, MM_PER_METRE)


def _npz(path: Path) -> ForeignCloud:
    with np.load(path, allow_pickle=False) as archive:
        values = {name: archive[name] for name in archive.files}
    points = next((values[name] for name in ("points", "xyz", "pointcloud") if name in values), None)
    if points is None and {"x", "y", "z"} <= set(values):
        points = np.stack([values[axis] for axis in "xyz"], axis=-1)
    if points is None or points.shape[-1] != 3 or points.ndim not in (2, 3):
        raise SceneError(f"{path}: found {', '.join(sorted(values))}, expected points of shape (h, w, 3) or (n, 3)")
    grid = (points.shape[0], points.shape[1]) if points.ndim == 3 else None
    grey = next(
        (values[n] for n in ("picture", "texture", "grey", "gray", "intensity", "rgb", "colors") if n in values), None
    )
    if grey is not None and grey.ndim == points.ndim and grey.shape[-1] in (3, 4):
        grey = grey[..., :3] @ _RGB_TO_GREY
    sigma = next((values[name] for name in _SIGMAS if name in values), None)
    flat = points.reshape(-1, 3).astype(float)
    return ForeignCloud(
        flat,
        grid,
        None if grey is None else _as_levels(grey.ravel()),
        None if sigma is None else sigma.ravel().astype(float),
    )


_READERS: dict[str, Callable[[Path], ForeignCloud]] = {".ply": _ply, ".pcd": _pcd, ".e57": _e57, ".npz": _npz}
_PACKAGES = {".e57": "pye57"}


def _from_columns(values: Mapping[str, NDArray], grid: tuple[int, int] | None, mm: float = 1.0) -> ForeignCloud:
    """From one array per property."""
    if missing := [axis for axis in "xyz" if axis not in values]:
        raise SceneError(f"found no property {missing[0]!r}, expected x, y and z")
    points = np.stack([np.asarray(values[axis], float) for axis in "xyz"], axis=1)
    points[(points == 0).all(axis=1)] = np.nan  # as some scanners write empty cells
    if grid and grid[0] * grid[1] != len(points):
        grid = None
    grey = None
    for names in _COLOURS:
        if all(name in values for name in names):
            grey = np.stack([np.asarray(values[name], float) for name in names], axis=1) @ _RGB_TO_GREY
            break
    else:
        lower = {name.lower(): value for name, value in values.items()}
        grey = next((np.asarray(lower[name], float) for name in _GREYS if name in lower), None)
    sigma = next((np.asarray(values[name], float) for name in _SIGMAS if name in values), None)
    return ForeignCloud(points, grid, None if grey is None else _as_levels(grey), sigma, mm)


def _as_levels(grey: NDArray) -> NDArray[Any]:
    """Brightness as whole grey levels: 8 bit as they are, shares of 1 and wider ranges as 16 bit."""
    if grey.dtype in (np.uint8, np.uint16):
        return grey
    known = np.nan_to_num(np.asarray(grey, float), nan=0.0, posinf=0.0, neginf=0.0)
    largest = float(known.max(initial=0.0))
    if largest <= 1.0:
        return np.rint(np.clip(known, 0, 1) * 65535).astype(np.uint16)
    if largest <= 255.0:
        return np.rint(np.clip(known, 0, 255)).astype(np.uint8)
    return np.rint(np.clip(known, 0, None) * min(1.0, 65535 / largest)).astype(np.uint16)


def _empty(values: NDArray) -> Any:
    """What stands for nothing in an array."""
    return np.nan if values.dtype.kind == "f" else 0


def _told_grid(header: str, words: re.Pattern[str]) -> tuple[int, int] | None:
    """Rows and columns as a header tells them."""
    found: dict[str, int] = {}
    for word, number in words.findall(header):
        found.setdefault(
            "rows" if word.lower().endswith("rows") or word.lower() == "height" else "columns", int(number)
        )
    return (found["rows"], found["columns"]) if len(found) == 2 else None

"""Lengths on a flat board of known features, triangulated by a rig: what tells of the rig's scale over its field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array
from metrology.calibration.board import Board
from metrology.calibration.detect_board import BoardView
from metrology.calibration.eccentricity import eccentricity
from metrology.errors import CalibrationError
from metrology.rig import Device, Rig

_LEAST = 12
_ROUNDS = 2  # of removing the discs' eccentricity, which needs the board's pose


@dataclass(frozen=True)
class BoardLengths:
    """A board in one pose."""

    n: int
    """Features that both cameras saw."""
    lengths: tuple[tuple[str, float, float, float], ...]
    """tuple of (name, measured, u95, nominal): longest distances along the rows, the columns and both diagonals, mm."""
    flatness_mm: float
    """Range of the features' distances from their plane."""
    epipolar_rms_px: float
    """How far the two cameras' rays miss each other, in left pixels."""


def board_lengths(rig: Rig, board: Board, left: BoardView, right: BoardView) -> BoardLengths:
    """Triangulate the features that both cameras found, and compare their distances with the board's."""
    index, a, b = np.intersect1d(left.index, right.index, return_indices=True)
    if len(index) < _LEAST:
        raise CalibrationError(f"board: found {len(index)} features in both pictures, expected {_LEAST} or more")
    pixels = [left.pixels[a], right.pixels[b]]
    known = board.points[index]
    points, miss = triangulated(rig, pixels)
    for _ in range(_ROUNDS if board.radius_mm else 0):
        R, t = fitted_pose(known, points)
        free = [
            pixel - eccentricity(_image_of(device, R, t), known[:, :2], board.radius_mm)
            for device, pixel in zip((rig.left, rig.with_right()), pixels, strict=True)
        ]
        points, miss = triangulated(rig, free)
    R, t = fitted_pose(known, points)
    residual = (points - t) @ R - known
    sigma = np.sqrt((residual**2).sum(0) / max(len(index) - 2, 1))
    lengths = []
    for name, (i, j) in ends(known).items():
        along = (known[j] - known[i]) / np.linalg.norm(known[j] - known[i])
        u95 = 2 * np.sqrt(2) * float(np.linalg.norm(sigma * along))
        measured, nominal = (float(np.linalg.norm(of[j] - of[i])) for of in (points, known))
        lengths.append((name, measured, u95, nominal))
    return BoardLengths(len(index), tuple(lengths), float(np.ptp(residual[:, 2])), miss)


def _image_of(device: Device, R: Array, t: Array) -> Callable[[Array], Array]:
    return lambda plane: device.project(np.column_stack([plane, np.zeros(len(plane))]) @ R.T + t)


def triangulated(rig: Rig, pixels: list[Array]) -> tuple[Array, float]:
    """Middles of the shortest lines between both cameras' rays, and the RMS of these lines in left pixels."""
    origins = [device.centre for device in (rig.left, rig.with_right())]
    rays = [device.rays(pixel) for device, pixel in zip((rig.left, rig.with_right()), pixels, strict=True)]
    base = origins[1] - origins[0]
    cosine = (rays[0] * rays[1]).sum(1)
    first, second = rays[0] @ base, rays[1] @ base
    s = (first - cosine * second) / (1 - cosine**2)
    u = (cosine * first - second) / (1 - cosine**2)
    ends = origins[0] + s[:, None] * rays[0], origins[1] + u[:, None] * rays[1]
    miss = np.linalg.norm(ends[1] - ends[0], axis=1) * rig.left.K[0, 0] / s
    return 0.5 * (ends[0] + ends[1]), float(np.sqrt(np.mean(miss**2)))


def fitted_pose(known: Array, points: Array) -> tuple[Array, Array]:
    """Rigid motion from the board's frame to the rig's."""
    middle, seen = known.mean(0), points.mean(0)
    u, _, vt = np.linalg.svd((points - seen).T @ (known - middle))
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return R, seen - R @ middle


def ends(known: Array) -> dict[str, tuple[int, int]]:
    """The features at the ends of the longest lines."""
    x, y = known[:, 0], known[:, 1]
    corners = {"diagonal": (x + y, x + y), "other diagonal": (x - y, x - y)}
    ends = {name: (int(a.argmin()), int(b.argmax())) for name, (a, b) in corners.items()}
    for name, along, across in (("row", x, y), ("column", y, x)):
        line = np.flatnonzero(np.isclose(across, _middle(across)))
        ends[name] = (int(line[along[line].argmin()]), int(line[along[line].argmax()]))
    return {name: pair for name, pair in ends.items() if pair[0] != pair[1]}


def _middle(values: Array) -> float:
    """The value nearest to the middle of all different ones."""
    different = np.unique(values)
    return float(different[len(different) // 2])

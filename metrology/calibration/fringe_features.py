"""A projector coordinate for every board feature, from fringes shown in both axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.calibration.board import Board
from metrology.calibration.detect_board import BoardView
from metrology.calibration.eccentricity import eccentricity
from metrology.calibration.homography import apply_homography, fit_homography, unit_area
from metrology.errors import CalibrationError
from metrology.robust import MAD

_LEAST_PIXELS = 60
_TRIM_SIGMAS = 3.5
_LEAST_PART = 0.5  # of the board's features


@dataclass(frozen=True)
class CodedView:
    """Projector pixels of the board features that one camera found."""

    index: NDArray[np.intp]
    """(n,) int array: which features (rows of `Board.points`)."""
    projector_px: Array
    """(n, 2): projector column and row."""
    sigma_px: Array
    """(n,): standard deviation of each coordinate, from the scatter about the local fit."""


def coded_features(view: BoardView, coordinate: NDArray[np.floating], board: Board) -> CodedView:
    """Read decoded fringes at the features.

    About each feature the projector's column and row are fitted by a quadratic of the camera's pixel (the board is flat
    and the lens smooth), which averages noise and the ripple of the projector's gamma and reads the value under dark
    print from the paper around it. Values are read where the feature's true centre is seen.

    Parameters
    ----------
    coordinate : (h, w, 2) array
        Projector column and row at every pixel, NaN where there is none.
    """
    points = board.points[view.index, :2]
    homography = fit_homography(points, view.pixels)
    centres = view.pixels
    if board.has_dots:
        centres = centres - eccentricity(lambda p: apply_homography(homography, p), points, board.radius_mm)
    reach = board.least_distance_mm * np.sqrt(unit_area(homography, points))
    found, pixels, sigmas = [], [], []
    for k, (centre, radius) in enumerate(zip(centres, reach, strict=True)):
        read = _local_value(coordinate, centre, radius)
        if read is not None:
            found.append(view.index[k])
            pixels.append(read[0])
            sigmas.append(read[1])
    if len(found) < _LEAST_PART * len(board.grid):
        raise CalibrationError(
            f"fringes give {len(found)} of the board's {len(board.grid)} features a projector coordinate, expected at "
            f"least {_LEAST_PART:.0%}"
        )
    return CodedView(np.array(found, np.intp), np.array(pixels), np.array(sigmas))


def _local_value(coordinate: NDArray[np.floating], centre: Array, radius: float) -> tuple[Array, float] | None:
    u0, v0 = np.maximum(np.floor(centre - radius).astype(int), 0)
    u1, v1 = np.ceil(centre + radius).astype(int) + 1
    patch = np.asarray(coordinate[v0:v1, u0:u1], float)
    v, u = np.mgrid[v0 : v0 + patch.shape[0], u0 : u0 + patch.shape[1]]
    x, y = (u - centre[0]) / radius, (v - centre[1]) / radius
    usable = np.isfinite(patch).all(-1) & (x * x + y * y < 1)
    if usable.sum() < _LEAST_PIXELS:
        return None
    x, y, value = x[usable], y[usable], patch[usable]
    design = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    for _ in range(3):
        solution = np.linalg.lstsq(design, value, rcond=None)[0]
        off = np.abs(value - design @ solution)
        scatter = MAD * np.median(off, axis=0) + 1e-9
        keep = (off < _TRIM_SIGMAS * scatter).all(1)
        if keep.all() or keep.sum() < _LEAST_PIXELS:
            break
        design, value = design[keep], value[keep]
    leverage = np.linalg.pinv(design.T @ design)[0, 0]
    return solution[0], float(np.sqrt(leverage) * np.sqrt(np.mean(np.square(scatter))))

"""Which feature of the board each place of a lattice is, and the turns after which a board looks the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.calibration.board import Board
from metrology.calibration.lattice import Labels, turned
from metrology.errors import CalibrationError

LEAST_PART = 0.75  # of the features: with fewer the board is only half in view
_STRAY = 2  # blobs that fit the lattice by chance


@dataclass(frozen=True)
class Placement:
    """A lattice laid onto the board."""

    on_board: NDArray[np.intp]
    """(m,) int array: rows of the lattice that lie on the board."""
    index: NDArray[np.intp]
    """(m,) int array: their features (rows of `Board.points`)."""


def symmetries(board: Board) -> list[NDArray[np.intp]]:
    """Turns of the board after which it looks the same: which feature each feature comes to lie on.

    The first is no turn at all. A chessboard's colours must come to lie on their like; a ChArUco board's
    markers never do.
    """
    if board.kind == "charuco":
        return [np.arange(len(board.grid))]
    feature = {(int(x), int(y)): k for k, (x, y) in enumerate(board.grid)}
    found = []
    for turn in range(4):
        places = turned(board.grid, turn)
        places = places - places.min(0)
        index = np.array([feature.get((int(x), int(y)), -1) for x, y in places], np.intp)
        if (index >= 0).all() and (board.kind != "chessboard" or _same_colours(board, index, turn)):
            found.append(index)
    return found


def _same_colours(board: Board, index: NDArray[np.intp], turn: int) -> bool:
    """A quarter turn exchanges black and white about a corner, and so does a step to the next corner."""
    parity = board.grid.sum(1)
    return bool((((parity[index] - parity) % 2) == turn % 2).all())


def place(labels: Labels, board: Board) -> list[Placement]:
    """The ways to lay a lattice onto the board that put most of it there, one for each turn that fits.

    CalibrationError where the lattice is another board's, or fits in more than one place.
    """
    fits: list[Placement] = []
    what = "dots" if board.has_dots else "corners"
    for turn in range(4):
        fits += _shifted(turned(labels, turn), board)
    if not fits:
        seen, expected = np.ptp(labels, axis=0), np.ptp(board.grid, axis=0)
        raise CalibrationError(
            f"found {len(labels)} {what} on a lattice {seen[0]} × {seen[1]} spacings wide, expected the {board}, "
            f"{expected[0]} × {expected[1]}: wrong board size"
        )
    most = max(len(fit.index) for fit in fits)
    if most < LEAST_PART * len(board.grid):
        raise CalibrationError(
            f"found {most} of {len(board.grid)} {what} of the {board}: board half in view or another one"
        )
    return [fit for fit in fits if len(fit.index) == most]


def _shifted(places: Labels, board: Board) -> list[Placement]:
    grid = board.grid
    feature = {(int(x), int(y)): k for k, (x, y) in enumerate(grid)}
    slack = grid.max(0) - grid.min(0) - np.ptp(places, axis=0)
    if (slack < -_STRAY).any():
        return []
    fits = []
    for x in range(min(0, slack[0]), max(0, slack[0]) + 1):
        for y in range(min(0, slack[1]), max(0, slack[1]) + 1):
            shifted = places - places.min(0) + grid.min(0) + (x, y)
            index = np.array([feature.get((int(i), int(j)), -1) for i, j in shifted])
            on_board = np.flatnonzero(index >= 0)
            if len(places) - len(on_board) <= _STRAY:
                fits.append(Placement(on_board, index[on_board]))
    return fits


def upright(fits: list[Placement], pixels: Array, board: Board) -> Placement:
    """Of placements that differ by a turn after which the board looks the same, the one most nearly upright.

    Parameters
    ----------
    pixels : (n, 2) array
        Of the lattice's rows. The board's x axis then points most nearly along +u.

    CalibrationError where they differ by anything else: then the lattice does not tell where on the board it lies.
    """
    best = max(fits, key=lambda fit: _along_u(board.grid[fit.index], pixels[fit.on_board]))
    alike = [turn[best.index] for turn in symmetries(board)]
    for fit in fits:
        same = np.array_equal(fit.on_board, best.on_board)
        if not (same and any(np.array_equal(fit.index, index) for index in alike)):
            what = "dots" if board.has_dots else "corners"
            raise CalibrationError(
                f"found {len(best.index)} of {len(board.grid)} {what} of the {board}, which fit in more than one "
                "place: a row or column is out of view, or the board is another one"
            )
    return best


def _along_u(grid: Labels, pixels: Array) -> float:
    """Cosine of the angle between the board's x axis and +u in the image."""
    centred = grid - grid.mean(0)
    axes = np.linalg.lstsq(centred, pixels - pixels.mean(0), rcond=None)[0]
    return float(axes[0, 0] / np.linalg.norm(axes[0]))

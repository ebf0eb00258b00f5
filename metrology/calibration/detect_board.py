"""The board's printed features in a picture, to a few thousandths of a pixel for dots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.calibration.blobs import printed_blobs
from metrology.calibration.board import Board
from metrology.calibration.corner_edge import fit_corner
from metrology.calibration.dot_edge import DotFit, fit_dot
from metrology.calibration.frames import BoardFrames
from metrology.calibration.homography import apply_homography, fit_homography, unit_area
from metrology.calibration.lattice import Labels, diagonal_to_grid, label_lattice
from metrology.calibration.placing import LEAST_PART, Placement, place, upright
from metrology.errors import CalibrationError

# Of a ChArUco board: which squares bear the markers. Boards with an odd number of rows are alike in both.
Layout = Literal["new", "old"]

LARGEST_SIGMA_PX = 0.03
_USELESS_SIGMA_PX = 0.3
_OUT_OF_PLACE = 0.5  # of a square
_LEAST_RIM = 0.8
_OVEREXPOSED = 0.02
_SIZE_TOLERANCE = 0.1  # of a dot's diameter over its spacing against the board's description
_BLUR_OF_DOT = 0.35  # blur over a dot's smaller radius at which its middle no longer reaches its own level
_REACH = 0.4  # of a square: how far from a corner its edges are used
_BLUR_OF_SQUARE = 0.1
_OLDER_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE


@dataclass(frozen=True)
class BoardView:
    """Features of the board that one camera found."""

    index: NDArray[np.intp]
    """(n,) int array: which features (rows of `Board.points`)."""
    pixels: Array
    """(n, 2): raw pixels; of dots the ellipse's centre, perspective eccentricity still in it."""
    sigma_px: Array
    """(n,): standard deviation of each coordinate as the fit's residual tells it."""
    blur_px: float
    """Median blur of the edges; NaN where the detector does not tell."""
    size: tuple[int, int]
    """Width and height of the image."""
    layout: Layout | None = None
    """Of a ChArUco board: as OpenCV draws it since 4.6, or before; None where there is no difference."""
    otherwise: BoardView | None = None
    """The picture read by the other layout, where the markers in view do not tell which it is."""


def detect_board(frames: BoardFrames, board: Board) -> BoardView:
    """Find the board's features; CalibrationError says what is wrong with a picture in which they are not."""
    lit = frames.lit
    if np.quantile(lit, 0.99) < 8:
        raise CalibrationError("the picture is dark: white and dark frames hardly differ")
    everywhere = float(frames.saturated.mean())
    try:
        view = _detect(frames, lit, board)
    except CalibrationError as problem:
        if everywhere <= _OVEREXPOSED:
            raise
        if not board.has_dots:
            raise CalibrationError(f"{problem} (overexposed, too: {everywhere:.0%} of the white frame)") from None
        raise CalibrationError(
            f"overexposed: {everywhere:.0%} of the white frame is saturated, expected next to none ({problem})"
        ) from None
    if not board.has_dots:
        return view  # corners are fitted to what is not clipped
    overexposed = _saturated_share(frames, view.pixels) if everywhere > _OVEREXPOSED else 0.0
    if overexposed > _OVEREXPOSED:
        raise CalibrationError(f"overexposed: {overexposed:.0%} of the board is saturated, expected next to none")
    return view


def _detect(frames: BoardFrames, lit: Array, board: Board) -> BoardView:
    if board.has_dots:
        return _detect_dots(frames, lit, board)
    grey = np.clip(lit * (255.0 / np.quantile(lit, 0.995)), 0, 255).astype(np.uint8)
    detect_corners = _detect_charuco if board.kind == "charuco" else _detect_chessboard
    return detect_corners(grey, lit, frames.saturated, board)


def _saturated_share(frames: BoardFrames, pixels: Array) -> float:
    """Share of the board, as far as its features reach, that is clipped: what lies around it matters to nobody."""
    inside = np.zeros(frames.white.shape, np.uint8)
    cv2.fillConvexPoly(inside, cv2.convexHull(np.rint(pixels).astype(np.int32)), 1)
    return float(frames.saturated[inside > 0].mean())


def _detect_dots(frames: BoardFrames, lit: Array, board: Board) -> BoardView:
    weight = np.where(frames.saturated, 0.0, 1.0)
    fits = [fit for fit in (fit_dot(lit, weight, c) for c in printed_blobs(lit)) if fit is not None]
    fits = [fit for fit in fits if fit.rim_fraction > _LEAST_RIM]
    expected = len(board.grid)
    if len(fits) < LEAST_PART * expected:
        blur = ", their edges are blurred" if fits and _blurred(fits) else ""
        raise CalibrationError(
            f"found {len(fits)} dots{blur}, expected {expected} of the {board}: board half in view, "
            "blurred or another one"
        )
    if _blurred(fits):
        raise CalibrationError(
            f"blurred: edges have σ {np.median([f.blur_px for f in fits]):.1f} px on dots of "
            f"{np.median([f.minor_radius_px for f in fits]):.0f} px radius"
        )
    centres = np.array([fit.centre for fit in fits])
    found, labels = label_lattice(centres)
    if board.kind == "asymmetric_circles":
        labels = diagonal_to_grid(labels)
    placed = upright(place(labels, board), centres[found], board)
    chosen = [fits[k] for k in found[placed.on_board]]
    view = BoardView(
        placed.index,
        np.array([fit.centre for fit in chosen]),
        np.array([fit.sigma_px for fit in chosen]),
        float(np.median([fit.blur_px for fit in chosen])),
        frames.size,
    )
    _check_dots(view, chosen, board)
    return view


def _blurred(fits: list[DotFit]) -> bool:
    return bool(np.median([fit.blur_px / fit.minor_radius_px for fit in fits]) > _BLUR_OF_DOT)


def _check_dots(view: BoardView, fits: list[DotFit], board: Board) -> None:
    """Refuse dots of another size than described, and centres that are not sharp enough."""
    points = board.points[view.index, :2]
    areas = np.array([fit.area for fit in fits]) / unit_area(fit_homography(points, view.pixels), points)
    diameter = float(np.median(2 * np.sqrt(areas / np.pi)))
    if abs(diameter / (2 * board.radius_mm) - 1) > _SIZE_TOLERANCE:
        raise CalibrationError(
            f"found dots of {diameter / board.spacing_mm:.2f} spacings across, expected "
            f"{2 * board.radius_mm / board.spacing_mm:.2f} for the {board}: wrong board or wrong sizes"
        )
    sigma = float(np.median(view.sigma_px))
    if sigma > LARGEST_SIGMA_PX:
        raise CalibrationError(
            f"dot centres are only known to {sigma:.3f} px (blur {view.blur_px:.1f} px), expected "
            f"{LARGEST_SIGMA_PX} px: blurred or too dark"
        )


def _detect_chessboard(grey: NDArray[np.uint8], lit: Array, clipped: NDArray[np.bool_], board: Board) -> BoardView:
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    pattern = (board.cols, board.rows)
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(grey, pattern, flags | cv2.CALIB_CB_LARGER)
    rows, cols = (meta.shape[0], meta.shape[1]) if found else (board.rows, board.cols)
    if not found:  # the older detector finds boards in pictures in which this one does not
        found, corners = cv2.findChessboardCorners(grey, pattern, flags=_OLDER_FLAGS)
    if not found:
        smaller, _, meta = cv2.findChessboardCornersSBWithMeta(grey, (3, 3), flags | cv2.CALIB_CB_LARGER)
        there = f": found one of {meta.shape[1]} × {meta.shape[0]} inner corners" if smaller else ""
        raise CalibrationError(f"did not find the {board}{there}: half in view, blurred or another one")
    if {rows, cols} != {board.cols, board.rows}:
        raise CalibrationError(
            f"found a chessboard of {cols} × {rows} inner corners, expected {board.cols} × "
            f"{board.rows}: wrong board size"
        )
    pixels = np.asarray(corners, float).reshape(-1, 2)
    fits = place(_rows_of_corners(pixels, rows), board)
    # Corners lie alike on boards of other colours: black squares on black ones, where there is a choice.
    coloured = [fit for fit in fits if _contrast(lit, board, fit, pixels) > 0]
    placed = upright(coloured or fits, pixels, board)
    return _refine_corners(lit, clipped, board, placed.index, pixels[placed.on_board])


def _rows_of_corners(pixels: Array, rows: int) -> Labels:
    """Places (x, y) of corners listed row by row, never mirrored: +x turns to +y as +u to +v."""
    cols = len(pixels) // rows
    y, x = np.divmod(np.arange(len(pixels)), cols)
    homography = fit_homography(np.column_stack([x, y]), pixels)
    mirrored = np.linalg.det(homography) < 0
    return np.column_stack([cols - 1 - x if mirrored else x, y])


def _contrast(lit: Array, board: Board, fit: Placement, pixels: Array) -> float:
    """Grey levels of the squares that should be white less those that should be black.

    Square (i, j), whose lower right corner is corner (i, j), is black where i + j is even.
    """
    homography = fit_homography(board.grid[fit.index], pixels[fit.on_board])
    j, i = np.mgrid[1 : board.rows, 1 : board.cols]
    at = np.rint(apply_homography(homography, np.column_stack([i.ravel(), j.ravel()]) - 0.5)).astype(int)
    level = lit[np.clip(at[:, 1], 0, lit.shape[0] - 1), np.clip(at[:, 0], 0, lit.shape[1] - 1)]
    black = ((i + j) % 2 == 0).ravel()
    return float(level[~black].mean() - level[black].mean())


def _detect_charuco(grey: NDArray[np.uint8], lit: Array, clipped: NDArray[np.bool_], board: Board) -> BoardView:
    """Find the corners by either layout of the board: OpenCV changed it in 4.6 for boards of even rows."""
    identifier = getattr(cv2.aruco, board.dictionary or "", None)
    if not isinstance(identifier, int):
        raise CalibrationError(f"ChArUco dictionary: found {board.dictionary!r}, expected a name such as DICT_5X5_100")
    printed = cv2.aruco.CharucoBoard(
        (board.cols, board.rows),
        board.spacing_mm,
        float(board.marker_mm or 0),
        cv2.aruco.getPredefinedDictionary(identifier),
    )
    layouts: tuple[Layout | None, ...] = ("new", "old") if board.rows % 2 == 0 else (None,)
    found: dict[Layout | None, tuple[NDArray[np.intp], Array]] = {}
    in_place: dict[Layout | None, int] = {}
    for layout in layouts:
        printed.setLegacyPattern(layout == "old")
        corners, ids, markers, marker_ids = cv2.aruco.CharucoDetector(printed).detectBoard(grey)
        if ids is not None and len(ids):
            found[layout] = np.asarray(ids).ravel().astype(np.intp), np.asarray(corners, float).reshape(-1, 2)
            in_place[layout] = _markers_in_place(printed, board, *found[layout], markers, marker_ids)
    best = max(found, key=lambda layout: (in_place[layout], len(found[layout][0])), default=None)
    index, pixels = found.get(best, (np.empty(0, np.intp), np.empty((0, 2))))
    expected = len(board.grid)
    if len(index) < 0.25 * expected or len(index) < 6:
        tried = ", in neither layout (before OpenCV 4.6, and since)" if len(layouts) > 1 else ""
        raise CalibrationError(
            f"found {len(index)} of {expected} corners of the {board}{tried}: half in view, blurred or another one"
        )
    view = replace(_refine_corners(lit, clipped, board, index, pixels), layout=best)
    other = next((layout for layout in found if layout != best), None)
    if other is None or in_place[other] < in_place[best]:
        return view
    turned = replace(_refine_corners(lit, clipped, board, *found[other]), layout=other)
    return replace(view, otherwise=turned)


def _markers_in_place(
    printed: cv2.aruco.CharucoBoard,
    board: Board,
    index: NDArray[np.intp],
    pixels: Array,
    markers: Sequence[NDArray[Any]],
    ids: NDArray[Any] | None,
) -> int:
    """How many markers lie where the board has them, by its corners: of the other layout some are out of place."""
    if len(index) < 4 or ids is None:
        return 0
    homography = fit_homography(pixels, board.points[index, :2])
    seen = apply_homography(homography, np.array([np.reshape(marker, (4, 2)).mean(0) for marker in markers], float))
    places = [np.asarray(corners, float).reshape(-1, 3)[:, :2].mean(0) for corners in printed.getObjPoints()]
    known = np.array([places[marker] for marker in np.ravel(ids)])
    return int((np.linalg.norm(seen - known, axis=1) < _OUT_OF_PLACE * board.spacing_mm).sum())


def _refine_corners(
    lit: Array, clipped: NDArray[np.bool_], board: Board, index: NDArray[np.intp], pixels: Array
) -> BoardView:
    """Fit the crossing edges at every corner; the homography tells their directions."""
    points = board.points[index, :2]
    homography = fit_homography(points, pixels)
    scale = np.sqrt(unit_area(homography, points))
    reach = _REACH * board.spacing_mm * scale
    clear = scale * ((board.spacing_mm - board.marker_mm) / 2 if board.marker_mm else np.inf)
    fits, kept = [], []
    for k, start in enumerate(pixels):
        ends = apply_homography(homography, points[k] + np.eye(2)) - apply_homography(homography, points[k] - np.eye(2))
        along = ends / np.linalg.norm(ends, axis=1, keepdims=True)
        fit = fit_corner(lit, start, along, float(reach[k]), float(clear[k]), clipped)
        if fit is not None:
            fits.append(fit)
            kept.append(k)
    # A coarse or noisy camera knows all corners less well; what is worse than most is no corner.
    typical = float(np.median([fit.sigma_px for fit in fits])) if fits else 0.0
    limit = min(3 * max(LARGEST_SIGMA_PX, typical), _USELESS_SIGMA_PX)
    sharp = [(fit, k) for fit, k in zip(fits, kept, strict=True) if fit.sigma_px < limit]
    fits, kept = [fit for fit, _ in sharp], [k for _, k in sharp]
    if len(fits) < LEAST_PART * len(pixels):
        raise CalibrationError(
            f"{len(fits)} of {len(pixels)} corners of the {board} are sharp enough to be measured: blurred, too dark, "
            f"or too small (a square is {float(np.median(reach)) / _REACH:.0f} px)"
        )
    blur, spacing = float(np.median([fit.blur_px for fit in fits])), float(np.median(reach)) / _REACH
    if blur > _BLUR_OF_SQUARE * spacing:
        raise CalibrationError(f"blurred: edges have σ {blur:.1f} px on squares of {spacing:.0f} px")
    return BoardView(
        index[kept],
        np.array([fit.centre for fit in fits]),
        np.array([fit.sigma_px for fit in fits]),
        blur,
        (lit.shape[1], lit.shape[0]),
    )

"""A printed calibration board: what is on it, and what a camera sees of it (analytically, edge for edge)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np

from metrology.errors import SpecError
from metrology.rig import Device
from simulator.compiled import entry, kernel
from simulator.lens import moved, pack_device, pixel, ray
from simulator.relief import Floats
from simulator.trace import Hits, four, share_bands, spread, widened

_KINDS = ("asymmetric_circles", "circles", "chessboard", "charuco")


@dataclass(frozen=True)
class PrintedBoard:
    """A flat board; its features lie at z = 0 of its own frame, x along a row, y down the rows.

    Attributes
    ----------
    cols, rows, spacing_mm, dot_diameter_mm, marker_mm, dictionary
        As in calibration.json.
    """

    kind: Literal["asymmetric_circles", "circles", "chessboard", "charuco"] = "asymmetric_circles"
    """asymmetric_circles: dots at ((2c + r mod 2) s, r s); circles: at (c s, r s); chessboard: inner corners at (c s, r
    s), the square above and to the left of the first corner black; charuco: OpenCV's board of cols × rows squares,
    its inner corners at ((c + 1) s, (r + 1) s)."""
    cols: int = 7
    rows: int = 11
    spacing_mm: float = 15.0
    dot_diameter_mm: float = 8.0
    marker_mm: float = 11.0
    dictionary: str = "DICT_5X5_100"
    layout: Literal["new", "old"] = "new"
    """Of a ChArUco board with an even number of rows: "old" has a white square in its upper left corner, as OpenCV drew
    it before 4.6."""
    border_mm: float = 15.0
    """White margin around the outermost features."""
    paper: float = 0.8
    ink: float = 0.06
    """paper, ink: reflectances."""

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise SpecError(f"board kind: found {self.kind!r}, expected one of {', '.join(_KINDS)}")
        if self.cols < 3 or self.rows < 3 or self.spacing_mm <= 0:
            raise SpecError(f"board: found {self.cols} × {self.rows} at {self.spacing_mm} mm, expected at least 3 × 3")
        if self.layout not in ("new", "old"):
            raise SpecError(f"board layout: found {self.layout!r}, expected new or old")
        if self.kind == "charuco" and not hasattr(cv2.aruco, self.dictionary):
            raise SpecError(f"board dictionary: found {self.dictionary!r}, expected an OpenCV name as DICT_5X5_100")

    @property
    def corners_mm(self) -> tuple[float, float, float, float]:
        """x_min, x_max, y_min, y_max of the paper."""
        s, b = self.spacing_mm, self.border_mm
        if self.kind == "charuco":
            return -b, self.cols * s + b, -b, self.rows * s + b
        reach = s if self.kind == "chessboard" else 0.5 * self.dot_diameter_mm
        across = (2 * self.cols - 1) * s if self.kind == "asymmetric_circles" else (self.cols - 1) * s
        return -reach - b, across + reach + b, -reach - b, (self.rows - 1) * s + reach + b

    @property
    def middle_mm(self) -> Floats:
        """(3,) middle of the paper in the board's frame."""
        x0, x1, y0, y1 = self.corners_mm
        return np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])

    def as_dict(self) -> dict[str, Any]:
        """As calibration.json has it."""
        table: dict[str, Any] = {
            "type": self.kind, "cols": self.cols, "rows": self.rows, "spacing_mm": self.spacing_mm,
        }  # fmt: skip
        if self.kind == "charuco":
            return table | {"marker_mm": self.marker_mm, "dictionary": self.dictionary}
        if self.kind != "chessboard":
            table["dot_diameter_mm"] = self.dot_diameter_mm
        return table


class _Print(NamedTuple):
    """The board for the kernels: kind, sizes, paper's corners, reflectances, and the charuco markers' modules.

    `white` is (i + j) mod 2 of a ChArUco board's white squares.
    """

    kind: int
    cols: int
    rows: int
    spacing: float
    radius: float
    marker: float
    corners: Floats
    paper: float
    ink: float
    white: int
    modules: np.ndarray


def _pack(board: PrintedBoard) -> _Print:
    modules = np.zeros((1, 1, 1), np.uint8)
    if board.kind == "charuco":
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        size = dictionary.markerSize + 2
        count = board.cols * board.rows // 2
        markers = [cv2.aruco.generateImageMarker(dictionary, k, size) // 255 for k in range(count)]
        modules = np.stack(markers).astype(np.uint8)
    return _Print(
        _KINDS.index(board.kind), board.cols, board.rows, board.spacing_mm, board.dot_diameter_mm / 2,
        board.marker_mm, np.array(board.corners_mm), board.paper, board.ink,
        0 if board.layout == "old" and board.rows % 2 == 0 else 1, np.ascontiguousarray(modules, np.uint8),
    )  # fmt: skip


@kernel
def _printed(board: _Print, x: float, y: float) -> float:
    """Reflectance at a place; −1 off the paper."""
    c = board.corners
    if x < c[0] or x > c[1] or y < c[2] or y > c[3]:
        return -1.0
    s = board.spacing
    if board.kind <= 1:
        row = math.floor(y / s + 0.5)
        for r in range(max(row - 1, 0), min(row + 2, board.rows)):
            start, pitch = (s * (r % 2), 2.0 * s) if board.kind == 0 else (0.0, s)
            column = min(max(math.floor((x - start) / pitch + 0.5), 0), board.cols - 1)
            if math.hypot(x - start - column * pitch, y - r * s) < board.radius:
                return board.ink
        return board.paper
    if board.kind == 2:
        i, j = math.floor(x / s) + 1, math.floor(y / s) + 1
        inside = i >= 0 and j >= 0 and i <= board.cols and j <= board.rows
        return board.ink if inside and (i + j) % 2 == 0 else board.paper
    i, j = math.floor(x / s), math.floor(y / s)
    if i < 0 or j < 0 or i >= board.cols or j >= board.rows:
        return board.paper
    if (i + j) % 2 != board.white:
        return board.ink
    # White squares carry the markers, numbered along the rows.
    number = (j * board.cols + i) // 2
    size, margin = board.modules.shape[1], 0.5 * (s - board.marker)
    u, v = (x - i * s - margin) / board.marker * size, (y - j * s - margin) / board.marker * size
    if u < 0.0 or v < 0.0 or u >= size or v >= size:
        return board.paper
    return board.paper if board.modules[number, int(v), int(u)] else board.ink


@kernel
def _on_board(camera, centre, u, v, d, p):  # type: ignore[no-untyped-def]
    """The point of the plane z = 0 that a pixel sees, into p."""
    ray(camera, u, v, d)
    lam = -centre[2] / d[2]
    for k in range(3):
        p[k] = centre[k] + lam * d[k]


@entry
def _look(board, camera, centre, d, p, top, values):  # type: ignore[no-untyped-def]
    """Print at every pixel's centre and at its corner."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            for k in range(2):
                _on_board(camera, centre, j - 0.5 * k, top + i - 0.5 * k, d, p)
                values[i, j, k] = _printed(board, p[0], p[1])


@entry
def _gather(  # type: ignore[no-untyped-def]
    board, camera, centre, projector, source, level, reference, ambient_level, few, many, d, p, busy, top,
    first, column, row, direct, ambient,
):  # fmt: skip
    """All samples of some rows."""
    width = busy.shape[1]
    for i in range(busy.shape[0]):
        for j in range(width):
            at = first[i * width + j] - first[0]
            if first[i * width + j + 1] - first[i * width + j] == 1:
                column[at], row[at], direct[at], ambient[at] = -1e9, -1e9, 0.0, 0.0
                continue
            spread = many if busy[i, j] else few
            for k in range(spread.shape[0]):
                _on_board(camera, centre, j + spread[k, 0], top + i + spread[k, 1], d, p)
                reflectance = _printed(board, p[0], p[1])
                if reflectance < 0.0:
                    column[at + k], row[at + k], direct[at + k], ambient[at + k] = -1e9, -1e9, 0.0, 0.0
                    continue
                column[at + k], row[at + k] = pixel(projector, p)
                r = math.sqrt((source[0] - p[0]) ** 2 + (source[1] - p[1]) ** 2 + source[2] ** 2)
                direct[at + k] = level * reflectance * abs(source[2]) / r * (reference / r) ** 2
                ambient[at + k] = ambient_level * reflectance


def view_board(
    board: PrintedBoard, R: Floats, t: Floats, camera: Device, projector: Device, brightness: float,
    reference_mm: float, ambient: float, blur_px: float, samples: int = 48,
    progress: Callable[[float], None] = lambda share: None,
) -> Hits:  # fmt: skip
    """What a camera sees of a board at the pose (R, t), board frame to rig frame.

    Parameters
    ----------
    brightness, ambient : float
        Grey levels of a white board that faces the projector `reference_mm` away, and in ambient light alone.
    blur_px, samples
        Point-spread function and rays per pixel near edges, as in `simulator.trace.trace`.
    """
    camera, projector = moved(camera, R, t), moved(projector, R, t)
    packed, eye, beam, printed = pack_device(camera), camera.centre, pack_device(projector), _pack(board)
    height, width = camera.height, camera.width
    values = np.empty((height, width, 2))
    share_bands(
        lambda rows: _look(printed, packed, eye, np.empty(3), np.empty(3), rows.start, values[rows]), height,
        lambda done: progress(0.2 * done),
    )  # fmt: skip
    edge = values[..., 0] != values[..., 1]
    edge[:, 1:] |= values[:, 1:, 0] != values[:, :-1, 0]
    edge[1:] |= values[1:, :, 0] != values[:-1, :, 0]
    busy = widened(edge, 3.2 * blur_px + 0.7)
    few, many = four(blur_px), spread(samples, blur_px)
    # One empty sample stands for what is beside the board.
    counts = np.where(busy, len(many), np.where(values[..., 0] < 0, 1, len(few)))
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    total = int(first[-1])
    hits = Hits(height, width, first, np.empty(total), np.empty(total), np.empty(total, np.float32),
                np.empty(total, np.float32))  # fmt: skip

    def gather(rows: slice) -> None:
        own = first[rows.start * width : rows.stop * width + 1]
        part = slice(int(own[0]), int(own[-1]))
        _gather(printed, packed, eye, beam, projector.centre, brightness, reference_mm, ambient, few, many,
                np.empty(3), np.empty(3), busy[rows], rows.start, own, hits.column[part], hits.row[part],
                hits.direct[part], hits.ambient[part])  # fmt: skip

    share_bands(gather, height, lambda done: progress(0.2 + 0.8 * done))
    return hits

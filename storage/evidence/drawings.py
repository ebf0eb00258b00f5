"""Drawings of artefacts: a plate as DXF (R12) for a shop and as SVG to look at, a board as SVG to print at 100 %.

Flushline's shipped artefacts are ours, and free to copy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from markupsafe import Markup

from metrology.calibration.board import Board
from storage.evidence.artefact import ArtefactFile
from storage.templates import part

_MARGIN = 12.0
_TEXT = 2.5
_ROW = 4.5  # mm between lines of the table


@dataclass(frozen=True)
class Line:
    """A line, mm."""

    layer: str
    x1: float
    y1: float
    x2: float
    y2: float


@dataclass(frozen=True)
class Circle:
    """A circle, mm."""

    layer: str
    x: float
    y: float
    radius: float


@dataclass(frozen=True)
class Text:
    """A line of text that begins at a place, mm."""

    layer: str
    x: float
    y: float
    words: str


Shape = Line | Circle | Text


def plate_shapes(artefact: ArtefactFile) -> list[Shape]:
    """A plate's outline, heads, seams and dimensions; y up, the origin in its middle, as positions are given."""
    width, height = artefact.size_mm or (200.0, 150.0)
    x, y = width / 2, height / 2
    corners = [(-x, -y), (x, -y), (x, y), (-x, y), (-x, -y)]
    shapes: list[Shape] = [Line("OUTLINE", *a, *b) for a, b in pairwise(corners)]
    for rivet in artefact.rivets:
        u, v, r = rivet.position_mm[0], rivet.position_mm[1], rivet.diameter_mm / 2
        shapes += [Circle("HEADS", u, v, r), Line("CENTRES", u - r - 2, v, u + r + 2, v)]
        shapes += [Line("CENTRES", u, v - r - 2, u, v + r + 2), Text("NAMES", u + r + 1, v + 1, rivet.id)]
    for seam in artefact.seams:
        (x0, y0, _), (x1, y1, _) = seam.course_mm[0], seam.course_mm[-1]
        length = ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5
        half = (seam.width_mm or 0.0) / 2
        dx, dy = -(y1 - y0) / length * half, (x1 - x0) / length * half
        shapes += [Line("SEAMS", x0 + s * dx, y0 + s * dy, x1 + s * dx, y1 + s * dy) for s in (-1, 1)]
        shapes.append(Text("NAMES", x1 + half + 1, y1 - 4, seam.id))
    for row, words in enumerate(dimensions(artefact)):
        shapes.append(Text("DIMENSIONS", -x, -y - _MARGIN - row * _ROW, words))
    return shapes


def dimensions(artefact: ArtefactFile) -> list[str]:
    """What the drawing says beside the plate."""
    width, height = artefact.size_mm or (200.0, 150.0)
    lines = [
        f"{artefact.title or artefact.id}: plate {width:g} x {height:g} mm, thickness 15 mm or more, face ground, "
        "flat to 0.005 mm, matt, origin in the middle; positions +-0.2 mm, certified after making"
    ]
    for rivet in artefact.rivets:
        u, v, _ = rivet.position_mm
        stands = "flush" if rivet.height_mm is None else f"{rivet.height_mm:+.3f} mm over the face"
        lines.append(f"{rivet.id}: x {u:g}, y {v:g}, diameter {rivet.diameter_mm:g} mm, ring 0.15 x 0.3 deep, {stands}")
    for seam in artefact.seams:
        step = "" if seam.step_mm is None else f", left side {seam.step_mm:+.3f} mm over the right"
        gap = "" if seam.width_mm is None else f", gap {seam.width_mm:g} mm, 3 mm deep"
        (x0, y0, _), (x1, y1, _) = seam.course_mm[0], seam.course_mm[-1]
        lines.append(f"{seam.id}: from ({x0:g}, {y0:g}) to ({x1:g}, {y1:g}){gap}{step}")
    return [*lines, "Drawing of the Flushline project, free to copy and to make."]


def dxf(shapes: Sequence[Shape]) -> str:
    """DXF of release 12, which every program reads; millimetres."""
    pairs: list[tuple[int, object]] = [(0, "SECTION"), (2, "ENTITIES")]
    for shape in shapes:
        if isinstance(shape, Line):
            pairs += [(0, "LINE"), (8, shape.layer), (10, shape.x1), (20, shape.y1), (11, shape.x2), (21, shape.y2)]
        elif isinstance(shape, Circle):
            pairs += [(0, "CIRCLE"), (8, shape.layer), (10, shape.x), (20, shape.y), (40, shape.radius)]
        else:
            words = shape.words.replace("×", "x").encode("ascii", "replace").decode()
            pairs += [(0, "TEXT"), (8, shape.layer), (10, shape.x), (20, shape.y), (40, _TEXT), (1, words)]
    pairs += [(0, "ENDSEC"), (0, "EOF")]
    return "".join(
        f"{code}\n{value:.6f}\n" if isinstance(value, float) else f"{code}\n{value}\n" for code, value in pairs
    )


def plate_svg(artefact: ArtefactFile) -> Markup:
    """The same drawing as SVG, in its true size."""
    shapes = plate_shapes(artefact)
    width, height = artefact.size_mm or (200.0, 150.0)
    below = _MARGIN + _ROW * len(dimensions(artefact))
    box = (-width / 2 - _MARGIN, -height / 2 - _MARGIN, width + 2 * _MARGIN, height + _MARGIN + below)
    kinds: dict[type, Literal["line", "circle", "text"]] = {Line: "line", Circle: "circle", Text: "text"}
    return part("storage.report", "artefact.html", "drawing", box, [(kinds[type(s)], s) for s in shapes], _TEXT)


def board_svg(board: Board) -> Markup:
    """A board of dots or a chessboard in its true size, with a line of 100 mm to check the print by."""
    s = board.spacing_mm
    if board.has_dots:
        places, r = board.points[:, :2], board.radius_mm
        low, high = places.min(0) - 2 * r, places.max(0) + 2 * r
        return part("storage.report", "artefact.html", "board", low, high - low, [(x, y, r) for x, y in places], [])
    squares = [(x * s, y * s, s) for y in range(-1, board.rows) for x in range(-1, board.cols) if (x + y) % 2 == 0]
    size = ((board.cols + 1) * s, (board.rows + 1) * s)
    return part("storage.report", "artefact.html", "board", (-s, -s), size, [], squares)

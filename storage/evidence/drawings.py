"""Drawings of artefacts: plates and bars as DXF (R12) for a shop and as SVG to look at, a board as SVG to print.

Flushline's shipped artefacts are ours, and free to copy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from textwrap import wrap
from typing import Literal

from markupsafe import Markup

from metrology.calibration.board import Board
from storage.evidence.artefact import ArtefactFile
from storage.templates import part

_MARGIN = 12.0
_TEXT = 2.5
_WIDTH = 0.6  # of a letter, as a share of its height, at most on the whole
_ROW = 4.5  # mm between lines of the table
_BAR, _PEG, _PEG_SHARE = 16.0, 10.0, 0.3  # height of a bar, mm; pegs' length, mm, and radius as a share of the sphere's


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


def shapes(artefact: ArtefactFile) -> list[Shape]:
    """What a drawing shows, with the lines of text below it; y is up."""
    shown = _bar(artefact) if artefact.spheres else _plate(artefact)
    left, bottom, right, _ = _extent(shown)
    said = [*dimensions(artefact), "Drawing of the Flushline project, free to copy and to make."]
    room = int((right - left + _MARGIN) / (_WIDTH * _TEXT))
    for row, words in enumerate(line for each in said for line in wrap(each, room)):
        shown.append(Text("DIMENSIONS", left, bottom - _MARGIN - row * _ROW, words))
    return shown


def _plate(artefact: ArtefactFile) -> list[Shape]:
    """A plate's outline, heads and seams; the origin in its middle, as positions are given."""
    width, height = _size(artefact)
    shapes = _rectangle("OUTLINE", -width / 2, -height / 2, width / 2, height / 2)
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
    return shapes


def _bar(artefact: ArtefactFile) -> list[Shape]:
    """Spheres on pegs on a bar, from the side; the origin in the middle between the first and the last."""
    shapes: list[Shape] = []
    radius = max(sphere.diameter_mm for sphere in artefact.spheres) / 2
    places = _along(artefact)
    top = -radius - _PEG
    shapes += _rectangle("BAR", places[0] - radius, top - _BAR, places[-1] + radius, top)
    for x, sphere in zip(places, artefact.spheres, strict=True):
        r = sphere.diameter_mm / 2
        peg = r * _PEG_SHARE
        shapes += [Circle("SPHERES", x, 0.0, r), Text("NAMES", x + r + 1, r - 2, sphere.id)]
        shapes += [Line("PEGS", x + side * peg, -((r**2 - peg**2) ** 0.5), x + side * peg, top) for side in (-1, 1)]
        shapes += [Line("CENTRES", x - r - 2, 0.0, x + r + 2, 0.0), Line("CENTRES", x, -r - 2, x, r + 2)]
    return shapes


def _along(artefact: ArtefactFile) -> list[float]:
    """Where spheres stand along their bar, as far apart as the distance that is given, mm."""
    length = artefact.distances[0].length_mm if artefact.distances else 0.0
    return [(k - 0.5 * (len(artefact.spheres) - 1)) * length for k in range(len(artefact.spheres))]


def _rectangle(layer: str, x0: float, y0: float, x1: float, y1: float) -> list[Shape]:
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
    return [Line(layer, *a, *b) for a, b in pairwise(corners)]


def _size(artefact: ArtefactFile) -> tuple[float, float]:
    return artefact.size_mm or (200.0, 150.0)


def _extent(shown: Sequence[Shape]) -> tuple[float, float, float, float]:
    """Least and greatest x and y of lines and circles: left, bottom, right, top."""
    lines = [shape for shape in shown if isinstance(shape, Line)]
    x = [x for line in lines for x in (line.x1, line.x2)]
    y = [y for line in lines for y in (line.y1, line.y2)]
    return min(x), min(y), max(x), max(y)


def dimensions(artefact: ArtefactFile) -> list[str]:
    """What the drawing says of sizes and of how to make it."""
    if artefact.spheres:
        lines = [
            f"{artefact.title or artefact.id}, from the side: bar of carbon fibre or invar, {_BAR:g} mm high, narrower "
            "than the spheres, dark and matt",
            "pegs glued; spheres of ceramic, matt and light, round to 0.002 mm; certified after making",
        ]
        places = _along(artefact)
        return lines + [
            f"{sphere.id}: x {x:g}, diameter {sphere.diameter_mm:g} mm (+-0.1)"
            for x, sphere in zip(places, artefact.spheres, strict=True)
        ]
    width, height = _size(artefact)
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
    return lines


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


def svg(artefact: ArtefactFile) -> Markup:
    """The same drawing as SVG, in its true size."""
    shown = shapes(artefact)
    left, bottom, right, top = _extent(shown)
    below = _MARGIN + _ROW * sum(isinstance(shape, Text) and shape.layer == "DIMENSIONS" for shape in shown)
    box = (left - _MARGIN, -top - _MARGIN, right - left + 2 * _MARGIN, top - bottom + _MARGIN + below)
    kinds: dict[type, Literal["line", "circle", "text"]] = {Line: "line", Circle: "circle", Text: "text"}
    return part("storage.report", "artefact.html", "drawing", box, [(kinds[type(s)], s) for s in shown], _TEXT)


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

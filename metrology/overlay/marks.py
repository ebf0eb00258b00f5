"""What an overlay is made of: outlines, strokes and labels in projector pixels, before they are painted.

Every severity has a shape beside its colour, so that nobody depends on colours:

    OK          disc      one thin ring; thin lines along both sides of a seam
    OUT         diamond   a thick ring with ticks where a diamond has its corners; bars across a seam
    SERIOUS     cross     two thick rings with a diagonal cross; thick bars with a crossbar at their ends
    NOT JUDGED  ring      a dashed ring; two dots on each side of a seam
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array
from metrology.results import Severity
from metrology.verdicts import SEVERITIES, Symbol

Colour = tuple[int, int, int]

COLOURS: dict[Severity | None, Colour] = {name: look.projector for name, look in SEVERITIES.items()}
WORDS: dict[Severity | None, str] = {name: look.short for name, look in SEVERITIES.items()}
GRAVEST_FIRST: tuple[Severity | None, ...] = tuple(SEVERITIES)

_ARROW, _BARB = 0.7, 0.25  # length of an arrow over that of its outline; of its barbs over its half
_MOST_BARB = 7.0  # line widths

# How far from a seam's middle its marks begin, and end by severity: the graver, the longer.
BAR_START_MM = 2.5
_CROSSBAR_MM = 2.4
BAR_SPACING_MM = 4.0  # bars closer than this run together
_REACH_MM: dict[Symbol, float] = {"cross": 8.0, "diamond": 5.5, "ring": 4.5, "disc": 3.5}
BAR_END_MM: dict[Severity | None, float] = {name: _REACH_MM[look.symbol] for name, look in SEVERITIES.items()}


@dataclass(frozen=True)
class Stroke:
    """A polyline: points (n, 2) in projector pixels, width in pixels; `feature` is the id it belongs to."""

    points: Array
    colour: Colour
    width: int
    closed: bool = False
    feature: str = ""


@dataclass(frozen=True)
class Label:
    """A line of text centred at `centre` (projector pixels), capitals `height` pixels tall, turned by `angle` radians.

    `feature` is the id it belongs to.
    """

    text: str
    centre: Array
    height: float
    angle: float
    colour: Colour
    feature: str = ""


def rivet_marks(outline: Array, severity: Severity | None, width: int) -> list[Stroke]:
    """A head's rim with the shape that its severity has.

    Parameters
    ----------
    outline : (n, 2) array
        Points around the rim, projector pixels.
    width : int
        Base line width in pixels.
    """
    colour, symbol = COLOURS[severity], SEVERITIES[severity].symbol
    if symbol == "ring":
        pieces = np.array_split(np.vstack([outline, outline[:1]]), 12)
        return [Stroke(piece, colour, width) for piece in pieces[::2]]
    if symbol == "disc":
        return [Stroke(outline, colour, width, closed=True)]
    centre = outline.mean(0)
    outward = (outline - centre) / np.linalg.norm(outline - centre, axis=1, keepdims=True)

    def beyond(pixels: float) -> Array:
        return outline + pixels * outward

    marks = [Stroke(outline, colour, 2 * width, closed=True)]
    n = len(outline)
    if symbol == "diamond":
        ticks = [0, n // 4, n // 2, 3 * n // 4]
    else:
        ticks = [n // 8, 3 * n // 8, 5 * n // 8, 7 * n // 8]
        marks.append(Stroke(beyond(4.0 * width), colour, 2 * width, closed=True))
    inner, outer = beyond(2.0 * width), beyond(7.0 * width)
    return marks + [Stroke(np.stack([inner[k], outer[k]]), colour, 2 * width) for k in ticks]


def arrow_marks(outline: Array, severity: Severity | None, width: int) -> list[Stroke]:
    """A double arrow within an outline, from its first point to the one opposite: the direction of its length."""
    colour = COLOURS[severity]
    first, last = outline[0], outline[len(outline) // 2]
    middle, half = 0.5 * (first + last), _ARROW * 0.5 * (last - first)
    barb = min(_BARB, _MOST_BARB * width / max(float(np.linalg.norm(half)), 1e-9))
    across = np.array([-half[1], half[0]])
    marks = [Stroke(np.stack([middle - half, middle + half]), colour, width)]
    for end in (-half, half):
        barbs = np.stack([s * barb * across + (1 - barb) * end for s in (-1, 1)])
        marks.append(Stroke(middle + np.stack([barbs[0], end, barbs[1]]), colour, width))
    return marks


def seam_marks(course: Array, severity: Severity | None, px_per_mm: float, width: int) -> list[Stroke]:
    """Marks of a run of stations with the same severity, clear of the seam itself.

    Parameters
    ----------
    course : (n, 2) array
        The stations, projector pixels.
    width : int
        Base line width in pixels.
    """
    colour, symbol = COLOURS[severity], SEVERITIES[severity].symbol
    along = np.gradient(course, axis=0) if len(course) > 1 else np.array([[0.0, 1.0]])
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    across = np.column_stack([-along[:, 1], along[:, 0]])
    start, end = BAR_START_MM * px_per_mm, BAR_END_MM[severity] * px_per_mm
    if symbol == "disc" and len(course) > 1:
        return [Stroke(course + side * start * across, colour, width) for side in (-1, 1)]
    marks = []
    apart = _apart(course, BAR_SPACING_MM * px_per_mm)
    for place, normal, direction in zip(course[apart], across[apart], along[apart], strict=True):
        for side in (-1, 1):
            near, far = place + side * start * normal, place + side * end * normal
            if symbol == "ring":
                marks += [Stroke(np.stack([dot, dot + 0.1 * normal]), colour, 2 * width) for dot in (near, far)]
                continue
            marks.append(Stroke(np.stack([near, far]), colour, width if symbol != "cross" else 2 * width))
            if symbol == "cross":
                half = _CROSSBAR_MM / 2 * px_per_mm * direction
                marks.append(Stroke(np.stack([far - half, far + half]), colour, width))
    return marks


def _apart(course: Array, spacing: float) -> list[int]:
    """Rows of a course (n, 2) that lie at least `spacing` apart, the first and the last among them."""
    kept = [0]
    for k in range(1, len(course)):
        if np.linalg.norm(course[k] - course[kept[-1]]) >= spacing:
            kept.append(k)
    if kept[-1] != len(course) - 1:
        kept[-1 if len(kept) > 1 else len(kept) :] = [len(course) - 1]
    return kept


def circle_points(
    centre_mm: Array, normal: Array, radius_mm: float, project: Callable[[Array], Array], n: int = 64
) -> Array:
    """A circle in space as the projector must show it.

    Parameters
    ----------
    centre_mm, normal : (3,) arrays
        Rig frame.
    project : function
        (n, 3) points of the rig frame to (n, 2) projector pixels.

    Returns
    -------
    (n, 2) ndarray
    """
    first = np.cross(normal, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    turn = np.linspace(0, 2 * np.pi, n, endpoint=False)[:, None]
    return project(centre_mm + radius_mm * (np.cos(turn) * first + np.sin(turn) * second))

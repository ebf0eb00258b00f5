"""What an overlay is made of: outlines, strokes and labels in projector pixels, before they are painted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.results import Severity

Array = NDArray[np.float64]
Colour = tuple[int, int, int]

# The paper's green, blue and red, in shades that stay apart for colour-blind eyes (and differ in shape besides);
# white for what was not judged.
COLOURS: dict[Severity | None, Colour] = {
    "green": (0, 214, 110),
    "blue": (70, 150, 255),
    "red": (255, 64, 48),
    None: (255, 255, 255),
}
WORDS: dict[Severity | None, str] = {"green": "OK", "blue": "OUT", "red": "SERIOUS", None: "NOT JUDGED"}


@dataclass(frozen=True)
class Stroke:
    """A polyline: points (n, 2) in projector pixels, width in pixels."""

    points: Array
    colour: Colour
    width: int
    closed: bool = False


@dataclass(frozen=True)
class Label:
    """A line of text centred at `centre` (projector pixels), `height` pixels tall, turned by `angle` radians."""

    text: str
    centre: Array
    height: float
    angle: float
    colour: Colour


def shape_marks(outline: Array, severity: Severity | None, width: int) -> list[Stroke]:
    """A closed outline with the shape that its severity has beside its colour.

    OK is one thin ring; out is a thick ring with four ticks; serious is a double thick ring with a diagonal cross
    outside it; not judged is a dashed ring.

    Parameters
    ----------
    outline : (n, 2) array
        Points around the feature, projector pixels.
    severity : "green", "blue", "red" or None
    width : int
        Base line width in pixels.
    """
    colour = COLOURS[severity]
    if severity is None:
        pieces = np.array_split(np.vstack([outline, outline[:1]]), 12)
        return [Stroke(piece, colour, width) for piece in pieces[::2]]
    if severity == "green":
        return [Stroke(outline, colour, width, closed=True)]
    centre = outline.mean(0)

    def beyond(factor: float, extra: float) -> Array:
        offset = outline - centre
        return centre + offset * factor + extra * offset / np.linalg.norm(offset, axis=1, keepdims=True)

    marks = [Stroke(outline, colour, 2 * width, closed=True)]
    n = len(outline)
    if severity == "blue":
        ticks: Sequence[int] = [0, n // 4, n // 2, 3 * n // 4]
    else:
        ticks = [n // 8, 3 * n // 8, 5 * n // 8, 7 * n // 8]
        marks.append(Stroke(beyond(1.0, 4.0 * width), colour, 2 * width, closed=True))
    inner, outer = beyond(1.0, 2.0 * width), beyond(1.0, 9.0 * width)
    marks += [Stroke(np.stack([inner[k], outer[k]]), colour, 2 * width) for k in ticks]
    return marks


def circle_points(
    centre_mm: Array, normal: Array, radius_mm: float, project: Callable[[Array], Array], n: int = 64
) -> Array:
    """A circle in space as the projector must show it.

    Parameters
    ----------
    centre_mm, normal : (3,) arrays
        Rig frame.
    radius_mm : float
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

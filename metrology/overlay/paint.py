"""Painting an overlay: as a raster image for the projector, and as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from html import escape

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.overlay.marks import Label, Stroke

_FONT = cv2.FONT_HERSHEY_DUPLEX
_SAMPLE_SCALE = 4.0
_ALL_LETTERS = int(cv2.__version__.partition(".")[0]) >= 5  # before, its fonts have none but those of ASCII
_PLAIN = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "AE", "Ö": "OE", "Ü": "UE", "ß": "ss"})
_SHIFT = 4  # fixed-point bits of the drawing coordinates


@lru_cache(maxsize=1)
def _cap_height() -> float:
    """Pixels of a capital letter at scale 1, as this OpenCV draws it (its fonts differ between versions)."""
    canvas = np.zeros((400, 400), np.uint8)
    cv2.putText(canvas, "H", (100, 300), _FONT, _SAMPLE_SCALE, 255, 1)
    rows = np.flatnonzero(canvas.max(1) > 127)
    return float(rows[-1] - rows[0]) / _SAMPLE_SCALE


def _drawable(text: str) -> str:
    """A text in letters that this OpenCV has."""
    return text if _ALL_LETTERS else text.translate(_PLAIN)


def text_size(text: str, height: float) -> tuple[float, float]:
    """Width and height in pixels that a line of text takes, halo included."""
    scale = height / _cap_height()
    (width, cap), base = cv2.getTextSize(_drawable(text), _FONT, scale, _thickness(height))
    return float(width + 0.6 * height), float(cap + base + 0.25 * height)


def _thickness(height: float) -> int:
    return max(1, round(height / 12))


def paint(
    size: tuple[int, int], background: int, strokes: Sequence[Stroke], labels: Sequence[Label]
) -> NDArray[np.uint8]:
    """The overlay as an image.

    Parameters
    ----------
    size : (width, height)
    background : int
        Grey level 0 … 255 of everything unmarked.

    Returns
    -------
    (height, width, 3) uint8, RGB
    """
    width, height = size
    image = np.full((height, width, 3), background, np.uint8)
    for stroke in strokes:
        points = np.round(stroke.points * 2**_SHIFT).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(image, [points], stroke.closed, stroke.colour, stroke.width, cv2.LINE_AA, _SHIFT)
    for label in labels:
        _paint_label(image, label)
    return image


def _paint_label(image: NDArray[np.uint8], label: Label) -> None:
    """Text on a black plate (light from the fringe field around it would drown thin letters)."""
    width, height = (int(np.ceil(x)) for x in text_size(label.text, label.height))
    scale, thickness = label.height / _cap_height(), _thickness(label.height)
    text = _drawable(label.text)
    (text_width, cap), base = cv2.getTextSize(text, _FONT, scale, thickness)
    plate = np.zeros((height, width, 3), np.uint8)
    origin = ((width - text_width) // 2, (height - cap - base) // 2 + cap)
    cv2.putText(plate, text, origin, _FONT, scale, label.colour, thickness, cv2.LINE_AA)
    cos, sin = np.cos(label.angle), np.sin(label.angle)
    turn = np.array([[cos, -sin], [sin, cos]])
    shift = label.centre - turn @ ((np.array([width, height]) - 1) / 2)
    # Straight into the image, of which only the part with the plate is gone through.
    reach = 0.5 * np.abs(turn) @ (width, height) + 1.0
    first = np.maximum(np.floor(label.centre - reach), 0).astype(int)
    end = np.minimum(np.ceil(label.centre + reach) + 1, image.shape[1::-1]).astype(int)
    if (end <= first).any():
        return
    part = image[first[1] : end[1], first[0] : end[0]]
    placing = np.column_stack([turn, shift - first])
    cv2.warpAffine(
        plate, placing, part.shape[1::-1], dst=part, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT
    )


def paint_svg(size: tuple[int, int], background: int, strokes: Sequence[Stroke], labels: Sequence[Label]) -> str:
    """The overlay as an SVG document of the projector's size, one user unit per pixel, pixel centres at integers."""
    width, height = size
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="-0.5 -0.5 {width} {height}">',
        f'<rect x="-0.5" y="-0.5" width="{width}" height="{height}" fill="rgb{(background,) * 3}"/>',
    ]
    for stroke in strokes:
        path = " ".join(f"{x:.2f},{y:.2f}" for x, y in stroke.points)
        tag = "polygon" if stroke.closed else "polyline"
        lines.append(
            f'<{tag} points="{path}" fill="none" stroke="rgb{stroke.colour}" stroke-width="{stroke.width}" '
            'stroke-linecap="round" stroke-linejoin="round"/>'
        )
    for label in labels:
        x, y = label.centre
        plate_width, plate_height = text_size(label.text, label.height)
        lines.append(
            f'<g transform="translate({x:.2f},{y:.2f}) rotate({np.degrees(label.angle):.3f})">'
            f'<rect x="{-plate_width / 2:.1f}" y="{-plate_height / 2:.1f}" width="{plate_width:.1f}" '
            f'height="{plate_height:.1f}"/>'
            f'<text text-anchor="middle" y="{label.height / 2:.1f}" font-family="sans-serif" '
            f'font-size="{label.height / 0.72:.1f}" fill="rgb{label.colour}">{escape(label.text)}</text></g>'
        )
    return "\n".join([*lines, "</svg>", ""])

"""Paint on the skin: stencilled letters and marks drawn by hand, and how their coverage is rasterised."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from simulator.require import Point, require

_CAP_PX = 200  # height of a capital letter as it is rasterised
_BLUR_MM = 0.06  # how soft the edge of a painted letter is


@dataclass(frozen=True)
class Stencil:
    """A line of painted letters."""

    text: str
    x_mm: float
    y_mm: float
    """x_mm, y_mm: middle of the line."""
    cap_mm: float = 6.0
    """Height of its capitals."""
    angle_deg: float = 0.0
    contrast: float = -0.75
    """Reflectance of the paint relative to the skin's, less 1."""
    thickness_mm: float = 0.02
    bold: bool = True

    def __post_init__(self) -> None:
        require(bool(self.text.strip()), "stencil text", repr(self.text), "letters")
        require(1 <= self.cap_mm <= 60, "stencil cap_mm", self.cap_mm, "1 to 60 mm")
        require(-1 <= self.contrast <= 2, "stencil contrast", self.contrast, "−1 to 2")
        require(0 <= self.thickness_mm <= 0.15, "stencil thickness_mm", self.thickness_mm, "0 to 0.15 mm")


@dataclass(frozen=True)
class Stroke:
    """A mark drawn by hand along a course: a tick, a cross, a circle round something; a grease pencil's is patchy.

    `patchy` is the share of the line that the pencil has left out.
    """

    points_mm: tuple[Point, ...]
    width_mm: float = 1.5
    contrast: float = -0.5
    patchy: float = 0.4

    def __post_init__(self) -> None:
        require(len(self.points_mm) >= 2, "stroke points_mm", self.points_mm, "at least two points")
        require(0.2 <= self.width_mm <= 10, "stroke width_mm", self.width_mm, "0.2 to 10 mm")
        require(0 <= self.patchy < 1, "stroke patchy", self.patchy, "0 to below 1")


@lru_cache(maxsize=64)
def _letters(text: str, bold: bool) -> tuple[NDArray[np.uint8], float]:
    """A line of letters, white on black, and the row of the middle of its capitals."""
    font, weight = cv2.FontFace("sans"), 700 if bold else 400
    size = round(_CAP_PX / 0.75)  # the font's capitals are three quarters of its size
    canvas = (4 * size * len(text), 2 * size)
    width = cv2.getTextSize(canvas, text, (20, size), font, size, weight)[2]
    picture = np.zeros((int(1.5 * size), width + 40), np.uint8)
    cv2.putText(picture, text, (20, size), (255, 255, 255), font, size, weight)
    return picture, size - 0.5 * _CAP_PX


def letter_coverage(stencil: Stencil, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of each texel that a stencil covers, at the places x (columns) and y (rows) in mm."""
    picture, middle = _letters(stencil.text, stencil.bold)
    scale = _CAP_PX / stencil.cap_mm  # picture pixels per mm
    texel = abs(float(x.ravel()[1] - x.ravel()[0])) if x.size > 1 else 0.1
    # The blur stands for the paint's soft edge and for the texel's area.
    sigma = scale * math.hypot(_BLUR_MM, texel / math.sqrt(12))
    soft = cv2.GaussianBlur(picture, (0, 0), sigma) if sigma > 0.4 else picture
    c, s = math.cos(math.radians(stencil.angle_deg)), math.sin(math.radians(stencil.angle_deg))
    dx, dy = x - stencil.x_mm, y - stencil.y_mm
    column = (0.5 * picture.shape[1] + scale * (c * dx + s * dy)).astype(np.float32)
    row = (middle - scale * (-s * dx + c * dy)).astype(np.float32)
    found = cv2.remap(soft, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(found, float) / 255


def letters_reach(stencil: Stencil) -> float:
    """Half the length of a stencil's diagonal, mm."""
    picture, _ = _letters(stencil.text, stencil.bold)
    return 0.5 * math.hypot(*picture.shape) * stencil.cap_mm / _CAP_PX

"""What a defect is: dent, bump, crease, scratch, raised edge, or a deposit, which is none of the skin's."""

from __future__ import annotations

import math

import cv2
import numpy as np

from metrology.defects.bottom import Bottom
from metrology.defects.outline import Outline
from metrology.defects.patch import Patch
from metrology.defects.row import DefectKind
from metrology.defects.settings import DefectSettings

_LONG = 4.0  # times as long as wide is a scratch, if it is narrow
_FOLD = 2.0  # times as long as wide is a crease, if its section is sharp
_SHARP = 0.79  # of its depth left half way to its outline: 0.85 in a smooth section, 0.73 in a pointed one
_HALF_WAY = (0.4, 0.6)
_BESIDE = 0.2  # of its radius to either side
_AT_SEAM = 0.04  # share of an outline that a raised edge has at a seam
_BORDER_PX = 3  # to either side of an outline: as far as an edge of the picture or of depth spoils points
_EDGED = 0.5  # share of that border that is one
# A thin skin, mm, and by how much it may be stretched before it cracks (aluminium by a tenth to a fifth).
_THIN_SKIN_MM, _STRETCH = 0.8, 0.1


def nature_of(patch: Patch, bottom: Bottom, outline: Outline, sign: int, settings: DefectSettings) -> DefectKind:
    """The kind of a defect that lies below (sign 1) or above (−1) the skin."""
    if sign < 0:
        if outline.cut_by_seam > _AT_SEAM:
            return "raised edge"
        return "deposit" if _has_border(patch, outline) or _would_crack(bottom, outline) else "bump"
    long = outline.length / max(outline.width, 1e-6)
    if outline.width < settings.scratch_width_mm and long > _LONG:
        return "scratch"
    if outline.cut_by_seam > _AT_SEAM:  # the section of what a seam cuts off tells nothing
        return "dent"
    across = _left_half_way(patch, bottom, outline, outline.angle + 0.5 * np.pi, outline.width, outline.length)
    return "crease" if long > _FOLD and across < _SHARP else "dent"


def _has_border(patch: Patch, outline: Outline) -> bool:
    """Whether it lies on the skin: a sheet bulges smoothly, and chips, drops and stickers end at an edge all round."""
    reach = math.ceil(_BORDER_PX / patch.step_px)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    cells = outline.cells.astype(np.uint8)
    border = (cv2.dilate(cells, disc) != cv2.erode(cells, disc)) & patch.plate & ~patch.covered
    return bool(border.any() and (~patch.skin[border]).mean() > _EDGED)


def _would_crack(bottom: Bottom, outline: Outline) -> bool:
    """Whether a sheet that rises so sharply would crack: chips and drops as bright as the skin show no edge.

    A bump w wide at half its height h has curvatures of 8 h/w², and stretches a sheet of thickness t by half of t times
    that. What is long is the burr beside a scratch.
    """
    round_one = outline.length < _FOLD * outline.width
    return round_one and 4 * _THIN_SKIN_MM * abs(bottom.depth) > _STRETCH * outline.width**2


def _left_half_way(patch: Patch, bottom: Bottom, outline: Outline, turn: float, extent: float, beside: float) -> float:
    """Mean depth half way to the outline along a direction, as a share of the depth."""
    dx, dy = patch.x - bottom.x, patch.y - bottom.y
    along = np.abs(np.cos(turn) * dx + np.sin(turn) * dy) / (0.5 * extent)
    off = np.abs(np.cos(turn) * dy - np.sin(turn) * dx) / (0.5 * beside)
    there = (along > _HALF_WAY[0]) & (along < _HALF_WAY[1]) & (off < _BESIDE) & patch.skin & outline.cells
    return float(patch.depth[there].mean()) / bottom.depth if there.any() else 1.0

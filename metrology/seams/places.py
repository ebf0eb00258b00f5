"""Where in the left image a seam can be: on the panel, as far as it has points, and not on rivet heads."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from metrology.arrays import Mask
from metrology.results import RivetDetection

# The panel is outlined in cells of so many px. Holes in its points up to this size are part of it: gaps, highlights,
# shadows. A band this near to its outline has no room for skin on its other side.
_CELL_PX = 8
_HOLE_PX = 200
_RIM_PX = 16


def head_mask(rivets: Sequence[RivetDetection], shape: tuple[int, ...], margin_px: float) -> Mask:
    """(h, w) pixels on rivet heads and within `margin_px` around them."""
    mask = np.zeros(shape, np.uint8)
    for rivet in rivets:
        axes = round(rivet.major_px / 2 + margin_px), round(rivet.minor_px / 2 + margin_px)
        cv2.ellipse(mask, (round(rivet.u_px), round(rivet.v_px)), axes, rivet.angle_deg, 0, 360, 1, -1)
    return mask.astype(bool)


def panel_mask(lit: Mask) -> Mask:
    """(h, w) pixels on the panel and clear of its outline and that of the projected field.

    Parameters
    ----------
    lit : (h, w) ndarray of bool
        Pixels that the fringes reach, with a point or without.
    """
    height, width = lit.shape
    # Means of zeros and ones round to what more than half of a cell is.
    cells = width // _CELL_PX, height // _CELL_PX
    covered = cv2.resize(lit.astype(np.uint8), cells, interpolation=cv2.INTER_AREA)
    panel = cv2.morphologyEx(covered, cv2.MORPH_CLOSE, np.ones((_HOLE_PX // _CELL_PX,) * 2, np.uint8))
    rim = 2 * _RIM_PX // _CELL_PX + 1
    inside = cv2.erode(panel, np.ones((rim, rim), np.uint8))
    return cv2.resize(inside, (width, height), interpolation=cv2.INTER_NEAREST) > 0

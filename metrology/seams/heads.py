"""Where rivet heads lie in the left image."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.results import RivetDetection

Mask = NDArray[np.bool_]


def head_mask(rivets: Sequence[RivetDetection], shape: tuple[int, ...], margin_px: float) -> Mask:
    """(h, w) pixels on rivet heads and within `margin_px` around them."""
    mask = np.zeros(shape, np.uint8)
    for rivet in rivets:
        axes = round(rivet.major_px / 2 + margin_px), round(rivet.minor_px / 2 + margin_px)
        cv2.ellipse(mask, (round(rivet.u_px), round(rivet.v_px)), axes, rivet.angle_deg, 0, 360, 1, -1)
    return mask.astype(bool)

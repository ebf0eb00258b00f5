"""Skin in the field of view that no point was found on: what lies there is inspected by nobody."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from metrology.arrays import Mask
from metrology.cloud import PixelFlag, Reconstruction, main_cause

_CELL_PX = 8
_SEEN = 0.25  # of a cell's pixels must have points
# Fasteners' heads, seams, open holes and highlights on them are smaller across.
_ACROSS_MM = 15.0
_LEAST_SHARE = 0.005


@dataclass(frozen=True)
class Unseen:
    """What is not seen within the outline of what is."""

    share: float
    """Of the field in view."""
    u_px: float
    v_px: float
    """u_px, v_px: the middle of the largest part, left image."""
    cause: PixelFlag
    """What most of its pixels are."""


def unseen_skin(reconstruction: Reconstruction) -> Unseen | None:
    """Parts of the field without points, as wide as a fastener's head and more; None where they are next to nothing."""
    valid = reconstruction.valid
    cells = valid.shape[1] // _CELL_PX, valid.shape[0] // _CELL_PX
    some = slice(0, cells[1] * _CELL_PX, 2), slice(0, cells[0] * _CELL_PX, 2)
    seen = cv2.resize(valid[some].astype(np.float32), cells, interpolation=cv2.INTER_AREA) >= _SEEN
    if not seen.any():
        return None
    field = _hull(seen)
    depth = float(np.nanmedian(reconstruction.points[::16, ::16, 2]))
    across = round(_ACROSS_MM * float(reconstruction.rig.left.K[0, 0]) / depth / _CELL_PX)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (max(1, across),) * 2)
    hidden = cv2.morphologyEx((field & ~seen).astype(np.uint8), cv2.MORPH_OPEN, disc)
    share = float(hidden.sum() / field.sum())
    if share < _LEAST_SHARE:
        return None
    _, labels, parts, middles = cv2.connectedComponentsWithStats(hidden)
    largest = 1 + int(parts[1:, cv2.CC_STAT_AREA].argmax())
    u, v = (middles[largest] + 0.5) * _CELL_PX - 0.5
    inside = cv2.resize((labels == largest).astype(np.uint8), valid.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
    return Unseen(share, float(u), float(v), main_cause(reconstruction.flags[inside])[0])


def _hull(seen: Mask) -> Mask:
    """The convex outline of what is seen, filled."""
    places = np.argwhere(seen)[:, ::-1].astype(np.int32)
    filled = np.zeros(seen.shape, np.uint8)
    cv2.fillConvexPoly(filled, cv2.convexHull(places), 1)
    return np.asarray(filled > 0)

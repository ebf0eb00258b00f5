"""The map from a plane to its image, lens distortion left aside."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.errors import CalibrationError

# Well above the lens distortion over a board, well below the distance between dots.
_GATE_PX = 12.0


def fit_homography(points: NDArray[np.number], pixels: Array) -> Array:
    """(3, 3) homography from plane points (n, 2) to pixels (n, 2), false pairs left out."""
    found, _ = cv2.findHomography(np.asarray(points, float), pixels, cv2.RANSAC, _GATE_PX)
    if found is None or not np.isfinite(found).all():
        raise CalibrationError(f"found {len(points)} features that are not the image of a plane, expected a flat board")
    return np.asarray(found, float)


def apply_homography(homography: Array, points: NDArray[np.number]) -> Array:
    """Pixels (n, 2) of plane points (n, 2)."""
    mapped = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def unit_area(homography: Array, points: NDArray[np.number]) -> Array:
    """(n,) px² that a unit square of the plane covers about each point."""
    half = np.array([[0.5, 0.0], [0.0, 0.5]])
    east, south = (apply_homography(homography, points + h) - apply_homography(homography, points - h) for h in half)
    return np.asarray(np.abs(east[:, 0] * south[:, 1] - east[:, 1] * south[:, 0]))


def inside_gate(homography: Array, points: NDArray[np.number], pixels: Array) -> NDArray[np.bool_]:
    """(n,) which pixels lie where the homography takes their points."""
    return np.asarray(np.linalg.norm(apply_homography(homography, points) - pixels, axis=1) < _GATE_PX)

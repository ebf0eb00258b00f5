"""The skin's direction around a place of the left image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array

_FEWEST_POINTS = 50


def skin_normal(points: NDArray[np.float32], u: float, v: float, reach: float) -> Array | None:
    """Unit normal of the skin, towards the rig, of the plane through the points within `reach` pixels of (u, v).

    The window holds the head as well as the skin around it: a head stands off by micrometres over millimetres, which
    turns the plane by less than the panel's own curvature does.

    Parameters
    ----------
    points : (h, w, 3) array
        Organised cloud on the left image's pixels.
    u, v, reach : float
        Pixels.

    Returns
    -------
    (3,) ndarray or None
        Rig frame; None where too few points were measured.
    """
    height, width = points.shape[:2]
    if not (0 <= u < width and 0 <= v < height):
        return None
    r, row, column = int(np.ceil(reach)), round(v), round(u)
    window = points[max(0, row - r) : row + r + 1, max(0, column - r) : column + r + 1].reshape(-1, 3)
    window = window[np.isfinite(window[:, 2])].astype(float)
    if len(window) < _FEWEST_POINTS:
        return None
    centred = window - window.mean(0)
    design = np.column_stack([centred[:, :2], np.ones(len(window))])
    slope = np.linalg.lstsq(design, centred[:, 2], rcond=None)[0]
    normal = np.array([slope[0], slope[1], -1.0])
    return np.asarray(normal / np.linalg.norm(normal))

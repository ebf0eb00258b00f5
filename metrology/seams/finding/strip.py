"""The image straightened along a line: a grid of places, s along the line and x across it.

Good for looking at (is there a band, a groove, a step?). Positions to a hundredth of a pixel are measured on the pixels
themselves (`sampling`), never on resampled ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Float32
from metrology.seams.polyline import normals, resample


@dataclass(frozen=True)
class Strip:
    """Places beside a line."""

    line: Array
    """(n, 2): u, v on the line, `step_px` apart."""
    normals: Array
    """(n, 2): unit vectors across it, towards growing x."""
    x: Array
    """(m,): distances across, px, one pixel apart and symmetric."""
    step_px: float
    """Along the line."""
    u: Float32
    v: Float32
    """u, v: (n, m) float32: where place [i, j] lies in the image."""

    @classmethod
    def along(cls, points: Array, reach_px: float, step_px: float) -> Strip:
        """The strip of ±reach_px along a polyline (n, 2)."""
        line = resample(points, step_px)
        across = normals(line)
        x = np.arange(-np.ceil(reach_px), np.ceil(reach_px) + 1)
        u, v = ((line[:, k, None] + across[:, k, None] * x).astype(np.float32) for k in (0, 1))
        return cls(line, across, x, step_px, u, v)

    def rows(self, index: NDArray[np.intp]) -> Strip:
        """Some of its rows."""
        return Strip(self.line[index], self.normals[index], self.x, self.step_px, self.u[index], self.v[index])

    def smooth(self, image: Float32) -> Float32:
        """(n, m) image at the places, bilinear; NaN outside it."""
        values = cv2.remap(
            image, self.u, self.v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan")
        )
        return np.asarray(values, np.float32)

    def pixels(self, shape: tuple[int, ...]) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
        """(n, m) rows, columns of the pixels nearest to the places, kept in the image, and whether they lie in it."""
        rows, columns = (np.rint(coordinate).astype(np.intp) for coordinate in (self.v, self.u))
        height, width = shape[:2]
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        return np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1), inside

"""The dot pattern that the projector shows on the board: an asymmetric grid with a few larger markers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.errors import CalibrationError

MIN_MARKERS = 3


@dataclass(frozen=True)
class ProjectedDots:
    """Bright discs on black at `origin_px + ((2c + r mod 2) s, r s)`, projector pixels with centres at integers."""

    cols: int
    rows: int
    """cols, rows: dots per row and number of rows."""
    spacing_px: float
    """s, half the distance within a row."""
    origin_px: tuple[float, float]
    """Column and row of dot (0, 0)."""
    diameter_px: float
    marker_diameter_px: float
    """diameter_px, marker_diameter_px: of an ordinary dot and of a marker."""
    markers: tuple[tuple[int, int], ...]
    """tuple of (row, col): the larger dots. They must not be in line, nor look the same after a turn of the grid."""

    def __post_init__(self) -> None:
        if self.cols < 3 or self.rows < 3 or not self.spacing_px > 0:
            raise CalibrationError(
                f"projected dots: found {self.cols} × {self.rows} at {self.spacing_px} px, expected at least 3 × 3"
            )
        if not 0 < self.diameter_px < self.marker_diameter_px < self.spacing_px * np.sqrt(2):
            raise CalibrationError(
                f"projected dots: found diameters {self.diameter_px} and {self.marker_diameter_px} (markers) px, "
                "expected markers larger than dots and smaller than the distance between them"
            )
        outside = [m for m in self.markers if not (0 <= m[0] < self.rows and 0 <= m[1] < self.cols)]
        if outside or len(set(self.markers)) < MIN_MARKERS:
            raise CalibrationError(
                f"projected dots: found markers {list(self.markers)}, expected at least {MIN_MARKERS} different "
                f"(row, col) within {self.rows} rows of {self.cols}"
            )

    @property
    def grid(self) -> NDArray[np.int64]:
        """(n, 2) places in whole spacings (x, y), row by row."""
        r, c = np.mgrid[: self.rows, : self.cols]
        return np.column_stack([(2 * c + r % 2).ravel(), r.ravel()]).astype(np.int64)

    @property
    def centres(self) -> NDArray[np.float64]:
        """(n, 2) centres in projector pixels."""
        return np.asarray(self.origin_px) + self.grid * self.spacing_px

    @property
    def is_marker(self) -> NDArray[np.bool_]:
        """(n,) which dots are markers."""
        flags = np.zeros((self.rows, self.cols), bool)
        for row, col in self.markers:
            flags[row, col] = True
        return flags.ravel()

    @property
    def radii(self) -> NDArray[np.float64]:
        """(n,) radii in projector pixels."""
        return np.where(self.is_marker, self.marker_diameter_px, self.diameter_px) / 2

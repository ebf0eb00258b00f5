"""The calibration board: which features are printed on it, and where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrology.errors import CalibrationError

BoardKind = Literal["asymmetric_circles", "circles", "chessboard", "charuco"]
_KINDS = ("asymmetric_circles", "circles", "chessboard", "charuco")


@dataclass(frozen=True)
class Board:
    """A flat board with features at known places; the features lie at z = 0 of its own frame."""

    kind: BoardKind
    """asymmetric_circles: dots at ((2c + r mod 2) s, r s); circles: dots at (c s, r s); chessboard: inner corners at (c
    s, r s); charuco: the inner corners of a board of cols × rows squares, at ((c + 1) s, (r + 1) s)."""
    cols: int
    rows: int
    """cols, rows: features per row and number of rows; for charuco the squares."""
    spacing_mm: float
    """s: spacing of the dots (half the distance within a row of an asymmetric grid), or the side of a square."""
    dot_diameter_mm: float | None = None
    """Of the circles."""
    marker_mm: float | None = None
    """Side of a ChArUco marker."""
    dictionary: str | None = None
    """OpenCV's name of the ChArUco markers' dictionary, such as DICT_5X5_100."""

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise CalibrationError(f"board type: found {self.kind!r}, expected one of {', '.join(_KINDS)}")
        if self.cols < 3 or self.rows < 3:
            raise CalibrationError(f"board: found {self.cols} × {self.rows} features, expected at least 3 × 3")
        if not self.spacing_mm > 0:
            raise CalibrationError(f"board spacing: found {self.spacing_mm} mm, expected a positive length")
        if self.has_dots and not 0 < (self.dot_diameter_mm or 0) < self.least_distance_mm:
            raise CalibrationError(
                f"dot diameter: found {self.dot_diameter_mm} mm, expected more than 0 and less than "
                f"the {self.least_distance_mm:g} mm between neighbouring dots"
            )
        if self.kind == "charuco" and not (0 < (self.marker_mm or 0) < self.spacing_mm and self.dictionary):
            raise CalibrationError(
                f"ChArUco board: found marker_mm {self.marker_mm} and dictionary {self.dictionary!r}, expected a "
                f"marker smaller than the {self.spacing_mm:g} mm square and the name of its dictionary"
            )

    @property
    def has_dots(self) -> bool:
        """Whether the features are circles (with perspective eccentricity) and not corners."""
        return self.kind in ("asymmetric_circles", "circles")

    @property
    def least_distance_mm(self) -> float:
        """Distance between nearest neighbours."""
        return self.spacing_mm * (np.sqrt(2.0) if self.kind == "asymmetric_circles" else 1.0)

    @property
    def grid(self) -> NDArray[np.int64]:
        """(n, 2) places of the features in whole spacings (x, y), row by row."""
        cols, rows = (self.cols - 1, self.rows - 1) if self.kind == "charuco" else (self.cols, self.rows)
        r, c = np.mgrid[:rows, :cols]
        if self.kind == "asymmetric_circles":
            c = 2 * c + r % 2
        elif self.kind == "charuco":
            r, c = r + 1, c + 1
        return np.column_stack([c.ravel(), r.ravel()]).astype(np.int64)

    @property
    def points(self) -> NDArray[np.float64]:
        """(n, 3) features in the board's frame, mm."""
        return np.column_stack([self.grid * self.spacing_mm, np.zeros(len(self.grid))])

    @property
    def radius_mm(self) -> float:
        """Radius of a dot; 0 for corners."""
        return (self.dot_diameter_mm or 0.0) / 2 if self.has_dots else 0.0

    def __str__(self) -> str:
        return f"{self.kind} board of {self.cols} × {self.rows}"

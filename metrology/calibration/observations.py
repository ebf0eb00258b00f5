"""What the joint adjustment is given: sightings of the board's features and of projected dots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array

DeviceName = Literal["left", "right", "projector"]
SightingKind = Literal["board", "dots"]


@dataclass(frozen=True)
class Sighting:
    """Features of one kind that one device saw of one pose of the board."""

    kind: SightingKind
    """board: features printed on it, known in its frame; the projector "sees" them where fringes in both axes gave them
    a projector coordinate. dots: discs emitted by the projector, known in projector pixels, seen by a camera on the
    board's plane."""
    device: DeviceName
    pose: int
    """Number of the pose in the capture."""
    index: NDArray[np.intp]
    """(n,) int array: number of each feature on the board or in the projected pattern."""
    known: Array
    """(n, 2): board: x, y on the board, mm. dots: projector pixels."""
    radius: Array
    """(n,): of the disc, in the unit of `known`; 0 for corners and decoded coordinates."""
    pixels: Array
    """(n, 2): where the device saw them, raw pixels; for discs the ellipse's centre."""
    sigma_px: float
    """Standard deviation of one coordinate."""

    def __len__(self) -> int:
        return len(self.pixels)

    def only(self, keep: NDArray[np.bool_]) -> Sighting:
        """The features that a mask (n,) keeps."""
        return Sighting(
            self.kind,
            self.device,
            self.pose,
            self.index[keep],
            self.known[keep],
            self.radius[keep],
            self.pixels[keep],
            self.sigma_px,
        )

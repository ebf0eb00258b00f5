"""What a camera saw of one pose of the board."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrology.saturation import saturation_level

GreyFrame = NDArray[np.uint8] | NDArray[np.uint16]
CameraName = Literal["left", "right"]
CAMERAS: tuple[CameraName, ...] = ("left", "right")


@dataclass(frozen=True)
class BoardFrames:
    """One camera's pictures of one pose; grey levels of uint8 or uint16."""

    white: GreyFrame
    """(h, w) uint8 or uint16: lit by the projector all over."""
    dark: GreyFrame | None = None
    """(h, w) or None: projector black; taken as zero where it was not captured."""
    dots: GreyFrame | None = None
    """(h, w) or None: projected dot pattern."""
    coordinate: NDArray[np.floating] | None = None
    """(h, w, 2) float array or None: decoded fringes in both axes: the projector column and row that each pixel sees,
    NaN where none."""

    @property
    def lit(self) -> NDArray[np.float64]:
        """White minus dark: the projector's light alone."""
        white = self.white.astype(np.float64)
        return white if self.dark is None else white - self.dark

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return int(self.white.shape[1]), int(self.white.shape[0])

    @cached_property
    def saturated(self) -> NDArray[np.bool_]:
        """(h, w) pixels of the white frame that are clipped."""
        return np.asarray(self.white >= saturation_level(self.white[None, None]))

"""The fringe code: which sinusoids the projector shows (paper eqs 1 and 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrology.errors import SceneError

Axis = Literal["x", "y"]


@dataclass(frozen=True)
class FringeCode:
    """Phase-shifted fringes in several counts.

    The projector shows, for each count N, ``I_i(x) = a + b cos(2π N (x + ½)/W + 2π (i−1)/steps)``, i = 1 … steps, with
    x the projector column (axis x) or row (axis y) and W the projector's size along that axis.

    Attributes
    ----------
    axis : "x" or "y"
    steps : int
        Phase steps per count, at least 3.
    counts : tuple of int
        Fringes across the projector, one entry per count, in the order of the frames.
    """

    axis: Axis
    steps: int
    counts: tuple[int, ...]

    def __post_init__(self) -> None:
        if self.axis not in ("x", "y"):
            raise SceneError(f"fringe axis: found {self.axis!r}, expected 'x' or 'y'")
        if self.steps < 3:
            raise SceneError(f"fringe steps: found {self.steps}, expected at least 3")
        if not self.counts or any(n < 1 for n in self.counts):
            raise SceneError(f"fringe counts: found {list(self.counts)}, expected positive whole numbers")
        if len(set(self.counts)) != len(self.counts):
            raise SceneError(f"fringe counts: found {list(self.counts)}, expected each only once")
        if np.gcd.reduce(self.counts) != 1:
            raise SceneError(
                f"fringe counts: found {list(self.counts)} with a common factor, "
                "expected none (the fringe order would be ambiguous)"
            )

    @property
    def frames(self) -> int:
        """Frames per camera and exposure."""
        return self.steps * len(self.counts)

    def size(self, width: int, height: int) -> int:
        """W: the projector's size along the fringe axis, pixels."""
        return width if self.axis == "x" else height

    def patterns(self, width: int, height: int) -> NDArray[np.float64]:
        """The projector's images, values in [0, 1].

        Returns
        -------
        (frames, height, width) ndarray
            Count-major, then step.
        """
        size = self.size(width, height)
        position = (np.arange(size) + 0.5) / size
        rows = [
            0.5 + 0.5 * np.cos(2 * np.pi * (count * position + step / self.steps))
            for count in self.counts
            for step in range(self.steps)
        ]
        lines = np.stack(rows)
        image = lines[:, None, :] if self.axis == "x" else lines[:, :, None]
        return np.broadcast_to(image, (self.frames, height, width))

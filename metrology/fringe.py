"""The fringe code: which sinusoids the projector shows (paper eqs 1 and 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrology.errors import SceneError

Axis = Literal["x", "y"]


@dataclass(frozen=True)
class GrayCode:
    """Gray-code frames after the fringes, for scans whose fringe counts do not tell the order themselves.

    The projector's pixels along the fringe axis fall into S equal stripes, j = ⌊S (x + ½)/W⌋; frame b, from the most
    significant bit, is bright where bit b of ``j ^ (j >> 1)`` is set.

    Attributes
    ----------
    stripes : int
        S; at least as many as fringes of the largest count, better twice as many (the complementary bit).
    inverse : bool
        Whether each frame is followed by its inverse.
    """

    stripes: int
    inverse: bool = False

    def __post_init__(self) -> None:
        if not 2 <= self.stripes <= 65536:
            raise SceneError(f"gray stripes: found {self.stripes}, expected 2 … 65536")

    @property
    def bits(self) -> int:
        """Frames without their inverses."""
        return (self.stripes - 1).bit_length()

    @property
    def frames(self) -> int:
        """Frames per camera and exposure."""
        return self.bits * (2 if self.inverse else 1)

    def lines(self, size: int) -> NDArray[np.float64]:
        """(frames, size) values 0 or 1 along the fringe axis of a projector of `size` pixels."""
        number = np.floor(self.stripes * (np.arange(size) + 0.5) / size).astype(int)
        code = number ^ (number >> 1)
        bits = [(code >> bit & 1).astype(float) for bit in range(self.bits - 1, -1, -1)]
        return np.stack([line for bit in bits for line in ((bit, 1 - bit) if self.inverse else (bit,))])


@dataclass(frozen=True)
class FringeCode:
    """Phase-shifted fringes in several counts.

    The projector shows, for each count N, ``I_i(x) = a + b cos(2π N (x + ½)/W + 2π (i−1)/steps)``, i = 1 … steps, with
    x the projector column (axis x) or row (axis y) and W the projector's size along that axis (paper eqs 1 and 3).

    Attributes
    ----------
    axis : "x" or "y"
    steps : int
        Phase steps per count, at least 3.
    counts : tuple of int
        Fringes across the projector, one entry per count, in the order of the frames.
    gray : GrayCode or None
        Gray-code frames that follow the fringe frames and tell the order of the counts.
    """

    axis: Axis
    steps: int
    counts: tuple[int, ...]
    gray: GrayCode | None = None

    def __post_init__(self) -> None:
        if self.axis not in ("x", "y"):
            raise SceneError(f"fringe axis: found {self.axis!r}, expected 'x' or 'y'")
        if self.steps < 3:
            raise SceneError(f"fringe steps: found {self.steps}, expected at least 3")
        if not self.counts or any(n < 1 for n in self.counts):
            raise SceneError(f"fringe counts: found {list(self.counts)}, expected positive whole numbers")
        if len(set(self.counts)) != len(self.counts):
            raise SceneError(f"fringe counts: found {list(self.counts)}, expected each only once")
        if self.gray is not None:
            if self.gray.stripes < min(self.counts):
                raise SceneError(
                    f"gray stripes: found {self.gray.stripes}, expected at least {min(self.counts)}, one per fringe"
                )
        elif np.gcd.reduce(self.counts) != 1:
            raise SceneError(
                f"fringe counts: found {list(self.counts)} with a common factor, "
                "expected none (the fringe order would be ambiguous)"
            )

    @property
    def frames(self) -> int:
        """Frames per camera and exposure."""
        return self.fringe_frames + (self.gray.frames if self.gray else 0)

    @property
    def fringe_frames(self) -> int:
        """Frames per camera and exposure that show fringes; Gray-code frames come after them."""
        return self.steps * len(self.counts)

    def size(self, width: int, height: int) -> int:
        """W: the projector's size along the fringe axis, pixels."""
        return width if self.axis == "x" else height

    def patterns(self, width: int, height: int) -> NDArray[np.float64]:
        """The projector's images, values in [0, 1].

        Returns
        -------
        (frames, height, width) ndarray
            Count-major, then step; then Gray code from the most significant bit.
        """
        size = self.size(width, height)
        position = (np.arange(size) + 0.5) / size
        rows = [
            0.5 + 0.5 * np.cos(2 * np.pi * (count * position + step / self.steps))
            for count in self.counts
            for step in range(self.steps)
        ]
        lines = np.stack(rows)
        if self.gray:
            lines = np.concatenate([lines, self.gray.lines(size)])
        image = lines[:, None, :] if self.axis == "x" else lines[:, :, None]
        return np.broadcast_to(image, (self.frames, height, width))

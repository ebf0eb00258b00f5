"""The fringe code: which sinusoids the projector shows (paper eqs 1 and 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrology.errors import SceneError

Axis = Literal["x", "y"]
_LARGEST_SIZE = 2**24


@dataclass(frozen=True)
class GrayCode:
    """Gray-code frames after the fringes, for scans whose fringe counts do not tell the order themselves.

    The projector's pixels along the fringe axis fall into S equal stripes, j = ⌊S (x + ½)/W⌋; frame b, from the most
    significant bit, is bright where bit b of ``j ^ (j >> 1)`` is set.
    """

    stripes: int
    """S; at least as many as fringes of the smallest count, better twice as many (the complementary bit)."""
    inverse: bool = False
    """Whether each frame is followed by its inverse."""
    references: bool = False
    """Whether an all-white and an all-black frame follow."""
    shift: float = 0.0
    """How far the stripes' borders lie towards higher coordinates, stripes: j = ⌊S (x + ½)/W − shift⌋. Moves the
    borders against the fringes' wraps; codes of other people have them anywhere."""

    def __post_init__(self) -> None:
        if not 2 <= self.stripes <= 65536:
            raise SceneError(f"gray stripes: found {self.stripes}, expected 2 … 65536")
        if not abs(self.shift) <= self.stripes:
            raise SceneError(f"gray shift: found {self.shift:g} stripes, expected at most {self.stripes}")

    @property
    def bits(self) -> int:
        """Frames without their inverses."""
        return (self.stripes - 1).bit_length()

    @property
    def frames(self) -> int:
        """Frames per camera and exposure."""
        return self.stripe_frames + (2 if self.references else 0)

    @property
    def stripe_frames(self) -> int:
        """Frames that show stripes."""
        return self.bits * (2 if self.inverse else 1)

    def lines(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """(frames, n) values 0 or 1 at positions (n,), shares of W."""
        number = np.floor(self.stripes * position - self.shift).astype(int).clip(0, self.stripes - 1)
        code = number ^ (number >> 1)
        bits = [(code >> bit & 1).astype(float) for bit in range(self.bits - 1, -1, -1)]
        lines = [line for bit in bits for line in ((bit, 1 - bit) if self.inverse else (bit,))]
        return np.stack(lines + [np.ones_like(position), np.zeros_like(position)] * self.references)


@dataclass(frozen=True)
class FringeCode:
    """Phase-shifted fringes in several counts, Gray code, or both.

    The projector shows, for each count N, ``I_i(x) = a + b cos(2π N (x + ½)/W + ψ + 2π (i−1)/steps)``, i = 1 … steps
    (paper eqs 1 and 3), with x the projector column (axis x) or row (axis y) and W the projector's size along the axis.
    """

    axis: Axis
    steps: int | tuple[int, ...]
    """Phase steps per count, at least 3; one number for all counts or one per count."""
    counts: tuple[int, ...]
    """Fringes across W, one entry per count, in the order of the frames; none where Gray code is shown alone."""
    gray: GrayCode | None = None
    """Gray-code frames that follow the fringe frames and tell the order of the counts."""
    phase_offsets_rad: tuple[float, ...] = ()
    """ψ of every count; empty where all are 0."""
    size_px: int | None = None
    """W where it is not the projector's own size: codes with periods in pixels count over the pixels after which all of
    them begin anew, beyond the projector's border if need be."""

    def __post_init__(self) -> None:
        if self.axis not in ("x", "y"):
            raise SceneError(f"fringe axis: found {self.axis!r}, expected 'x' or 'y'")
        self._check_steps()
        if (not self.counts and not self.gray) or any(n < 1 for n in self.counts):
            raise SceneError(f"fringe counts: found {list(self.counts)}, expected positive whole numbers")
        if len(set(self.counts)) != len(self.counts):
            raise SceneError(f"fringe counts: found {list(self.counts)}, expected each only once")
        if self.gray is not None:
            if self.counts and self.gray.stripes < min(self.counts):
                raise SceneError(
                    f"gray stripes: found {self.gray.stripes}, expected at least {min(self.counts)}, one per fringe"
                )
        elif len(self.counts) == 1 and self.counts[0] > 1:
            raise SceneError(
                f"fringe counts: found {self.counts[0]} alone, whose fringes nothing tells apart, expected more "
                "counts, without a common factor, or Gray code beside it"
            )
        elif np.gcd.reduce(self.counts) != 1:
            raise SceneError(
                f"fringe counts: found {list(self.counts)} with a common factor, "
                "expected none (the fringe order would be ambiguous)"
            )

    def _check_steps(self) -> None:
        steps, offsets = self.steps, self.phase_offsets_rad
        if isinstance(steps, tuple):
            if len(steps) != len(self.counts):
                raise SceneError(f"fringe steps: found {len(steps)} of them, expected one or {len(self.counts)}")
            if len(set(steps)) == 1:
                object.__setattr__(self, "steps", steps[0])
        if self.counts and min(self.step_counts) < 3:
            raise SceneError(f"fringe steps: found {min(self.step_counts)}, expected at least 3")
        if len(offsets) not in (0, len(self.counts)) or not np.isfinite(offsets).all():
            raise SceneError(f"fringe phase offsets: found {list(offsets)}, expected {len(self.counts)} numbers")
        if not any(offsets):
            object.__setattr__(self, "phase_offsets_rad", ())
        if self.size_px is not None and not 1 <= self.size_px <= _LARGEST_SIZE:
            raise SceneError(f"fringe size: found {self.size_px} pixels, expected 1 to {_LARGEST_SIZE}")

    @property
    def step_counts(self) -> tuple[int, ...]:
        """Phase steps of every count."""
        return self.steps if isinstance(self.steps, tuple) else (self.steps,) * len(self.counts)

    @property
    def count_of(self) -> NDArray[np.int64]:
        """(fringe frames,) which count each of them shows."""
        return np.repeat(np.arange(len(self.counts)), self.step_counts)

    @property
    def step_of(self) -> NDArray[np.int64]:
        """(fringe frames,) which step of its count each of them shows, from 0 on."""
        return np.concatenate([np.arange(n) for n in self.step_counts] or [np.empty(0, np.int64)])

    @property
    def step_angles(self) -> NDArray[np.float64]:
        """(fringe frames,) phase by which each frame is shifted, radians."""
        return 2 * np.pi * self.step_of / np.repeat(self.step_counts, self.step_counts)

    @property
    def offset_turns(self) -> NDArray[np.float64]:
        """(counts,) phase offsets in turns."""
        return np.array(self.phase_offsets_rad or (0.0,) * len(self.counts)) / (2 * np.pi)

    @property
    def frames(self) -> int:
        """Frames per camera and exposure."""
        return self.fringe_frames + (self.gray.frames if self.gray else 0)

    @property
    def fringe_frames(self) -> int:
        """Frames per camera and exposure that show fringes; Gray-code frames come after them."""
        return sum(self.step_counts)

    @property
    def texture_frames(self) -> int:
        """Frames whose mean the texture is, or as many as it is as noisy as the mean of."""
        if self.counts or not self.gray:
            return self.fringe_frames
        return self.gray.stripe_frames if self.gray.inverse else 2

    def size(self, width: int, height: int) -> int:
        """The projector's size along the fringe axis, pixels."""
        return width if self.axis == "x" else height

    def patterns(self, width: int, height: int) -> NDArray[np.float64]:
        """The projector's images, values in [0, 1].

        Returns
        -------
        (frames, height, width) ndarray
            Count-major, then step; then Gray code from the most significant bit; then white and black.
        """
        size = self.size(width, height)
        lines = self.lines((np.arange(size) + 0.5) / (self.size_px or size))
        image = lines[:, None, :] if self.axis == "x" else lines[:, :, None]
        return np.broadcast_to(image, (self.frames, height, width))

    def lines(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """(frames, n) values in [0, 1] at positions (n,), shares of W, in the order of `patterns`."""
        own = np.array(self.counts, float)[self.count_of, None]
        turns = own * position + self.offset_turns[self.count_of, None]
        lines = 0.5 + 0.5 * np.cos(2 * np.pi * turns + self.step_angles[:, None])
        return np.concatenate([lines, self.gray.lines(position)]) if self.gray else lines

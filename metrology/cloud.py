"""What reconstruction yields: the two decoded views and the organised point cloud on the left camera's pixels."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrology.arrays import Float32
from metrology.errors import RigError
from metrology.frame_doubts import FrameDoubt
from metrology.noise import NoiseModel
from metrology.rig import Device, Rig


class PixelFlag(IntFlag):
    """Why a pixel has no value, or only a doubtful one. 0 is a good pixel."""

    GOOD = 0
    SATURATED = 1  # fewer unsaturated samples than unknowns in every exposure
    LOW_MODULATION = 2  # fringes too faint to carry a phase
    ORDER_RESIDUAL = 4  # mixed phase, at the picture's border too, or a fringe-order slip: phases contradict each other
    EDGE = 8  # within two blur radii of a reflectance or depth edge; has a value, keep it out of fits
    UNMATCHED = 16  # no counterpart of equal phase on the right camera's epipolar line
    SATURATED_SAMPLES = 32  # some samples or a neighbour saturated; has a value from the others
    SLOPE = 64  # matched, but phase hardly changes along the epipolar line, or the depth is out of range


# A pixel with one of these has no phase or no point.
MISSING = (
    PixelFlag.SATURATED | PixelFlag.LOW_MODULATION | PixelFlag.ORDER_RESIDUAL | PixelFlag.UNMATCHED | PixelFlag.SLOPE
)


def main_cause(flags: NDArray[np.uint16]) -> tuple[PixelFlag, float]:
    """Why most of the pixels with these flags have no point, and the share of them all that it holds for."""
    shares = {flag: float((flags & np.uint16(flag) != 0).mean()) for flag in PixelFlag if flag & MISSING}
    return max(shares.items(), key=lambda item: item[1])


@dataclass(frozen=True)
class DecodedView:
    """One camera's frames, decoded."""

    coordinate: Float32
    """(h, w) float32: projector coordinate along the fringe axis (column for axis x, row for y) in projector pixels,
    centres at integers; NaN where there is none."""
    sigma: Float32
    """(h, w) float32: standard deviation of `coordinate`, projector pixels."""
    modulation: Float32
    """(h, w) float32: fringe amplitude B in grey levels at exposure 1, root mean square over the fringe counts."""
    texture: Float32
    """(h, w) float32: mean grey level A at exposure 1 over all frames (may exceed the camera's range where exposures
    were fused)."""
    flags: NDArray[np.uint16]
    """(h, w) uint16: PixelFlag bits."""
    noise: NoiseModel | None = None
    """The camera's noise as it was taken for `sigma`."""
    stripe_px: float | None = None
    """Of Gray code alone: width of a stripe that is told apart, projector pixels; the coordinate runs straight between
    the stripes' borders."""
    borders_cross: bool = False
    """Of Gray code alone: whether borders lie where bits cross their inverses, so that no level moves them in turn."""
    gamma: float | None = None
    """The projector's, as the fringes show it; None where they do not tell."""


@dataclass(frozen=True)
class Reconstruction:
    """An organised cloud: entry [v, u] is the point that the left camera's raw pixel (u, v) sees."""

    rig: Rig
    left: DecodedView
    right: DecodedView | None
    """None where there is but one camera."""
    points: Float32
    """(h, w, 3) float32: rig frame, mm; NaN where none."""
    sigma_z: Float32
    """(h, w) float32: standard deviation of the point's z, mm. The point moves along its left viewing ray, so its
    covariance is sigma_z² times the outer product of (x/z, y/z, 1)."""
    flags: NDArray[np.uint16]
    """(h, w) uint16: PixelFlag bits, those of the left view included."""
    frames_digest: str | None = None
    """Names the content of the frames that it was made of."""
    remarks: tuple[str, ...] = ()
    """What was odd about the frames, not enough to refuse them."""
    doubts: tuple[FrameDoubt, ...] = ()
    """What the frames make doubtful beyond the values' U95."""

    def with_right(self) -> DecodedView:
        """The right view; RigError where there is none."""
        if self.right is None:
            raise RigError(f"rig {self.rig.id!r}: found one camera, expected two")
        return self.right

    @property
    def cameras(self) -> dict[str, tuple[Device, DecodedView]]:
        """The cameras that there are, of left and right, each with what it saw."""
        views = {"left": self.left} if self.right is None else {"left": self.left, "right": self.right}
        return {name: (device, views[name]) for name, device in self.rig.cameras.items()}

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """(h, w) where there is a point; read-only."""
        valid = np.isfinite(self.points[..., 2])
        valid.flags.writeable = False
        return valid

    @property
    def matched(self) -> float:
        """Points over what was decoded, by the camera that decoded less; 1 where nothing was."""
        decoded = min(float(np.isfinite(view.coordinate).mean()) for _, view in self.cameras.values())
        return float(self.valid.mean()) / decoded if decoded else 1.0

    def covariance(self, v: ArrayLike, u: ArrayLike) -> NDArray[np.float64]:
        """Covariance of the points at pixels [v, u], mm².

        A point moves along its viewing ray (x/z, y/z, 1) with sigma_z; the ray's own direction is exact.

        Returns
        -------
        (..., 3, 3) ndarray
        """
        at = (np.asarray(v, int), np.asarray(u, int))
        points = self.points[at].astype(float)
        ray = points / points[..., 2:]
        variance = self.sigma_z[at].astype(float) ** 2
        return np.asarray(variance[..., None, None] * ray[..., :, None] * ray[..., None, :])

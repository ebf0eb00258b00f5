"""How one camera sees a section: which pixel shows which place on the skin, and along which ray."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import PixelFlag, Reconstruction
from metrology.rig import Device
from metrology.seams.sampling import LocalMap, fit_map, grid_offsets
from metrology.seams.sections import Section, SkinLine

Array = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """One camera with its texture, saturated pixels as NaN."""

    name: str
    device: Device
    texture: NDArray[np.float32]


def both_views(reconstruction: Reconstruction) -> tuple[View, View]:
    """Left and right camera."""
    rig = reconstruction.rig
    views = []
    for name, device, decoded in (("left", rig.left, reconstruction.left), ("right", rig.right, reconstruction.right)):
        saturated = (decoded.flags & np.uint16(PixelFlag.SATURATED)) != 0
        texture = np.where(saturated, np.float32(np.nan), decoded.texture).astype(np.float32)
        views.append(View(name, device, texture))
    return views[0], views[1]


@dataclass(frozen=True)
class SectionView:
    """One camera's map of a section's surroundings on the reference curve: the mean of both skin lines.

    On it both sides have one coordinate x; `on_skin` moves what was found there along its viewing ray onto the side's
    own skin.

    Attributes
    ----------
    section : Section
    local : LocalMap
        Pixel → (x, y) of the section, on the reference curve, mm.
    eye : (3,) ndarray
        Centre of projection in the section's frame, mm.
    """

    section: Section
    local: LocalMap
    eye: Array

    @classmethod
    def of(cls, section: Section, device: Device, half_x: float, half_y: float) -> SectionView:
        """Map for |x| ≤ half_x, |y| ≤ half_y."""
        offsets = grid_offsets(half_x, half_y)
        x, y = offsets.T
        heights = reference_height(section, x)
        pixels = device.project(section.frame.rig(np.stack([x, y, heights], axis=-1)))
        return cls(section, fit_map(offsets, pixels), section.frame.local(device.centre))

    def ray_slope(self, x: float) -> float:
        """t = dx/dh along the viewing ray through the reference curve at x: the tangent of its angle from the
        normal."""
        h = reference_height(self.section, x)
        return float((self.eye[0] - x) / (self.eye[2] - h))

    def on_skin(self, x: float, side: SkinLine) -> float:
        """Where the viewing ray through the reference curve at x meets one side's skin line."""
        t = self.ray_slope(x)
        start = float(reference_height(self.section, x))
        place = x
        for _ in range(3):
            place = x + t * (side.height(place) - start)
        return place

    def on_reference(self, x: float, side: SkinLine) -> float:
        """Where the viewing ray through a side's skin at x meets the reference curve."""
        return x - self.ray_slope(x) * (side.height(x) - float(reference_height(self.section, x)))


def reference_height(section: Section, x: float | Array) -> Array:
    """Mean of both skin lines at x, mm."""
    mean = 0.5 * (section.a.coefficients + section.b.coefficients)
    return np.asarray(mean[0] + mean[1] * np.asarray(x) + mean[2] * np.asarray(x) ** 2)

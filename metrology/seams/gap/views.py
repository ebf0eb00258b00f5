"""How one camera sees a section: which pixel shows which place on the skin, and along which ray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.cloud import PixelFlag, Reconstruction
from metrology.gamma import fringe_gain
from metrology.rig import Device
from metrology.seams.sampling import LocalMap, fit_maps, grid_offsets
from metrology.seams.skins.sections import Section

# The share of ambient light is the median over every so many pixels either way.
_SPARSE = 8


@dataclass(frozen=True)
class View:
    """One camera."""

    device: Device
    texture: NDArray[np.float32]
    """(h, w) float32: saturated pixels NaN."""
    ambient: float
    """Share of the skin's brightness that does not follow the fringes, (A − B / gain) / A: light from elsewhere, the
    sensor's dark level, and what the projector's optics take from the fringes' contrast. Fringes of a gamma above 1
    change the light by more than its mean (`fringe_gain`): without that there would be hardly any other light."""


def both_views(reconstruction: Reconstruction) -> tuple[View, View]:
    """Left and right camera."""
    views = []
    for device, decoded in reconstruction.cameras.values():
        saturated = (decoded.flags & np.uint16(PixelFlag.SATURATED)) != 0
        texture = np.where(saturated, np.float32(np.nan), decoded.texture) if saturated.any() else decoded.texture
        some = (slice(None, None, _SPARSE), slice(None, None, _SPARSE))
        usual = np.isfinite(decoded.coordinate[some])
        fringes = decoded.modulation[some][usual] / fringe_gain(decoded.gamma)
        share = 1.0 - fringes / decoded.texture[some][usual]
        views.append(View(device, texture, float(np.clip(np.median(share), 0.02, 1.0)) if usual.any() else 1.0))
    return views[0], views[1]


def section_maps(sections: Sequence[Section], device: Device, half_x: Array, half_y: float) -> list[LocalMap]:
    """A camera's pixel → (x, y) of each section, mm, on the reference curve for |x| ≤ half_x (n,), |y| ≤ half_y.

    The reference curve is the mean of both skin lines: on it both sides have one coordinate x.
    """
    offsets = grid_offsets(half_x, half_y)
    heights = [reference_height(section, x) for section, x in zip(sections, offsets[..., 0], strict=True)]
    local = np.concatenate([offsets, np.array(heights)[..., None]], axis=-1)
    axes, origins = (np.array([getattr(section.frame, name) for section in sections]) for name in ("axes", "origin"))
    return fit_maps(offsets, device.project(local @ axes + origins[:, None]))


def reference_height(section: Section, x: float | Array) -> Array:
    """Mean of both skin lines at x, mm."""
    mean = 0.5 * (section.a.coefficients + section.b.coefficients)
    return np.asarray(mean[0] + mean[1] * np.asarray(x) + mean[2] * np.asarray(x) ** 2)

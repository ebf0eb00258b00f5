"""Organised clouds of seamed skin with known truth, made in the image without fringes: a scan takes a second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrology.arrays import Mask
from metrology.cloud import DecodedView, PixelFlag, Reconstruction
from tests.support.rivet_scan import rig_of
from tests.support.seam_textures import Band, paint

SHAPE = (700, 900)


@dataclass(frozen=True)
class Relief:
    """What a band in the image is: how deep it lies below the skin (negative: above), and the step across it, mm."""

    depth_mm: float = 0.0
    step_mm: float = 0.0


def seam_scan(
    bands: Sequence[Band],
    reliefs: Sequence[Relief],
    generator: np.random.Generator,
    sigma_z: float = 0.02,
    radius_mm: float = 1500.0,
    tilt: float = 0.05,
    saturated: Mask | None = None,
    unmatched: Mask | None = None,
    lit: Mask | None = None,
    discs: Sequence[tuple[float, float, float, float]] = (),
) -> Reconstruction:
    """A curved, tilted skin with bands of brightness that are gaps, steps, paint or cables.

    Parameters
    ----------
    sigma_z : float
        Noise of the points, mm.
    radius_mm : float
        Of the skin's curvature along u.
    tilt : float
        Slope of the skin along u.
    saturated : (h, w) bool, optional
        Where a highlight leaves no points.
    unmatched : (h, w) bool, optional
        Where a highlight in the other camera leaves none.
    lit : (h, w) bool, optional
        The projected field; everywhere by default.
    discs : as `seam_textures.paint` takes them
        Rivet heads, flush with the skin.
    """
    rig = rig_of(SHAPE[1], SHAPE[0])
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    texture = paint(bands, SHAPE, generator, discs=discs)
    px_mm = rig.left.K[0, 0] / 700.0
    x = (u - u.mean()) / px_mm
    z = 700.0 + tilt * x + 0.03 * (v - v.mean()) / px_mm + x**2 / (2 * radius_mm)
    for band, relief in zip(bands, reliefs, strict=True):
        along, across = band.local(u, v)
        inside = (np.abs(across) < band.width_px / 2) & (along > band.reach[0]) & (along < band.reach[1])
        z -= relief.step_mm * (across > 0)
        z += relief.depth_mm * inside
    z += generator.normal(0, sigma_z, SHAPE)
    missing = np.zeros(SHAPE, bool)
    flags = np.zeros(SHAPE, np.uint16)
    if saturated is not None:
        texture = np.where(saturated, 255.0, texture)
        flags[saturated] |= np.uint16(PixelFlag.SATURATED)
        missing |= saturated
    if unmatched is not None:
        flags[unmatched] |= np.uint16(PixelFlag.UNMATCHED)
        missing |= unmatched
    if lit is not None:
        texture = np.where(lit, texture, 4.0)
        flags[~lit] |= np.uint16(PixelFlag.LOW_MODULATION)
        missing |= ~lit
    rays = rig.left.normalized(np.stack([u, v], axis=-1))
    points = np.concatenate([rays, np.ones((*SHAPE, 1))], axis=-1) * z[..., None]
    points[missing] = np.nan
    view = DecodedView(
        coordinate=u.astype(np.float32),
        sigma=np.full(SHAPE, 0.02, np.float32),
        modulation=np.full(SHAPE, 60, np.float32),
        texture=texture.astype(np.float32),
        flags=flags,
    )
    return Reconstruction(rig, view, view, points.astype(np.float32), np.full(SHAPE, sigma_z, np.float32), flags)

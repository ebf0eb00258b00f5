"""Triangulation of one camera against the projector: a pixel's ray meets the sheet of light of its coordinate.

Both are known by calibration alone. Nothing is seen twice: a camera or projector that has moved bends the whole cloud,
and no match tells.
"""

from __future__ import annotations

import numpy as np

from metrology.arrays import Array
from metrology.cloud import MISSING, DecodedView, PixelFlag, Reconstruction
from metrology.errors import RigError, SceneError
from metrology.fringe import FringeCode
from metrology.jit import over_rows
from metrology.reconstruction_settings import ReconstructionSettings
from metrology.rig import Device, Rig
from metrology.ripple import without_ripple

_STEPS = 6
_SETTLED_PX = 1e-3
# Of what a projector beside the camera would give: less, and the fringes run along the baseline.
_LEAST_RATE = 0.3
_SPARSE = 8  # every so many rows and columns tell the direction
_FAR = 5.0  # baselines: a distance at which the directions are compared


def triangulate_one(
    left: DecodedView, rig: Rig, code: FringeCode, size: int, settings: ReconstructionSettings | None = None
) -> Reconstruction:
    """The cloud of one camera and the projector.

    Parameters
    ----------
    rig : Rig
        With a projector.
    size : int
        W, projector pixels along the fringe axis.
    """
    settings = settings or ReconstructionSettings()
    projector = rig.with_projector()
    _check_baseline(rig, projector, code)
    _check_direction(left, rig, projector, code)
    view = without_ripple(left, code, size)
    height, width = view.coordinate.shape
    points = np.empty((height, width, 3), np.float32)
    sigma_z = np.empty((height, width), np.float32)
    axis = 0 if code.axis == "x" else 1
    low, high = settings.depth_range_mm

    def solve(first: int, end: int) -> None:
        v, u = np.mgrid[first:end, :width]
        rays = np.concatenate([rig.left.normalized(np.stack([u, v], axis=-1)), np.ones((end - first, width, 1))], -1)
        depth, rate = _depths(rays, view.coordinate[first:end].astype(float), projector, axis)
        depth[~((depth > low) & (depth < high))] = np.nan
        points[first:end] = rays * depth[..., None]
        sigma_z[first:end] = np.where(np.isfinite(depth), view.sigma[first:end] / np.abs(rate), np.nan)

    with np.errstate(divide="ignore", invalid="ignore"):
        over_rows(solve, height, settings.threads)
    flags = view.flags.copy()
    lost = ~np.isfinite(points[..., 2]) & ((flags & np.uint16(MISSING)) == 0)
    flags[lost] |= np.uint16(PixelFlag.SLOPE)
    return Reconstruction(rig, view, None, points, sigma_z, flags)


def _depths(rays: Array, wanted: Array, projector: Device, axis: int) -> tuple[Array, Array]:
    """Depths at which rays (z = 1) have the wanted coordinate, and the coordinate's change per mm there.

    The distorted coordinate is nearly linear in the inverse depth's Möbius image: the undistorted position gives the
    start, and secants of the exact lens do the rest.
    """
    direction = rays @ projector.R.T
    K, t = projector.K, projector.t
    middle = np.full(wanted.shape, (projector.height if axis == 0 else projector.width) / 2.0)
    pixels = np.stack([wanted, middle] if axis == 0 else [middle, wanted], axis=-1)
    sheet = (pixels[..., axis] - K[axis, 2]) / K[axis, axis]
    for _ in range(_STEPS):
        inverse = (sheet * direction[..., 2] - direction[..., axis]) / (t[axis] - sheet * t[2])
        seen = _project(direction + inverse[..., None] * t, projector)
        missed = seen[..., axis] - wanted
        sheet = sheet - missed / K[axis, axis]
        if not np.nanmax(np.abs(missed), initial=0.0) > _SETTLED_PX:
            break
    inverse = (sheet * direction[..., 2] - direction[..., axis]) / (t[axis] - sheet * t[2])
    nudge = 1e-5 * np.abs(inverse)
    ahead = _project(direction + (inverse + nudge)[..., None] * t, projector)[..., axis]
    here = _project(direction + inverse[..., None] * t, projector)[..., axis]
    depth = 1.0 / inverse
    return depth, (ahead - here) / nudge * inverse**2


def _project(seen: Array, device: Device) -> Array:
    """Raw pixels of directions in the device's own frame, NaN where a direction is."""
    return device.through_lens(seen[..., 0] / seen[..., 2], seen[..., 1] / seen[..., 2])


def _check_direction(view: DecodedView, rig: Rig, projector: Device, code: FringeCode) -> None:
    """Refuse a coordinate that falls where it must rise: what both devices see of one skin comes in one order."""
    axis = 0 if code.axis == "x" else 1
    middle = np.array([rig.left.width, rig.left.height]) / 2
    rays = rig.left.rays(middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    away = _FAR * float(np.linalg.norm(projector.centre))
    at = projector.project(rays * (away / rays[:, 2:]))[:, axis]
    coordinate = view.coordinate[::_SPARSE, ::_SPARSE]
    steps = [np.diff(coordinate, axis=1), np.diff(coordinate, axis=0)]
    seen = [float(np.median(step[np.isfinite(step)])) if np.isfinite(step).any() else 0.0 for step in steps]
    if float(np.dot(at[1:] - at[0], seen)) < 0:
        raise SceneError(
            "found a projector coordinate that falls where the rig's projector lets it rise, expected both in one "
            "order: most likely the steps were shown backward (`scene new --direction -1`), or the frames are mirrored "
            "or turned"
        )


def _check_baseline(rig: Rig, projector: Device, code: FringeCode) -> None:
    """Refuse fringes along the baseline: their coordinate does not change with depth."""
    across = np.abs(projector.R @ projector.centre)
    own, other = (across[0], across[1]) if code.axis == "x" else (across[1], across[0])
    if own < _LEAST_RATE * np.hypot(own, other):
        wanted = "y" if code.axis == "x" else "x"
        raise RigError(
            f"fringe axis {code.axis!r}: found fringes along the line from the camera to the projector of rig "
            f"{rig.id!r}, expected axis {wanted!r}"
        )

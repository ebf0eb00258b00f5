"""What the 3-D data say about a line in the image: a groove, a step, both, or nothing (a scratch, paint, a shadow)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.seams.settings import SeamSettings

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_STATION_PX = 12.0
_HALF_ALONG_PX = 12.0
_SKIN_PX = 30.0
_MIN_SIDE_POINTS = 80
_MIN_INSIDE_PIXELS = 8
# Skins on both sides of a seam belong together: no farther apart, and no more inclined, than this.
_MAX_STEP_MM = 4.0
_MAX_ANGLE = np.tan(np.deg2rad(25.0))
# A place is a groove where most pixels between the skins are deeper, or are missing and dark.
_GROOVE_SHARE = 0.4
_SHADOW = 0.5
# A seam shows relief over most of its length, and has skin on both sides over most of it.
_RELIEF_SHARE = 0.6
_SKIN_SHARE = 0.5
_STEP_SIGMAS = 4.0


@dataclass(frozen=True)
class Relief:
    """What was found along a line.

    Attributes
    ----------
    skin_share : float
        Share of places with skin on both sides.
    groove_share : float
        Share of those with a groove.
    step_mm : float
        Median of the step.
    step_share : float
        Share of those with a step of that sign beyond noise and the least step asked for.
    """

    skin_share: float
    groove_share: float
    step_mm: float
    step_share: float

    @property
    def between_skins(self) -> bool:
        """Whether both sides are skin: not the panel's own border, nor that of the projected field."""
        return self.skin_share >= _SKIN_SHARE

    @property
    def is_seam(self) -> bool:
        """Whether the line is a groove or a step of the skin."""
        return self.between_skins and max(self.groove_share, self.step_share) >= _RELIEF_SHARE


def examine_relief(
    centre_px: Array, width_px: float, reconstruction: Reconstruction, usable: Mask, settings: SeamSettings
) -> Relief:
    """Look at the points on both sides of a line and between them.

    Parameters
    ----------
    centre_px : (n, 2) ndarray
        About one point per pixel.
    width_px : float
        The line's.
    usable : (h, w) ndarray of bool
        Pixels with a point that is not mixed across an edge.
    """
    stops = np.arange(0, len(centre_px), int(_STATION_PX))
    found = [
        place
        for i in stops
        if (place := _examine_place(centre_px, int(i), width_px, reconstruction, usable, settings)) is not None
    ]
    if not found:
        return Relief(0.0, 0.0, 0.0, 0.0)
    step, sigma, groove = np.array(found).T
    median = float(np.median(step))
    beyond = (np.sign(step) == np.sign(median)) & (np.abs(step) > _STEP_SIGMAS * sigma)
    beyond &= np.abs(step) > settings.min_step_mm
    return Relief(len(found) / len(stops), float(groove.mean()), median, float(beyond.mean()))


def _examine_place(
    centre_px: Array, i: int, width_px: float, reconstruction: Reconstruction, usable: Mask, settings: SeamSettings
) -> tuple[float, float, float] | None:
    """Step, its standard deviation, and whether there is a groove; None without skin on both sides.

    Over a plane 1/z is affine in the pixel; both sides share its slopes and a curvature across the line, so that their
    offset is the step along the ray, Δz = −z² Δ(1/z).
    """
    before, after = centre_px[max(0, i - 10)], centre_px[min(len(centre_px) - 1, i + 10)]
    tangent = (after - before) / (np.linalg.norm(after - before) + 1e-12)
    inner = width_px / 2 + settings.guard_px
    reach = int(inner + _SKIN_PX + _HALF_ALONG_PX)
    u0, v0 = np.round(centre_px[i]).astype(int)
    rows = slice(max(0, v0 - reach), max(0, v0 + reach + 1))
    columns = slice(max(0, u0 - reach), max(0, u0 + reach + 1))
    v, u = np.mgrid[rows, columns][:, : usable[rows, columns].shape[0], : usable[rows, columns].shape[1]]
    du, dv = u - centre_px[i, 0], v - centre_px[i, 1]
    x = -du * tangent[1] + dv * tangent[0]
    y = du * tangent[0] + dv * tangent[1]
    z = reconstruction.points[rows, columns, 2].astype(float)
    near = np.abs(y) < _HALF_ALONG_PX
    skin = near & usable[rows, columns] & (np.abs(x) > inner) & (np.abs(x) < inner + _SKIN_PX)
    sides = skin & (x < 0), skin & (x > 0)
    if min(int(side.sum()) for side in sides) < _MIN_SIDE_POINTS:
        return None
    medians = [float(np.median(z[side])) for side in sides]
    if abs(medians[0] - medians[1]) > _MAX_STEP_MM + 2 * (inner + _SKIN_PX) * _MAX_ANGLE * _mm_per_px(
        reconstruction, medians
    ):
        return None
    fit = _both_sides(x[skin], y[skin], 1.0 / z[skin], reconstruction.sigma_z[rows, columns][skin] / z[skin] ** 2)
    if fit is None:
        return None
    coefficients, covariance = fit
    middle = 0.5 * (coefficients[0] + coefficients[1])
    depth = 1.0 / middle
    step = abs(depth**2 * (coefficients[1] - coefficients[0]))
    sigma = depth**2 * float(np.sqrt(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]))
    if step > _MAX_STEP_MM:
        return None
    signed = float(depth**2 * (coefficients[1] - coefficients[0]))
    inside = near & (np.abs(x) < max(width_px / 2 - 0.5, 0.75)) & (np.abs(y) < _HALF_ALONG_PX)
    return (
        signed,
        sigma,
        float(_is_groove(inside, skin, z, x, y, coefficients, rows, columns, reconstruction, settings)),
    )


def _mm_per_px(reconstruction: Reconstruction, depths: list[float]) -> float:
    return max(depths) / reconstruction.rig.left.K[0, 0]


def _both_sides(x: Array, y: Array, inverse: Array, sigma: Array) -> tuple[Array, Array] | None:
    """Least squares of 1/z = (offset of the side) + b x + c y + d x², with outliers clipped."""
    design = np.stack([x < 0, x > 0, x, y, x * x], axis=-1).astype(float)
    keep = np.ones(len(x), bool)
    for _ in range(4):
        weighted = design[keep] / sigma[keep, None]
        normal = weighted.T @ weighted
        try:
            solution = np.linalg.solve(normal, weighted.T @ (inverse[keep] / sigma[keep]))
        except np.linalg.LinAlgError:
            return None
        residual = (inverse - design @ solution) / sigma
        spread = 1.4826 * float(np.median(np.abs(residual[keep]))) + 1e-12
        keep = np.abs(residual) < 4 * spread
        if min((keep & (x < 0)).sum(), (keep & (x > 0)).sum()) < _MIN_SIDE_POINTS // 2:
            return None
    return np.asarray(solution, float), np.asarray(np.linalg.inv(normal) * spread**2, float)


def _is_groove(
    inside: Mask,
    skin: Mask,
    z: Array,
    x: Array,
    y: Array,
    coefficients: Array,
    rows: slice,
    columns: slice,
    reconstruction: Reconstruction,
    settings: SeamSettings,
) -> bool:
    """Whether most pixels between the skins are deeper than both, or have no point because they lie in shadow."""
    if inside.sum() < _MIN_INSIDE_PIXELS:
        return False
    lower = np.minimum(coefficients[0], coefficients[1])
    inverse = lower + coefficients[2] * x + coefficients[3] * y + coefficients[4] * x * x
    deeper = z - 1.0 / inverse > settings.min_groove_mm
    texture = reconstruction.left.texture[rows, columns]
    shadow = ~np.isfinite(z) & (texture < _SHADOW * float(np.median(texture[skin])))
    return bool(((deeper | shadow) & inside).sum() > _GROOVE_SHARE * inside.sum())

"""A chessboard corner to a hundredth of a pixel: two blurred edges that cross, fitted to the grey levels themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from metrology.arrays import Array

_START_BLUR_PX = 1.0
_LEAST_BLUR_PX = 0.25
_BAND_PX = 4.0  # half-width of the bands along both edges that are fitted, at least
_BAND_BLURS = 3.0
_LEAST_BAND_PX = 2.0
_CLEAR_BLURS = 2.0  # from what else is printed, so far its blur reaches
_ITERATIONS = 15
_CONVERGED_PX = 1e-4
_LOST_PX = 2.0  # a corner that leaves its start by more has locked onto something else
_LEAST_PIXELS = 80
_LEAST_CONTRAST = 3.0  # edge height over the residual's scatter


@dataclass(frozen=True)
class CornerFit:
    """A corner."""

    centre: Array
    """(2,): pixels."""
    covariance: Array
    """(2, 2): px², from the fit's own residual."""
    blur_px: float
    """Standard deviation of the edges' Gaussian blur."""

    @property
    def sigma_px(self) -> float:
        """Root mean square standard deviation of the two coordinates."""
        return float(np.sqrt(np.trace(self.covariance) / 2))


def fit_corner(
    image: Array, start: Array, directions: Array, reach_px: float, clear_px: float = np.inf
) -> CornerFit | None:
    """Fit one corner.

    Least squares of ``I = m + g·x + c erf(d₁/√2σ) erf(d₂/√2σ)`` with d₁, d₂ the distances from two lines through the
    corner, each turning freely, m and g a sloping mean level, c half the contrast and σ the blur.

    Parameters
    ----------
    image : (h, w) float array
    start : (2,) array
        Corner to start from, pixels.
    directions : (2, 2) array
        Rows: unit vectors along the two edges.
    reach_px : float
        How far along the edges to look; less than to the next corner.
    clear_px : float
        How far from the edges something else is printed, as a marker is.

    Returns
    -------
    CornerFit or None
        None where no such corner is found.
    """
    margin = int(np.ceil(reach_px))
    u0, v0 = np.rint(start).astype(int) - margin
    size = 2 * margin + 1
    if u0 < 0 or v0 < 0 or u0 + size > image.shape[1] or v0 + size > image.shape[0]:
        return None
    level = image[v0 : v0 + size, u0 : u0 + size]
    v, u = np.mgrid[:size, :size]
    pixels = np.stack([u, v], -1).astype(float)
    origin = np.array([u0, v0])
    centre, angles, blur = start - origin, np.arctan2(directions[:, 1], directions[:, 0]), _START_BLUR_PX
    for _ in range(_ITERATIONS):
        offset = pixels - centre
        normals = np.column_stack([-np.sin(angles), np.cos(angles)])
        along = np.column_stack([np.cos(angles), np.sin(angles)])
        distance = offset @ normals.T
        band = min(max(_BAND_PX, _BAND_BLURS * blur), max(clear_px - _CLEAR_BLURS * blur, _LEAST_BAND_PX))
        near = np.abs(distance).min(-1) < band
        near &= np.linalg.norm(offset, axis=-1) < reach_px
        if near.sum() < _LEAST_PIXELS:
            return None
        solved = _step(level[near], offset[near], distance[near], offset[near] @ along.T, normals, blur)
        if solved is None:
            return None
        step, covariance = solved
        centre = centre + np.clip(step[:2], -1, 1)
        angles = angles + np.clip(step[2:4], -0.1, 0.1)
        blur = max(blur + float(step[4]), _LEAST_BLUR_PX)
        if blur > reach_px / 3:
            return None
        if np.abs(step[:2]).max() < _CONVERGED_PX:
            break
    if np.hypot(*(centre + origin - start)) > _LOST_PX:
        return None
    return CornerFit(centre + origin, covariance, blur)


def _step(
    level: Array, offset: Array, distance: Array, along: Array, normals: Array, blur: float
) -> tuple[Array, Array] | None:
    """One Gauss-Newton step (centre, angles, blur) with the centre's covariance; levels are solved for each time."""
    edge = erf(distance / (np.sqrt(2) * blur))
    plateaus = np.column_stack([np.ones(len(level)), offset, edge.prod(1)])
    levels = np.linalg.lstsq(plateaus, level, rcond=None)[0]
    residual = level - plateaus @ levels
    variance = residual @ residual / max(len(residual) - 9, 1)
    if abs(levels[3]) < _LEAST_CONTRAST * np.sqrt(variance):
        return None
    slope = np.sqrt(2 / np.pi) / blur * np.exp(-0.5 * (distance / blur) ** 2) * edge[:, ::-1] * levels[3]
    jacobian = np.column_stack(
        [
            -slope @ normals,
            -slope * along,  # turning a line by dα moves it by s dα at distance s along it
            -(slope * distance).sum(1) / blur,
            plateaus,
        ]
    )
    size = np.linalg.norm(jacobian, axis=0)
    if not (size > 0).all():
        return None
    try:
        inverse = np.linalg.inv((jacobian / size).T @ (jacobian / size)) / np.outer(size, size)
    except np.linalg.LinAlgError:
        return None
    return (inverse @ (jacobian.T @ residual))[:5], variance * inverse[:2, :2]

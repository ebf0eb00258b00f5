"""A chessboard corner to a hundredth of a pixel: two blurred edges that cross, fitted to the grey levels themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
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
_LOST_PX, _LOST = 2.0, 0.2  # of the reach: a corner that leaves its start by more has locked onto something else
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
    image: Array,
    start: Array,
    directions: Array,
    reach_px: float,
    clear_px: float = np.inf,
    clipped: NDArray[np.bool_] | None = None,
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
    clipped : (h, w) bool array, optional
        Pixels that are at least as bright as the image says: they count where the model has them darker.

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
    window = np.s_[v0 : v0 + size, u0 : u0 + size]
    level = image[window]
    brighter = np.zeros(level.shape, np.bool_) if clipped is None else clipped[window]
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
        if brighter.any():
            near &= ~_satisfied(level, offset, distance, near, brighter, blur)
        if near.sum() < _LEAST_PIXELS:
            return None
        solved = _step(level[near], offset[near], distance[near], offset[near] @ along.T, normals, blur)
        if solved is None:
            return None
        step, covariance, contrast = solved
        centre = centre + np.clip(step[:2], -1, 1)
        angles = angles + np.clip(step[2:4], -0.1, 0.1)
        blur = max(blur + float(step[4]), _LEAST_BLUR_PX)
        if blur > reach_px / 3:
            return None
        if np.abs(step[:2]).max() < _CONVERGED_PX:
            break
    if contrast < _LEAST_CONTRAST or np.hypot(*(centre + origin - start)) > max(_LOST_PX, _LOST * reach_px):
        return None
    return CornerFit(centre + origin, covariance, blur)


def _satisfied(
    level: Array, offset: Array, distance: Array, near: NDArray[np.bool_], clipped: NDArray[np.bool_], blur: float
) -> NDArray[np.bool_]:
    """Clipped pixels that the model, as the others have it, makes as bright as they are, or brighter."""
    edge = erf(distance / (np.sqrt(2) * blur)).prod(-1)
    plateaus = np.concatenate([np.ones((*level.shape, 1)), offset, edge[..., None]], axis=-1)
    known = near & ~clipped
    levels = np.linalg.lstsq(plateaus[known], level[known], rcond=None)[0]
    return np.asarray(clipped & (plateaus @ levels >= level))


def _step(
    level: Array, offset: Array, distance: Array, along: Array, normals: Array, blur: float
) -> tuple[Array, Array, float] | None:
    """One Gauss-Newton step (centre, angles, blur), the centre's covariance, and the edges' height over the residual's
    scatter; levels are solved for each time.
    """
    edge = erf(distance / (np.sqrt(2) * blur))
    plateaus = np.column_stack([np.ones(len(level)), offset, edge.prod(1)])
    levels = np.linalg.lstsq(plateaus, level, rcond=None)[0]
    residual = level - plateaus @ levels
    variance = residual @ residual / max(len(residual) - 9, 1)
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
    contrast = float(abs(levels[3]) / np.sqrt(max(variance, np.finfo(float).tiny)))
    return (inverse @ (jacobian.T @ residual))[:5], variance * inverse[:2, :2], contrast

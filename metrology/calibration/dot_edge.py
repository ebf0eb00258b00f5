"""A dot's outline to a hundredth of a pixel: an ellipse with a blurred edge fitted to the grey levels themselves.

Every pixel near the rim tells where the rim is, so the fit comes close to what the noise allows, and its residual says
how well the centre is known. The centre is that of the ellipse; the image of the disc's own centre lies elsewhere
(`eccentricity`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from metrology.arrays import Array

_START_BLUR_PX = 1.0
_LEAST_BLUR_PX = 0.25  # sharper than the pixel itself: only the fit going astray
_BAND_PX = 3.5  # half-width of the band about the rim that is fitted, at least
_BAND_BLURS = 3.0
_ITERATIONS = 12
_CONVERGED_PX = 1e-4
_LOST_PX = 3.0  # a centre that leaves its contour by more has locked onto something else
_RIM_SAMPLES = 72


@dataclass(frozen=True)
class DotFit:
    """An ellipse (x − centre)ᵀ shape (x − centre) = 1."""

    centre: Array
    """(2,): pixels."""
    shape: Array
    """(2, 2): symmetric, 1/px²."""
    covariance: Array
    """(2, 2): of the centre, px², from the fit's own residual."""
    blur_px: float
    """Standard deviation of the edge's Gaussian blur."""
    rim_fraction: float
    """Part of the rim that was visible."""

    @property
    def area(self) -> float:
        """Area in px²."""
        return float(np.pi / np.sqrt(np.linalg.det(self.shape)))

    @property
    def sigma_px(self) -> float:
        """Root mean square standard deviation of the centre's two coordinates."""
        return float(np.sqrt(np.trace(self.covariance) / 2))

    @property
    def minor_radius_px(self) -> float:
        """Smaller semi-axis."""
        return float(1 / np.sqrt(np.linalg.eigvalsh(self.shape)[-1]))


def shape_matrix(axes_px: tuple[float, float], angle_deg: float) -> Array:
    """(2, 2) matrix of the ellipse with full axes `axes_px`, the first at `angle_deg` from +u towards +v."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    turn = np.array([[c, -s], [s, c]])
    return np.asarray(turn @ np.diag(4.0 / np.square(axes_px)) @ turn.T)


def fit_dot(image: Array, weight: Array, contour: NDArray[np.int32]) -> DotFit | None:
    """Fit one dot.

    Least squares of ``I(x) = o(x) Φ(d/σ) + i (1 − Φ(d/σ))`` with d the distance of x outside the ellipse, Φ the normal
    distribution, o(x) a linearly varying level outside, i the level inside and σ the blur.

    Parameters
    ----------
    image : (h, w) float array
        Grey levels, or a ratio of them.
    weight : (h, w) float array
        Inverse variance of the pixels up to a factor; 0 hides a pixel.
    contour : (n, 1, 2) int array
        Outline to start from, at least 5 points.

    Returns
    -------
    DotFit or None
        None where no ellipse with a proper edge is found.
    """
    start, axes, angle = cv2.fitEllipse(contour)
    if not min(axes) > 0:
        return None
    shape = shape_matrix((axes[0], axes[1]), angle)
    margin = int(np.ceil(max(axes) / 2 + _BAND_PX + 2))
    u0, v0 = max(round(start[0]) - margin, 0), max(round(start[1]) - margin, 0)
    window = np.s_[v0 : round(start[1]) + margin + 1, u0 : round(start[0]) + margin + 1]
    patch, patch_weight = image[window], weight[window]
    v, u = np.mgrid[: patch.shape[0], : patch.shape[1]]
    local = np.array(start) - (u0, v0)
    fitted = _refine(patch, patch_weight, np.stack([u, v], -1).astype(float), local, shape)
    if fitted is None or np.hypot(*(fitted.centre - local)) > _LOST_PX:
        return None
    return replace(fitted, centre=fitted.centre + np.array([u0, v0]))


def _refine(patch: Array, weight: Array, pixels: Array, centre: Array, shape: Array) -> DotFit | None:
    """Gauss-Newton over centre, shape, blur and levels, all in the patch's pixels."""
    blur = _START_BLUR_PX
    for _ in range(_ITERATIONS):
        offset = pixels - centre
        scaled = offset @ shape
        q = np.sqrt(np.maximum((offset * scaled).sum(-1), 1e-9))
        distance = q * (q - 1) / np.maximum(np.linalg.norm(scaled, axis=-1), 1e-9)
        band = (np.abs(distance) < max(_BAND_PX, _BAND_BLURS * blur)) & (weight > 0)
        if band.sum() < 60:
            return None
        solved = _step(patch[band], weight[band], offset[band], scaled[band], q[band], distance[band], blur)
        if solved is None:
            return None
        step, covariance = solved
        centre = centre + step[:2]
        shape = shape + np.array([[step[2], step[3]], [step[3], step[4]]])
        blur = max(blur + float(step[5]), _LEAST_BLUR_PX)
        if np.linalg.eigvalsh(shape)[0] <= 0 or blur > 2 / np.sqrt(np.linalg.eigvalsh(shape)[-1]):
            return None
        if np.abs(step[:2]).max() < _CONVERGED_PX:
            break
    return DotFit(centre, shape, covariance, blur, _rim_fraction(weight, centre, shape))


def _step(
    level: Array, weight: Array, offset: Array, scaled: Array, q: Array, distance: Array, blur: float
) -> tuple[Array, Array] | None:
    """One Gauss-Newton step (centre, shape, blur) with the centre's covariance; the levels are solved for each time."""
    outside = ndtr(distance / blur)
    plateaus = np.column_stack([outside, outside * offset[:, 0], outside * offset[:, 1], 1 - outside])
    root = np.sqrt(weight)
    levels = np.linalg.lstsq(plateaus * root[:, None], level * root, rcond=None)[0]
    contrast = levels[0] + offset @ levels[1:3] - levels[3]
    slope = contrast * np.exp(-0.5 * (distance / blur) ** 2) / (np.sqrt(2 * np.pi) * blur)
    # ∂d/∂p ≈ (∂q/∂p) / |∇q| near the rim, with |∇q| = |A r| / q.
    steep = slope / np.maximum(np.linalg.norm(scaled, axis=-1), 1e-9)
    x, y = offset.T
    jacobian = np.column_stack(
        [
            -steep * scaled[:, 0],
            -steep * scaled[:, 1],
            steep * x * x / 2,
            steep * x * y,
            steep * y * y / 2,
            -slope * distance / blur,
            plateaus,
        ]
    )
    jacobian *= root[:, None]
    size = np.linalg.norm(jacobian, axis=0)
    if not (size > 0).all():
        return None
    residual = (level - plateaus @ levels) * root
    normal = (jacobian / size).T @ (jacobian / size)
    try:
        inverse = np.linalg.inv(normal)
    except np.linalg.LinAlgError:
        return None
    step = inverse @ ((jacobian / size).T @ residual) / size
    variance = residual @ residual / max(len(residual) - len(step), 1)
    return step[:6], (variance * inverse / np.outer(size, size))[:2, :2]


def _rim_fraction(weight: Array, centre: Array, shape: Array) -> float:
    angle = np.linspace(0, 2 * np.pi, _RIM_SAMPLES, endpoint=False)
    rim = centre + np.column_stack([np.cos(angle), np.sin(angle)]) @ np.linalg.inv(np.linalg.cholesky(shape))
    u, v = np.rint(rim).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < weight.shape[1]) & (v < weight.shape[0])
    seen = np.zeros(len(u), bool)
    seen[inside] = weight[v[inside], u[inside]] > 0
    return float(seen.mean())

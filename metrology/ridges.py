"""Dark or bright lines of an image to a fraction of a pixel: Steger's detector (paper §3.2).

C. Steger, "An unbiased detector of curvilinear structures", IEEE Trans. PAMI 20 (1998) 113–125: a point lies on a line
where the first derivative across the line vanishes and the second is strong. Rivet rims and seams are both lines, so
both rooms start here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike

from metrology.arrays import Float32
from metrology.errors import UsageError
from metrology.jit import kernel, over_rows

Polarity = Literal["dark", "bright", "both"]

# Half a pixel finds every line point exactly once; a little more closes the holes that rounding leaves in diagonal
# lines.
_REACH_PX = 0.6
_SIGNS = {"dark": 1, "bright": -1, "both": 0}


@dataclass(frozen=True)
class RidgeMap:
    """Line points of an image, on its pixel grid."""

    strength: Float32
    """(h, w) float32: magnitude of the second derivative across the line, grey levels per px²; 0 where the pixel holds
    no line point. Negative for bright lines where both polarities were asked for."""
    u: Float32
    v: Float32
    """u, v: (h, w) float32: sub-pixel position of the line point, px. Meaningless where `strength` is 0."""
    normal_u: Float32
    normal_v: Float32
    """normal_u, normal_v: (h, w) float32: unit vector across the line; its sign is arbitrary."""


@dataclass(frozen=True)
class Derivatives:
    """Gaussian derivatives of an image, each (h, w) float32, in grey levels per px or px²."""

    u: Float32
    v: Float32
    uu: Float32
    uv: Float32
    vv: Float32


def gaussian_kernels(sigma_px: float) -> tuple[Float32, Float32, Float32]:
    """Gaussian and its first two derivatives, integrated over pixels so that moments come out exactly.

    Returns
    -------
    smooth, first, second : (n,) float32
        Convolution kernels; `first` of a ramp of slope 1 is 1, `second` of x²/2 is 1.
    """
    if not sigma_px > 0:
        raise UsageError(f"ridge detector: found scale {sigma_px}, expected a positive number of pixels")
    radius = int(np.ceil(4 * sigma_px))
    x = np.arange(-radius, radius + 1, dtype=float)
    smooth = np.exp(-0.5 * (x / sigma_px) ** 2)
    smooth /= smooth.sum()
    first = x * smooth
    first /= (first * x).sum()
    second = (x**2 / sigma_px**2 - 1) * smooth
    second -= second.mean()
    second /= (second * x**2 / 2).sum()
    return smooth.astype(np.float32), first.astype(np.float32), second.astype(np.float32)


def gaussian_derivatives(image: ArrayLike, sigma_px: float) -> Derivatives:
    """First and second derivatives of an image (h, w) smoothed by a Gaussian of `sigma_px`."""
    grey = np.ascontiguousarray(image, np.float32)
    smooth, first, second = gaussian_kernels(sigma_px)

    def filtered(along_u: Float32, along_v: Float32) -> Float32:
        result = cv2.sepFilter2D(grey, cv2.CV_32F, along_u, along_v, borderType=cv2.BORDER_REFLECT_101)
        return np.asarray(result, np.float32)

    return Derivatives(
        u=filtered(first, smooth),
        v=filtered(smooth, first),
        uu=filtered(second, smooth),
        uv=filtered(first, first),
        vv=filtered(smooth, second),
    )


def curvature_noise(sigma_px: float) -> float:
    """Standard deviation of a second derivative, per grey level of white pixel noise (per px²)."""
    smooth, _, second = gaussian_kernels(sigma_px)
    return float(np.linalg.norm(smooth) * np.linalg.norm(second))


def bar_curvature(width_px: float, contrast: float, sigma_px: float) -> float:
    """Second derivative at the centre of a bar (Steger 1998, eq 8), grey levels per px².

    ``contrast · w / (√(2π) σ³) · exp(−w² / (8 σ²))`` for a bar of width w: what a threshold on `strength` means.
    """
    scale = width_px / (np.sqrt(2 * np.pi) * sigma_px**3)
    return float(contrast * scale * np.exp(-(width_px**2) / (8 * sigma_px**2)))


def ridge_points(
    image: ArrayLike, sigma_px: float, threshold: float, polarity: Polarity = "dark", threads: int | None = None
) -> RidgeMap:
    """Line points at one scale.

    With the eigenvector n of the Hessian's eigenvalue λ of largest magnitude, the line lies at
    ``t = −(∇g · n) / λ`` along n from the pixel's centre; the pixel holds a line point where t n stays within it
    and λ > threshold (dark line) or λ < −threshold (bright line).

    Parameters
    ----------
    image : (h, w) array
        Grey levels.
    sigma_px : float
        Scale. From w / (2√3) on, a bar of width w has its only strong response at its centre (Steger 1998).
    threshold : float
        Least second derivative across the line, grey levels per px²; see `bar_curvature`, `curvature_noise`.
    threads : int, optional
        Threads to share the rows; all available by default.
    """
    if polarity not in _SIGNS:
        raise UsageError(f"ridge detector: found polarity {polarity!r}, expected dark, bright or both")
    d = gaussian_derivatives(image, sigma_px)
    out = [np.zeros(d.u.shape, np.float32) for _ in range(5)]
    sign = _SIGNS[polarity]

    def rows(first: int, end: int) -> None:
        _line_points(d.u, d.v, d.uu, d.uv, d.vv, threshold, sign, first, end, *out)

    over_rows(rows, d.u.shape[0], threads)
    return RidgeMap(*out)


@kernel
def _line_points(  # type: ignore[no-untyped-def]
    gu, gv, guu, guv, gvv, threshold, sign, first, end, strength, u, v, normal_u, normal_v
):
    """Steger's line points of rows first … end − 1, into the five output images."""
    for row in range(first, end):
        for column in range(gu.shape[1]):
            a, b, c = guu[row, column], guv[row, column], gvv[row, column]
            half_trace = 0.5 * (a + c)
            if sign != 0 and sign * half_trace <= 0.0:
                # The eigenvalue of largest magnitude has the trace's sign.
                continue
            half_gap = np.sqrt(0.25 * (a - c) ** 2 + b * b)
            curvature = half_trace + half_gap if half_trace >= 0.0 else half_trace - half_gap
            if abs(curvature) <= threshold:
                continue
            # Of the two expressions for the eigenvector, the longer one is the well-conditioned one.
            nu, nv = curvature - c, b
            if abs(curvature - a) > abs(curvature - c):
                nu, nv = b, curvature - a
            length = np.sqrt(nu * nu + nv * nv)
            if length == 0.0:
                continue
            nu /= length
            nv /= length
            t = -(gu[row, column] * nu + gv[row, column] * nv) / curvature
            if abs(t * nu) > _REACH_PX or abs(t * nv) > _REACH_PX:
                continue
            strength[row, column] = curvature if sign == 0 else abs(curvature)
            u[row, column] = column + t * nu
            v[row, column] = row + t * nv
            normal_u[row, column] = nu
            normal_v[row, column] = nv

"""Sub-pixel fit of a ring: the image of the thin gap round a rivet head, or of a round step without a gap.

The model, with ρ the distance from the ellipse along its normal (negative inside):

    I = q(u, v) + s(u, v) Φ(−ρ/σ) + a(θ) exp(−ρ²/2σ²)

q is a quadratic (skin and light), s a plane (the head's own brightness against the skin's, and its tilt to the light),
a the ring's amplitude, a periodic piecewise linear function of the angle (the camera and the projector see more of
the gap on one side than on the other), σ the half-width of gap and blur together. Everything is fitted jointly by
robust Gauss-Newton on the pixels themselves: no resampling, so the pixels' noise stays independent and the inverse of
the normal matrix is the covariance. Without the plane s the centre's error doubles: the step pulls the ridge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.rivets.ellipse import Ellipse, ellipse_of_shape
from metrology.rivets.ring_kernel import fit_ring_kernel


@dataclass(frozen=True)
class RingFit:
    """A fitted ring."""

    ellipse: Ellipse
    inverse: Array
    """(5,): u, v, A, B, C: the centre and the inverse shape matrix [[A, C], [C, B]] of the ellipse."""
    covariance: Array
    """(5, 5): of `inverse`."""
    sigma_px: float
    """Half-width σ of the ring's profile."""
    amplitude: float
    """Mean of a(θ), grey levels; negative for a dark ring."""
    step: float
    """Mean brightness of the inside against the outside, grey levels."""
    noise: float
    """Standard deviation of the residuals, grey levels."""
    score: float
    """Amplitude over its standard deviation."""
    coverage: float
    """Share of the ring's sectors in which it shows."""
    step_score: float
    """Step over its standard deviation."""
    inside_image: float
    """Share of the ring that lies on the image."""


def ellipse_of_inverse(u: float, v: float, A: float, B: float, C: float) -> Ellipse:
    """The ellipse A x² + 2 C x y + B y² = 1 about (u, v)."""
    determinant = A * B - C * C
    return ellipse_of_shape(u, v, [[B / determinant, -C / determinant], [-C / determinant, A / determinant]])


def fit_ring(
    image: NDArray[np.float32],
    start: Ellipse,
    sigma_px: float,
    limits: Array,
    shape: Array | None = None,
    shape_sd: float = 0.03,
    iterations: int = 11,
) -> RingFit | None:
    """Fit the ring model near a starting ellipse; None where there is none.

    Parameters
    ----------
    image, limits, iterations
        See `fit_ring_kernel`.
    sigma_px : float
        Half-width of gap and blur to start from.
    shape : (2, 2) ndarray
        The shape matrix Σ that the ellipse should have but for its size, where the surface tells; see `Ellipse.shape`.
    shape_sd : float
        Its relative standard deviation.
    """
    out, covariance, expected = np.zeros(13), np.zeros((5, 5)), np.zeros(3)
    if shape is not None:
        inverse = np.linalg.inv(shape)
        expected[:] = inverse[0, 0], inverse[1, 1], inverse[0, 1]
    sd = shape_sd if shape is not None else 0.0
    if not fit_ring_kernel(image, start.parameters, sigma_px, expected, sd, limits, iterations, out, covariance):
        return None
    if not (np.isfinite(out).all() and np.isfinite(covariance).all()):
        return None
    found = ellipse_of_inverse(out[0], out[1], out[2], out[3], out[4])
    # Blur moves the ridge of a curved line inwards by σ²/2r (the mean over a Gaussian of a circle's distance).
    shift = out[5] ** 2 / (2 * found.radius)
    scale = (found.radius / (found.radius + shift)) ** 2
    out[2:5] *= scale
    covariance[2:] *= scale
    covariance[:, 2:] *= scale
    return RingFit(
        ellipse=ellipse_of_inverse(out[0], out[1], out[2], out[3], out[4]),
        inverse=out[:5].copy(),
        covariance=covariance,
        sigma_px=out[5],
        amplitude=out[6],
        step=out[7],
        noise=out[8],
        score=out[9],
        coverage=out[10],
        step_score=out[11],
        inside_image=out[12],
    )

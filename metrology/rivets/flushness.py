"""Height, tilt and crown of a head's surface against the tangent plane of the skin's (paper §4.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array
from metrology.surfaces import Polynomial, monomials, tangent_rows


@dataclass(frozen=True)
class Flushness:
    """A head against the skin's tangent plane at the head's centre, mm and radians; deviations are standard ones."""

    mean: float
    low: float
    high: float
    """mean, low, high: mean, least and largest height of the head's surface over its full disc."""
    mean_sd: float
    tilt: float
    tilt_sd: float
    """tilt, tilt_sd: angle between the head's surface at its centre and the tangent plane."""
    crown: float
    """Height of the head's centre over its rim; 0 for a flat head."""


def flushness(
    head: Polynomial,
    skin: Polynomial,
    x: float,
    y: float,
    radius: float,
    height_inflation: float = 1.0,
    slope_inflation: float = 1.0,
) -> Flushness:
    """Evaluate two surfaces about a head's centre.

    Parameters
    ----------
    head, skin : Polynomial
        In the same frame.
    x, y, radius : float
        The head's disc, mm.
    height_inflation, slope_inflation : float
        By which the variances of heights and slopes exceed those of independent noise.

    Notes
    -----
    The tilt is the length of a slope of two noisy components, which noise alone makes longer: its square exceeds the
    true one by the components' variance. One component's variance is taken off (Wardle and Kronberg 1974).
    """
    (h1, a1, b1), head_covariance = head.tangent(x, y)
    (h0, a0, b0), skin_covariance = skin.tangent(x, y)
    covariance = head_covariance + skin_covariance
    stretch = 1 / np.sqrt(1 + a0**2 + b0**2)
    slope_covariance = covariance[1:, 1:] * slope_inflation
    slope = np.array([a1 - a0, b1 - b0])
    length = float(np.linalg.norm(slope))
    direction = slope / length if length > 0 else np.array([1.0, 0.0])
    slope_sd = float(np.sqrt(direction @ slope_covariance @ direction))
    true_length = float(np.sqrt(max(length**2 - 0.5 * np.trace(slope_covariance), 0.0)))
    crown = _crown(head.coefficients, radius)
    over_disc = monomials(x, y, head.order)
    over_disc[3:6:2] += 0.25 * radius**2
    mean_variance = float(over_disc @ head.covariance @ over_disc) + skin_covariance[0, 0]
    r, t = np.meshgrid(np.linspace(0, 1, 9), np.arange(48) * (2 * np.pi / 48))
    along = true_length * radius * r * np.cos(t)
    surface = float(h1 - h0) + along - crown * r**2
    return Flushness(
        mean=mean_height(head.coefficients, skin.coefficients, x, y, radius),
        low=float(surface.min()) * stretch,
        high=float(surface.max()) * stretch,
        mean_sd=float(np.sqrt(mean_variance * height_inflation)),
        tilt=float(np.arctan(true_length)),
        tilt_sd=slope_sd,
        crown=crown * stretch,
    )


def mean_height(head: Array, skin: Array, x: float, y: float, radius: float) -> float:
    """Mean height of a head's disc over the skin's tangent plane at its centre, mm.

    Parameters
    ----------
    head, skin : (k,) array
        Coefficients of `monomials`.
    x, y, radius : float
        The head's disc, mm.
    """
    (h1, _, _), (h0, a0, b0) = (tangent_rows(x, y, 1 if len(c) == 3 else 2) @ c for c in (head, skin))
    # Over the disc a plane's mean is its centre's height; a dome's lies half the crown below the centre.
    return (float(h1 - h0) - 0.5 * _crown(head, radius)) * float(1 / np.sqrt(1 + a0**2 + b0**2))


def _crown(head: Array, radius: float) -> float:
    """Height of a head's centre over its rim, along the frame's normal; 0 for a plane."""
    return 0.0 if len(head) == 3 else -0.5 * float(head[3] + head[5]) * radius**2

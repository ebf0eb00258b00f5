"""How flat a part of a cloud is that is known to be a plane: what a capture without truth tells about itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrology.surfaces import Frame, fit_surface

_RANGE = (0.005, 0.995)  # the range leaves out half a percent at either end, or single bad points would be all it tells


@dataclass(frozen=True)
class Flatness:
    """Departures of points from their plane."""

    n: int
    """Points, outliers included."""
    rms_mm: float
    """Standard deviation of the residuals from the plane, outliers left out."""
    range_mm: float
    """Between the 0.5 % and the 99.5 % quantile of all residuals."""
    bow_mm: float
    """How far a quadric through the points departs from the plane, largest less smallest value."""
    noise_ratio: float
    """Residuals from the quadric over their propagated standard deviation; 1 where that is right."""
    residuals_mm: NDArray[np.float64]
    """(n,): distances from the plane, + towards the rig."""


def flatness(points: ArrayLike, sigma_z: ArrayLike, generator: np.random.Generator) -> Flatness | None:
    """Fit a plane and a quadric to points; None where there are too few or they lie on a line.

    Parameters
    ----------
    points : (n, 3) array
        Rig frame, mm.
    sigma_z : (n,) array
        Standard deviation of the points' depth, mm.
    generator : numpy.random.Generator
        Draws the RANSAC samples.
    """
    p = np.asarray(points, float)
    if len(p) < 3:
        return None
    middle = p.mean(axis=0)
    frame = Frame.on_plane(middle, np.linalg.svd(p - middle, full_matrices=False)[2][2])
    x, y, h = frame.local(p).T
    sigma = frame.height_sigma(p, sigma_z)
    plane = fit_surface(x, y, h, sigma, 1, generator)
    quadric = fit_surface(x, y, h, sigma, 2, generator)
    if plane is None or quadric is None:
        return None
    # Heights over the frame are distances to the plane but for its slope.
    steepness = np.sqrt(1 + np.sum(plane.coefficients[1:] ** 2))
    residuals = (h - plane.height(x, y)) / steepness
    bow = (quadric.height(x, y) - plane.height(x, y)) / steepness
    low, high = np.quantile(residuals, _RANGE)
    return Flatness(
        n=len(p),
        rms_mm=float(np.sqrt(np.mean(residuals[plane.weights > 0] ** 2))),
        range_mm=float(high - low),
        bow_mm=float(np.ptp(bow)),
        noise_ratio=quadric.chi,
        residuals_mm=residuals,
    )

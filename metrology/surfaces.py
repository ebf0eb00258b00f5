"""Planes and quadrics through patches of an organised cloud: RANSAC, then weighted least squares with covariance.

A patch is described in a frame of its own, x and y along the surface and h along its normal towards the rig, so that a
surface is a polynomial h(x, y). A point of the cloud errs along its viewing ray; what the fit sees of that is the part
along the normal, σ_h = σ_z |(x/z, y/z, 1) · n|.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrology.arrays import Array
from metrology.robust import TUKEY_COVARIANCE, TUKEY_VARIANCE, reweighted

_JUDGES = 1000  # points on which RANSAC compares samples
_ENOUGH = 1500  # points for all but the last steps


@dataclass(frozen=True)
class Frame:
    """A right-handed frame on a surface."""

    origin: Array
    """(3,): rig frame, mm."""
    axes: Array
    """(3, 3): rows: along the surface, along the surface, normal towards the rig (negative z)."""

    @classmethod
    def on_plane(cls, origin: ArrayLike, normal: ArrayLike) -> Frame:
        """Frame with the given normal, turned towards the rig; its first axis lies in the rig's x-z plane."""
        x, y, z = (float(component) for component in np.asarray(normal))
        length = math.sqrt(x * x + y * y + z * z) * (-1.0 if z > 0 else 1.0)
        x, y, z = x / length, y / length, z / length
        across = math.hypot(x, z)
        u, w = (-z / across, x / across) if across > 1e-6 else (1.0, 0.0)
        # first = (u, 0, w), second = normal × first
        return cls(np.asarray(origin, float), np.array([[u, 0.0, w], [y * w, z * u - x * w, -y * u], [x, y, z]]))

    def local(self, points: ArrayLike) -> Array:
        """(…, 3) x, y, h of points."""
        return np.asarray((np.asarray(points, float) - self.origin) @ self.axes.T)

    def rig(self, local: ArrayLike) -> Array:
        """(…, 3) points in the rig frame of x, y, h."""
        return np.asarray(np.asarray(local, float) @ self.axes + self.origin)

    def height_sigma(self, points: ArrayLike, sigma_z: ArrayLike) -> Array:
        """(n,) σ_h of points whose z has the standard deviation `sigma_z`."""
        p = np.asarray(points, float)
        return np.asarray(np.abs((p / p[..., 2:]) @ self.axes[2]) * np.asarray(sigma_z, float))


def monomials(x: ArrayLike, y: ArrayLike, order: int) -> Array:
    """(n, k) 1, x, y, x², xy, y², … up to the given order."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    return np.stack([x ** (d - i) * y**i for d in range(order + 1) for i in range(d + 1)], axis=-1)


@dataclass(frozen=True)
class Polynomial:
    """A fitted surface h(x, y)."""

    order: int
    """1 plane, 2 quadric."""
    coefficients: Array
    """(k,): of `monomials`."""
    covariance: Array
    """(k, k): for independent noise of the size that the residuals show."""
    rms_mm: float
    """Standard deviation of the residuals, robust."""
    chi: float
    """Residuals over their expected standard deviation, robust; 1 where σ is right."""
    weights: Array
    """(n,): robust weight of each point given, 0 for outliers."""

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """h at x, y."""
        return np.asarray(monomials(x, y, self.order) @ self.coefficients)

    def tangent(self, x: float, y: float) -> tuple[Array, Array]:
        """(h, ∂h/∂x, ∂h/∂y) at a point and its covariance (3, 3)."""
        rows = tangent_rows(x, y, self.order)
        return rows @ self.coefficients, rows @ self.covariance @ rows.T


def tangent_rows(x: float, y: float, order: int) -> Array:
    """(3, k) monomials and their derivatives by x and y at a point."""
    value, by_x, by_y = [], [], []
    for d in range(order + 1):
        for i in range(d + 1):
            p, q = d - i, i
            value.append(x**p * y**q)
            by_x.append(p * x ** max(p - 1, 0) * y**q)
            by_y.append(q * x**p * y ** max(q - 1, 0))
    return np.array([value, by_x, by_y], float)


def fit_surface(
    x: ArrayLike,
    y: ArrayLike,
    h: ArrayLike,
    sigma: ArrayLike,
    order: int,
    generator: np.random.Generator,
    trials: int = 60,
    scale: float | None = None,
) -> Polynomial | None:
    """Polynomial through a patch: RANSAC (paper §4.1) finds the surface most points share, least squares refines it.

    The refinement is iteratively reweighted with weights σ⁻² times Tukey's.

    Parameters
    ----------
    x, y, h : (n,) array
        Local coordinates, mm.
    sigma : (n,) array
        Standard deviation of h, mm.
    order : int
        1 plane, 2 quadric, up to 4.
    generator : numpy.random.Generator
        Draws the samples.
    trials : int
        RANSAC samples.
    scale : float, optional
        Standard deviation of the points' noise over `sigma` where it is known; else taken from the residuals, which
        holds only while more than half of the points are good.

    Returns
    -------
    Polynomial or None
        None where there are fewer than three points per coefficient or they lie on a line.
    """
    x, y, h, sigma = (np.asarray(a, float).ravel() for a in (x, y, h, sigma))
    unknowns = (order + 1) * (order + 2) // 2
    if len(x) < 3 * unknowns:
        return None
    size = float(np.sqrt(np.mean((x - x.mean()) ** 2 + (y - y.mean()) ** 2))) or 1.0
    design = monomials(x / size, y / size, order) / sigma[:, None]
    target = h / sigma
    start = _consensus(design, target, unknowns, generator, trials)
    if start is None:
        return None
    # Most of the way on a part of the points, the last steps on all.
    part = slice(None, None, max(1, len(x) // _ENOUGH))
    near = reweighted(design[part], target[part], start, 8, scale)
    last = near and reweighted(design, target, near.values, 3, scale)
    if last is None:
        return None
    solution, weights = last.values, last.weights
    residual = target - design @ solution
    chi2 = float((weights * residual**2).sum() / max(weights.sum() - unknowns, 1.0)) * TUKEY_VARIANCE
    back = np.concatenate([np.full(d + 1, size**-d) for d in range(order + 1)])
    covariance = np.asarray(np.linalg.inv(last.normal), float) * chi2 * TUKEY_COVARIANCE
    real = (h - (design * sigma[:, None]) @ solution)[weights > 0]
    return Polynomial(
        order=order,
        coefficients=solution * back,
        covariance=covariance * np.outer(back, back),
        rms_mm=float(np.sqrt(np.mean(real**2))),
        chi=float(np.sqrt(chi2)),
        weights=weights,
    )


def _consensus(
    design: Array, target: Array, unknowns: int, generator: np.random.Generator, trials: int
) -> Array | None:
    """Coefficients of the sample with the smallest truncated squares (MSAC), points scaled to unit noise."""
    n = len(target)
    # Which sample is best shows on a part of the points; which points are best, on all of them later.
    judges = slice(None) if n <= _JUDGES else generator.integers(n, size=_JUDGES)
    # Now and then a point is drawn twice; such a sample is singular and drops out below.
    picks = generator.integers(n, size=(trials, unknowns))
    matrices, values = design[picks], target[picks]
    sizes = np.abs(np.linalg.det(matrices / np.linalg.norm(matrices, axis=2, keepdims=True)))
    good = sizes > 1e-6 * sizes.max() if sizes.max() > 0 else np.zeros(trials, bool)
    if not good.any():
        return None
    solutions = np.linalg.solve(matrices[good], values[good][..., None])[..., 0]
    residual2 = (target[judges, None] - design[judges] @ solutions.T) ** 2
    cost = np.minimum(residual2, 3.0**2).sum(axis=0)
    return np.asarray(solutions[int(cost.argmin())])

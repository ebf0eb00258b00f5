"""Ellipses in the image: their conics, and the circles in space that they are images of."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrology.arrays import Array


@dataclass(frozen=True)
class Ellipse:
    """An ellipse in pixels."""

    u: float
    v: float
    """u, v: centre."""
    a: float
    b: float
    """a, b: semi-axes, a ≥ b."""
    angle: float
    """Direction of the major axis from +u towards +v, radians in [0, π)."""

    @classmethod
    def of(cls, parameters: ArrayLike) -> Ellipse:
        """The ellipse of (u, v, semi-axis, semi-axis, angle) with the axes in either order."""
        u, v, a, b, angle = np.asarray(parameters, float)
        if b > a:
            a, b, angle = b, a, angle + np.pi / 2
        return cls(float(u), float(v), float(a), float(b), float(angle % np.pi))

    @property
    def parameters(self) -> Array:
        """(5,) u, v, a, b, angle."""
        return np.array([self.u, self.v, self.a, self.b, self.angle])

    @property
    def radius(self) -> float:
        """Geometric mean of the semi-axes, pixels."""
        return math.sqrt(self.a * self.b)

    @property
    def shape(self) -> Array:
        """(2, 2) matrix Σ with (p − c)ᵀ Σ⁻¹ (p − c) = 1 on the ellipse."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        axes = np.array([[c, -s], [s, c]]) * [self.a, self.b]
        return np.asarray(axes @ axes.T)

    def points(self, n: int) -> Array:
        """(n, 2) points at equal steps of the eccentric angle."""
        t = np.arange(n) * (2 * np.pi / n)
        c, s = np.cos(self.angle), np.sin(self.angle)
        x, y = self.a * np.cos(t), self.b * np.sin(t)
        return np.stack([self.u + c * x - s * y, self.v + s * x + c * y], axis=1)

    def level(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Radius relative to the ellipse's own in the same direction: 0 at the centre, 1 on the ellipse."""
        du, dv = np.asarray(u, float) - self.u, np.asarray(v, float) - self.v
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.asarray(np.hypot((c * du + s * dv) / self.a, (c * dv - s * du) / self.b))

    def meets(self, other: Ellipse) -> bool:
        """Whether two ellipses are nearer than their lesser semi-axes together."""
        return math.hypot(self.u - other.u, self.v - other.v) < self.b + other.b


def ellipse_of_shape(u: float, v: float, shape: ArrayLike) -> Ellipse:
    """The ellipse about (u, v) whose matrix Σ (see `Ellipse.shape`) is given."""
    (uu, uv), (_, vv) = np.asarray(shape, float).tolist()
    middle, half = 0.5 * (uu + vv), math.hypot(0.5 * (uu - vv), uv)
    angle = 0.5 * math.atan2(2 * uv, uu - vv)
    return Ellipse(float(u), float(v), math.sqrt(middle + half), math.sqrt(middle - half), angle % math.pi)

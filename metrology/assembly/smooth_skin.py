"""The smooth skin of a part of a panel: a surface z(x, y) over the panel's frame that follows no dent and no step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from metrology.arrays import Array
from metrology.robust import MAD, TUKEY, tukey

_KNOTS_MM = 150.0  # half a field: what bends over less is deviation
_DEGREE = 3
_STIFF = 1e-4  # weight of third differences, so that empty places are bridged by quadrics
_FEW = 1e-6
_ROUNDS = 5
_LEAST_MM = 0.005  # scatter of a skin's points


@dataclass(frozen=True)
class SmoothSkin:
    """A tensor product of cubic splines."""

    knots: tuple[Array, Array]
    """(x, y): of the two directions, mm."""
    coefficients: Array
    """(nx, ny)."""

    @classmethod
    def fitted(cls, points: Array) -> SmoothSkin:
        """Through points (n, 3) of the panel's frame, whatever stands out of them."""
        knots = _knots(points[:, 0]), _knots(points[:, 1])
        bx, by = (_basis(points[:, k], knots[k]) for k in (0, 1))
        rows = (bx[:, :, None] * by[:, None, :]).reshape(len(points), -1)
        stiffness = _stiffness(bx.shape[1], by.shape[1]) * _STIFF * len(points) / rows.shape[1]
        z, solution = points[:, 2], np.zeros(rows.shape[1])
        weights: Array = np.ones(len(points))
        for _ in range(_ROUNDS):
            weighted = rows * weights[:, None]
            solution = np.asarray(np.linalg.solve(weighted.T @ rows + stiffness, weighted.T @ z), float)
            off = z - rows @ solution
            weights = tukey(off / (TUKEY * max(MAD * float(np.median(np.abs(off))), _LEAST_MM)))
        return cls(knots, solution.reshape(bx.shape[1], by.shape[1]))

    def on_grid(self, x: Array, y: Array) -> Array:
        """(ny, nx) heights over a grid, mm."""
        return np.asarray(_basis(y, self.knots[1]) @ self.coefficients.T @ _basis(x, self.knots[0]).T)


def _knots(values: Array) -> Array:
    """Evenly spaced over the values, and as many beyond as cubic splines need."""
    low, high = float(values.min()), float(values.max())
    pieces = max(1, round((high - low) / _KNOTS_MM))
    spacing = max(high - low, 1.0) / pieces
    return np.asarray(low + spacing * np.arange(-_DEGREE, pieces + _DEGREE + 1), float)


def _basis(values: Array, knots: Array) -> Array:
    """(n, k) the splines' values; beyond the ends those at the ends."""
    inside = np.clip(values, knots[_DEGREE], knots[-_DEGREE - 1])
    return np.asarray(BSpline.design_matrix(inside, knots, _DEGREE).toarray())


def _stiffness(nx: int, ny: int) -> Array:
    """(nx ny, nx ny) squares of the third differences along both directions, which quadrics have none of."""
    along = [np.diff(np.eye(n), 3, axis=0) for n in (nx, ny)]
    squares = [d.T @ d for d in along]
    a_little = _FEW * np.eye(nx * ny)  # few points tell no surface
    return np.asarray(np.kron(squares[0], np.eye(ny)) + np.kron(np.eye(nx), squares[1]) + a_little)

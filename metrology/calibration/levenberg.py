"""Levenberg-Marquardt on normal equations, with Huber's loss.

The adjustment has thousands of residuals and a hundred parameters: its normal equations are a small, well scaled
matrix, where the singular value decompositions of general solvers cost ten times as much.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from metrology.arrays import Array
from metrology.errors import CalibrationError

_FIRST_DAMPING = 1e-4
_LEAST_DAMPING, _MOST_DAMPING = 1e-12, 1e12
_CONVERGED = 1e-9  # part of the cost that a step still gains
_MAX_STEPS = 200


def minimise(
    residuals: Callable[[Array], Array], jacobian: Callable[[Array], Array], start: Array, robust_at: float | None
) -> Array:
    """Parameters (p,) with the least sum of squares, or of Huber's loss.

    Parameters
    ----------
    residuals, jacobian : callable
        Parameters to whitened residuals (n,), infinite where those are impossible, and their derivatives (n, p).
    start : (p,) array
    robust_at : float or None
        Where Huber's loss turns from r² to 2 k |r| − k²; None for plain squares.
    """
    x, r = start, residuals(start)
    cost, damping = _cost(r, robust_at), _FIRST_DAMPING
    if not np.isfinite(cost):
        raise CalibrationError("found start values from which no board can be seen, expected views that agree")
    for _ in range(_MAX_STEPS):
        weight = np.ones_like(r) if robust_at is None else robust_at / np.maximum(np.abs(r), robust_at)
        J = jacobian(x) * np.sqrt(weight)[:, None]
        size = np.linalg.norm(J, axis=0)
        size[size == 0] = 1.0
        J /= size
        normal, gradient = J.T @ J, J.T @ (r * np.sqrt(weight))
        while damping < _MOST_DAMPING:
            step = cho_solve(cho_factor(normal + damping * np.eye(len(x))), gradient) / size
            tried = residuals(x - step)
            tried_cost = _cost(tried, robust_at)
            if tried_cost <= cost:
                break
            damping *= 10
        else:
            return x  # no step downhill is left: rounding
        gained, x, r, cost = cost - tried_cost, x - step, tried, tried_cost
        damping = max(damping / 10, _LEAST_DAMPING)
        if gained <= _CONVERGED * cost:
            return x
    raise CalibrationError(f"the adjustment did not settle in {_MAX_STEPS} steps, expected views that agree")


def _cost(r: Array, robust_at: float | None) -> float:
    if robust_at is None:
        return float(r @ r)
    size = np.abs(r)
    if not np.isfinite(size).all():
        return np.inf
    return float(np.sum(np.where(size <= robust_at, size**2, 2 * robust_at * size - robust_at**2)))

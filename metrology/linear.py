"""Small linear systems, compiled."""

from __future__ import annotations

import math

from metrology.jit import kernel

_SINGULAR = 1e-12  # least pivot of a matrix scaled to unit diagonal


@kernel
def factor(matrix, size):  # type: ignore[no-untyped-def]
    """Cholesky factor of the leading block, in place in the lower triangle; False where it is not positive definite."""
    for j in range(size):
        for k in range(j + 1):
            total = matrix[j, k]
            for m in range(k):
                total -= matrix[j, m] * matrix[k, m]
            if j == k:
                if total <= _SINGULAR:
                    return False
                matrix[j, j] = math.sqrt(total)
            else:
                matrix[j, k] = total / matrix[k, k]
    return True


@kernel
def substitute(matrix, size, x):  # type: ignore[no-untyped-def]
    """Solve L Lᵀ x = b in place, given the factor."""
    for j in range(size):
        for k in range(j):
            x[j] -= matrix[j, k] * x[k]
        x[j] /= matrix[j, j]
    for j in range(size - 1, -1, -1):
        for k in range(j + 1, size):
            x[j] -= matrix[k, j] * x[k]
        x[j] /= matrix[j, j]

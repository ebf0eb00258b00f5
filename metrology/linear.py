"""Small linear systems, and copying, compiled."""

from __future__ import annotations

import math

from metrology.jit import kernel

_SINGULAR = 1e-12  # least pivot, as a share of the diagonal's entry


@kernel
def copy_values(target, source):  # type: ignore[no-untyped-def]
    """Fill an array with another of its shape.

    A slice assignment would do, but numba compiles the message of shapes that differ with it, which takes seconds.
    """
    to, values = target.reshape(-1), source.reshape(-1)
    for i in range(values.size):
        to[i] = values[i]


@kernel
def factor(matrix, size):  # type: ignore[no-untyped-def]
    """Cholesky factor of the leading block, in place in the lower triangle; False where it is not positive definite."""
    for j in range(size):
        for k in range(j + 1):
            total = matrix[j, k]
            for m in range(k):
                total -= matrix[j, m] * matrix[k, m]
            if j == k:
                if not total > _SINGULAR * (_SINGULAR + matrix[j, j]):
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


@kernel
def solve(matrix, x, size):  # type: ignore[no-untyped-def]
    """Solve A x = b in place by Cholesky, given the lower triangle; False where it is not positive definite."""
    if not factor(matrix, size):
        return False
    substitute(matrix, size, x)
    return True

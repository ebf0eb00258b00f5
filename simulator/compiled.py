"""How the simulator's kernels are compiled: inner ones into those that Python calls, which alone are cached on disk."""

from __future__ import annotations

from typing import Any

from numba import njit

from metrology.kernel_cache import keep

# IEEE arithmetic in the order written. No kernel allocates: without numba's runtime arrays are passed without counting
# references, which otherwise takes more time than the geometry.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}


def kernel(function: Any) -> Any:
    """An inner kernel."""
    return njit(**_OPTIONS)(function)


def entry(function: Any) -> Any:
    """A kernel that Python calls, kept on disk."""
    return keep(njit(**_OPTIONS)(function))

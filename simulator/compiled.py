"""How the simulator's kernels are compiled.

Inner kernels are compiled into the few that Python calls, and only those are cached on disk. Numba's cache notices a
change of the file a kernel stands in, not of the kernels it calls from other files; it does take a closure's values
into its key, so an entry kernel is built with the fingerprint of the files it draws from.
"""

from __future__ import annotations

from hashlib import blake2b
from pathlib import Path
from types import ModuleType
from typing import Any

from numba import njit

from metrology.jit import cached

# IEEE arithmetic in the order written. No kernel allocates: without numba's runtime arrays are passed without counting
# references, which otherwise takes more time than the geometry.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}


def kernel(function: Any) -> Any:
    """An inner kernel."""
    return njit(**_OPTIONS)(function)


def entry(function: Any) -> Any:
    """A kernel that Python calls, cached on disk."""
    return cached(njit(cache=True, **_OPTIONS), function)


def fingerprint(*modules: ModuleType) -> int:
    """A number that changes with the source of any of these modules."""
    digest = blake2b(digest_size=7)
    for module in modules:
        digest.update(Path(str(module.__file__)).read_bytes())
    return int.from_bytes(digest.digest())

"""How kernels are compiled, and how rows are shared among threads.

Kernels release the interpreter lock and run over bands of rows, so plain threads share the work: no threading layer of
numba's is involved (its default one must not be entered by two threads at once), and compiling takes a fraction of the
time that ``parallel=True`` takes. A cached kernel does not notice when a kernel that it calls changes: kernels that
call each other stay in one file.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba

# NaN marks missing values throughout, so "nnan" and "ninf" stay off.
_FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}
# Bands small enough to even out, large enough that a band's start costs nothing.
_ROWS_PER_BAND = 48


def kernel(function: Callable[..., Any]) -> Any:
    """Compile `function`: cached on disk, without the interpreter lock, IEEE division, relaxed summation order."""
    return numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")(function)


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def over_rows(function: Callable[[int, int], None], height: int, threads: int | None = None) -> None:
    """Call ``function(first_row, end_row)`` for bands that cover `height` rows, on several threads."""
    bands = [(first, min(first + _ROWS_PER_BAND, height)) for first in range(0, height, _ROWS_PER_BAND)]
    workers = min(threads or cores(), len(bands))
    if workers <= 1:
        for band in bands:
            function(*band)
        return
    # The first band compiles or loads the kernel before others need it.
    function(*bands[0])
    with ThreadPoolExecutor(workers) as pool:
        for future in [pool.submit(function, *band) for band in bands[1:]]:
            future.result()

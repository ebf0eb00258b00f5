"""How kernels are compiled, and how rows are shared among threads.

Kernels release the interpreter lock and run over bands of rows, so plain threads share the work: no threading layer of
numba's is involved (its default one must not be entered by two threads at once), and compiling takes a fraction of the
time that ``parallel=True`` takes.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba
from llvmlite.binding import parse_bitcode
from numba.core.codegen import CPUCodeLibrary

from metrology.kernel_cache import keep

# NaN marks missing values throughout, so "nnan" and "ninf" stay off.
_FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}
# Bands small enough to even out, large enough that a band's start costs nothing.
_ROWS_PER_BAND = 48


def _with_copies_of_its_own(optimize: Callable[[Any], None]) -> Callable[[Any], None]:
    """Let a kernel use its own copies of the kernels that it calls, and nobody else's.

    A copy is optimized where it stands, so its sums are in another order than the kernel's own. By numba's way
    all copies bear one name, and a process takes the first one that it meets: results would depend on what was compiled
    or loaded before. Copies are made of what a kernel is before it is optimized: optimized ones, each with its own
    copies in it, would be gone through again at every call above them, a sixth of the time of compiling.
    """

    def optimize_own(library: Any) -> None:
        library._shared_module = library._final_module.clone()
        for function in library._shared_module.functions:
            if function.linkage.name == "external" and not function.is_declaration:
                function.linkage = "linkonce_odr"
        for function in library._final_module.functions:
            if function.linkage.name == "linkonce_odr" and not function.is_declaration:
                function.linkage = "internal"
        optimize(library)

    return optimize_own


def _with_names(serialize: Callable[[Any], tuple[str, str, Any]]) -> Callable[[Any], tuple[str, str, Any]]:
    """Let the names of what a kernel's code defines lie on disk beside it."""

    def serialize_with_names(library: Any) -> tuple[str, str, Any]:
        name, kind, (code, bitcode) = serialize(library)
        module = library._get_module_for_linking()
        symbols = [*module.functions, *module.global_variables]
        return name, kind, (code, bitcode, [symbol.name for symbol in symbols if not symbol.is_declaration])

    return serialize_with_names


def _without_bitcode(unserialize: Callable[[Any, Any], Any]) -> Callable[[Any, Any, tuple[str, str, Any]], Any]:
    """Let a kernel's code come from disk alone.

    Beside it lies bitcode, from which a kernel that calls it is compiled. Numba reads that at once, for the names in
    it alone: half the time that loading takes, and memory for as long as the process lives.
    """

    def loaded(_class: type, codegen: Any, state: tuple[str, str, Any]) -> Any:
        name, _, data = state
        if len(data) != 3:  # another package's, saved where this module was not loaded
            return unserialize(codegen, state)
        library = codegen.create_library(name)
        library.enable_object_caching()
        library._set_compiled_object(data[0])
        library._finalize_final_module()
        codegen._engine._defined_symbols.update(data[2])
        library._bitcode = data[1]
        return library

    return loaded


def _with_bitcode_read_late(module_for_linking: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Let a kernel that was loaded be read anew where another one that calls it is compiled."""

    def module_read_late(library: Any) -> Any:
        if library._shared_module is None and hasattr(library, "_bitcode"):
            library._shared_module = parse_bitcode(library._bitcode)
        return module_for_linking(library)

    return module_read_late


CPUCodeLibrary._optimize_final_module = _with_copies_of_its_own(CPUCodeLibrary._optimize_final_module)
CPUCodeLibrary.serialize_using_object_code = _with_names(CPUCodeLibrary.serialize_using_object_code)
CPUCodeLibrary._unserialize = classmethod(_without_bitcode(CPUCodeLibrary._unserialize))
CPUCodeLibrary._get_module_for_linking = _with_bitcode_read_late(CPUCodeLibrary._get_module_for_linking)


def kernel(function: Callable[..., Any]) -> Any:
    """Compile `function`: kept on disk, without the interpreter lock, IEEE division, relaxed summation order."""
    return keep(numba.njit(nogil=True, fastmath=_FAST, error_model="numpy", no_cfunc_wrapper=True)(function))


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

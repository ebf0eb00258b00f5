"""How kernels are compiled, and how rows are shared among threads.

Kernels release the interpreter lock and run over bands of rows, so plain threads share the work: no threading layer of
numba's is involved (its default one must not be entered by two threads at once), and compiling takes a fraction of the
time that ``parallel=True`` takes. A kernel's code on disk is good as long as its own file and all that it takes from
others by name stay as they are: kernels and constants.
"""

from __future__ import annotations

import contextlib
import fcntl
import gc
import os
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from hashlib import blake2b
from types import CodeType
from typing import Any

import numba
import numpy
from llvmlite.binding import parse_bitcode
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler_lock import global_compiler_lock

# NaN marks missing values throughout, so "nnan" and "ninf" stay off.
_FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}
# Bands small enough to even out, large enough that a band's start costs nothing.
_ROWS_PER_BAND = 48
_FORM = "copies of its own as written, and names"  # of the code on disk: of another form it is compiled again


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
    """Compile `function`: cached on disk, without the interpreter lock, IEEE division, relaxed summation order."""
    compiler = numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy", no_cfunc_wrapper=True)
    return cached(compiler, function)


def cached(compiler: Callable[..., Any], function: Callable[..., Any]) -> Any:
    """Let a compiler with a cache on disk compile `function`.

    Numba keeps kernels beside the program, else in the home folder. A service's user may be allowed to write to
    neither: kernels then go into a folder of this user's under the system's folder for temporary files.
    """
    try:
        return _compiled_in_turn(_stamped(compiler(function)))
    except RuntimeError as problem:
        if "cannot cache" not in str(problem):
            raise
    folder = _temporary_cache()
    print(
        f"kernels are compiled into {folder}: neither the program's nor the home folder can be written; "
        "NUMBA_CACHE_DIR names a lasting one",
        file=sys.stderr,
    )
    # Processes that are started from here find it, and need not say it again.
    os.environ["NUMBA_CACHE_DIR"] = folder
    numba.config.CACHE_DIR = folder
    return _compiled_in_turn(_stamped(compiler(function)))


def _stamped(dispatcher: Any) -> Any:
    """Let code on disk go out of date with the kernels that it calls and the constants that it holds.

    Numba compares the stamp of the kernel's own file alone; what other files lend is compiled into the kernel.
    """
    file, function = _cache_file(dispatcher), getattr(dispatcher, "py_func", None)
    if file is None or function is None:
        return dispatcher
    file._source_stamp = (file._source_stamp, _lent(function), _FORM)
    return dispatcher


def _lent(function: Any) -> str:
    """What changes with the kernels and constants that a function takes from elsewhere by name."""
    lent = {name: _stamp(function.__globals__.get(name)) for name in sorted(_names(function.__code__))}
    return blake2b(repr([(name, stamp) for name, stamp in lent.items() if stamp]).encode(), digest_size=8).hexdigest()


def _cache_file(dispatcher: Any) -> Any:
    """Numba's index of a kernel's code on disk."""
    return getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)


def is_compiled(dispatcher: Any) -> bool:
    """Whether code of a kernel lies on disk that is good for its present source, or it is never compiled."""
    file = _cache_file(dispatcher)
    return file is None or bool(file._load_index())


def _names(code: CodeType) -> set[str]:
    """Names that a function and those inside it look up."""
    inner = [_names(value) for value in code.co_consts if isinstance(value, CodeType)]
    return set(code.co_names).union(*inner)


def _stamp(value: Any) -> str | None:
    """What changes with a kernel or a constant; None for anything else."""
    if isinstance(value, bool | int | float | str | tuple | frozenset):
        return repr(value)
    if isinstance(value, numpy.ndarray):
        return blake2b(value.tobytes(), digest_size=8).hexdigest()
    if file := _cache_file(value):
        return repr(file._source_stamp)
    if isinstance(value, numba.core.dispatcher.Dispatcher):  # compiled into its callers alone
        return repr((_code(value.py_func.__code__), _lent(value.py_func)))
    return None


def _code(code: CodeType) -> tuple[Any, ...]:
    """What a function does, wherever it stands."""
    constants = [_code(value) if isinstance(value, CodeType) else value for value in code.co_consts]
    return code.co_code, code.co_names, code.co_varnames, constants


def _compiled_in_turn(dispatcher: Any) -> Any:
    """Let processes that need a kernel at the same time compile it once: the others wait, and load what was saved.

    Nor must two save at once: numba reads the kernel's index, chooses the next file name and writes both, and one
    type's code would be taken for the other's.
    """
    file = _cache_file(dispatcher)
    if file is None:
        return dispatcher
    compile_ = dispatcher.compile

    def compile_in_turn(signature: Any) -> Any:
        # Numba's own lock first, as it takes it anyway: of a process's threads one at a time then waits for a file.
        with global_compiler_lock, _turn(f"{file._index_path}.lock"), _without_collecting():
            return compile_(signature)

    dispatcher.compile = compile_in_turn
    return dispatcher


@contextlib.contextmanager
def _turn(path: str) -> Iterator[None]:
    """Wait for other processes to let go of a file; where a file cannot be locked, nobody waits."""
    with contextlib.ExitStack() as held:
        with contextlib.suppress(OSError):  # a folder that cannot be written, a network file system without locks
            # This process's own: one that is forked meanwhile does not hold it on.
            fcntl.lockf(held.enter_context(open(path, "ab")), fcntl.LOCK_EX)
        yield


@contextlib.contextmanager
def _without_collecting() -> Iterator[None]:
    """Keep Python from looking for garbage: it takes a fifth of the time of compiling, and finds little."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def _temporary_cache() -> str:
    """A folder that is this user's alone, as cached kernels are code: the same one each time, or else a new one."""
    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = os.path.join(tempfile.gettempdir(), f"flushline-kernels-{user}")
    try:
        os.mkdir(folder, 0o700)
    except FileExistsError:
        status = os.lstat(folder)
        private = stat.S_ISDIR(status.st_mode) and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
        if not private or status.st_uid != user:
            return tempfile.mkdtemp(prefix="flushline-kernels-")
    return folder


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

"""Where compiled kernels are kept: in this user's folder for caches, by all that they were compiled from.

A newer version of the program, a second clone and another environment so find every kernel that is the same in them,
and versions that are used in turns do not overwrite each other's. What nothing has used for a quarter of a year goes.
"""

from __future__ import annotations

import contextlib
import fcntl
import gc
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import cache, partial
from hashlib import blake2b
from pathlib import Path
from types import CodeType
from typing import Any

import numba
import numpy
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.compiler_lock import global_compiler_lock
from numba.misc.appdirs import AppDirs

_FORM = "copies of its own as written, and names"  # of the code on disk: of another form it is compiled again
_UNUSED_DAYS = 90.0
_TOUCHED_DAYS = 1.0  # no more often is noted that a kernel is in use
_DAY = 86400.0


class _Kept:
    """Where one kernel's code lies on disk (a locator of numba's).

    It is good as long as the kernel's own file and all that it takes from others by name stay as they are: kernels and
    constants.
    """

    def __init__(self, function: Callable[..., Any], file: str, options: str) -> None:
        state = os.stat(file)
        parts = _source(file, state.st_mtime_ns, state.st_size), _lent(function), options, _FORM, numba.__version__
        self._stamp = blake2b(repr(parts).encode(), digest_size=16).hexdigest()
        self._line = function.__code__.co_firstlineno
        name = f"{function.__module__}.{function.__qualname__}".replace("<", "").replace(">", "")
        self.folder = os.path.join(_home(numba.config.CACHE_DIR), name, self._stamp)
        _note_use(self.folder)

    def get_cache_path(self) -> str:
        return self.folder

    def ensure_cache_path(self) -> None:
        os.makedirs(self.folder, exist_ok=True)

    def get_source_stamp(self) -> str:
        return self._stamp

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Place:
    """Stands where numba has a class of locators."""

    def __init__(self, options: str) -> None:
        self._options = options

    def from_function(self, function: Callable[..., Any], file: str) -> _Kept:
        return _Kept(function, file, self._options)


class _Implementation(CompileResultCacheImpl):
    def __init__(self, options: str, function: Callable[..., Any]) -> None:
        self._locator_classes = (_Place(options),)
        super().__init__(function)


class _Cache(FunctionCache):
    """Code on disk that never stands in the way: what cannot be read is compiled again, and not all must be kept."""

    def __init__(self, function: Callable[..., Any], options: str) -> None:
        self._impl_class = partial(_Implementation, options)
        super().__init__(function)

    def load_overload(self, signature: Any, target: Any) -> Any:
        try:
            return super().load_overload(signature, target)
        except Exception:  # a file that ends early, or is none of numba's
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        with contextlib.suppress(OSError):  # a full disk, a folder that is gone
            super().save_overload(signature, compiled)
            _remove_unused_beside(self.cache_path)


def keep(dispatcher: Any) -> Any:
    """Let a function's compiled code be kept on disk; as it is where nothing is compiled."""
    function = getattr(dispatcher, "py_func", None)
    if function is None or not os.path.exists(function.__code__.co_filename):
        return dispatcher
    options = repr(
        sorted((name, sorted(v) if isinstance(v, set) else v) for name, v in dispatcher.targetoptions.items())
    )
    dispatcher._cache = _Cache(function, options)
    return _compiled_in_turn(dispatcher)


def is_compiled(dispatcher: Any) -> bool:
    """Whether code of a kernel lies on disk that is good for its present source, or it is never compiled."""
    file = _cache_file(dispatcher)
    try:
        return file is None or bool(file._load_index())
    except Exception:  # damaged
        return False


def _lent(function: Any) -> str:
    """What changes with the kernels and constants that a function takes from elsewhere by name."""
    lent = {name: _stamp(function.__globals__.get(name)) for name in sorted(_names(function.__code__))}
    return blake2b(repr([(name, stamp) for name, stamp in lent.items() if stamp]).encode(), digest_size=8).hexdigest()


def _cache_file(dispatcher: Any) -> Any:
    """Numba's index of a kernel's code on disk."""
    return getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)


def _names(code: CodeType) -> set[str]:
    """Names that a function and those inside it look up."""
    inner = [_names(value) for value in code.co_consts if isinstance(value, CodeType)]
    return set(code.co_names).union(*inner)


def _stamp(value: Any) -> str | None:
    """What changes with a kernel or a constant; None for anything else."""
    if isinstance(value, frozenset):
        return repr(sorted(value, key=repr))
    if isinstance(value, bool | int | float | str | tuple):
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
        with contextlib.suppress(OSError):
            os.makedirs(file._cache_path, exist_ok=True)
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


@cache
def _source(file: str, _changed: int, _size: int) -> str:
    """What changes with a file's content."""
    return blake2b(Path(file).read_bytes(), digest_size=16).hexdigest()


@cache
def _home(given: str) -> str:
    """The first folder that can be written: what the environment says, this user's, the program's, a temporary one."""
    own = AppDirs("flushline", appauthor=False).user_cache_dir
    for folder in (
        given,
        os.path.join(own, "kernels"),
        os.path.join(os.path.dirname(__file__), "__pycache__", "kernels"),
    ):
        if folder and _can_be_written(folder):
            return folder
    folder = _temporary_folder()
    print(
        f"kernels are compiled into {folder}: neither the program's nor the home folder can be written; "
        "NUMBA_CACHE_DIR names a lasting one",
        file=sys.stderr,
    )
    # Processes that are started from here find it, and need not say it again.
    os.environ["NUMBA_CACHE_DIR"] = folder
    return folder


def _can_be_written(folder: str) -> bool:
    """Whether files can be made in a folder, which is made where it is missing."""
    try:
        os.makedirs(folder, mode=0o700, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _temporary_folder() -> str:
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


def _note_use(folder: str) -> None:
    with contextlib.suppress(OSError):  # not there yet, or another user's
        if time.time() - os.stat(folder).st_mtime > _TOUCHED_DAYS * _DAY:
            os.utime(folder)


def _remove_unused_beside(folder: str) -> None:
    """Remove what a kernel of other versions was compiled to that nothing has used for long."""
    for other in os.scandir(os.path.dirname(folder)):
        if other.path != folder and time.time() - other.stat().st_mtime > _UNUSED_DAYS * _DAY:
            shutil.rmtree(other.path, ignore_errors=True)

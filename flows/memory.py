"""What a process that inspects scenes holds in memory, and what it does without."""

from __future__ import annotations

import ctypes
import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8  # malloc.h
# What the library itself arrives at once images were freed: larger pieces come from the system each time, and as much
# as this, twice, is kept.
_LARGE = 32 << 20


def share_heap() -> None:
    """Let all threads of this process take their memory from one heap.

    The GNU C library gives threads heaps of their own, and what was freed in one is of no use to the others: with the
    images of a scan the process would grow from scene to scene. Where a variable of the environment sets when memory is
    given back, as Dask sets it for its workers, every image would come from the system and go back to it.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt:  # musl has none, and no such heaps
            mallopt(_M_ARENA_MAX, 1)
            mallopt(_M_MMAP_THRESHOLD, _LARGE)
            mallopt(_M_TRIM_THRESHOLD, 2 * _LARGE)


class _NoPandas(MetaPathFinder):
    def find_spec(self, fullname: str, *_where: object) -> ModuleSpec | None:
        if fullname == "pandas":
            raise ImportError("not needed here")
        return None


def do_without_pandas() -> None:
    """Let Arrow make arrays without pandas, which it would import at the first one to tell data frames from lists.

    It asks once. Where pandas is loaded already, nothing changes; and data frames still convert later.
    """
    import pyarrow as pa

    if "pandas" in sys.modules:
        return
    refusing = _NoPandas()
    sys.meta_path.insert(0, refusing)
    try:
        pa.array([0])
    finally:
        sys.meta_path.remove(refusing)

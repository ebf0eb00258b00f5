"""Memory of a process that inspects scene after scene."""

from __future__ import annotations

import ctypes
import sys

_M_ARENA_MAX = -8  # malloc.h


def share_heap() -> None:
    """Let all threads of this process take their memory from one heap.

    The GNU C library gives threads heaps of their own, and what was freed in one is of no use to the others: with the
    images of a scan the process would grow from scene to scene.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt:  # musl has none, and no such heaps
            mallopt(_M_ARENA_MAX, 1)

"""Which kernels a process calls, with which types: to be asked for before any kernel is imported."""

from __future__ import annotations

import threading
from typing import Any


def record_kernel_calls() -> list[tuple[str, Any]]:
    """A list that grows by each kernel, as "module:function", and its argument types as they are called anew.

    Kernels that are compiled because another calls them do not count.
    """
    from numba.core.dispatcher import Dispatcher

    called: list[tuple[str, Any]] = []
    compile_, depth = Dispatcher.compile, threading.local()

    def compile_and_note(dispatcher: Any, signature: Any) -> Any:
        function = dispatcher.py_func
        outermost = getattr(depth, "outermost", True)
        if outermost and not function.__module__.startswith("numba") and isinstance(signature, tuple):
            called.append((f"{function.__module__}:{function.__qualname__}", signature))
        depth.outermost = False
        try:
            return compile_(dispatcher, signature)
        finally:
            depth.outermost = outermost

    Dispatcher.compile = compile_and_note
    return called

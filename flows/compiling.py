"""Kernels compiled by a second process while the first one is at work: what a first inspection waits for.

`kernels.json` lists the kernels that inspections call, in the order in which they call them, with the types that they
call them with; `benchmarks/list_kernels.py` makes it. An inspection on an empty cache compiles them one after the
other, as it comes to each; meanwhile a helper goes through the list from its end, until they meet. A list that is out
of date costs time alone: what it lacks is compiled when it is called.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from numba import types

from metrology.jit import cores
from metrology.kernel_cache import is_compiled

LIST = Path(__file__).with_name("kernels.json")
# Fewer are compiled before a helper has started.
_WORTHWHILE = 5

Listed = list[tuple[str, list[Any]]]


@contextlib.contextmanager
def kernels_beside() -> Iterator[None]:
    """Let a helper compile what is listed while the body runs, where much of it is not compiled yet.

    The helper ends with the body at the latest; what it has finished stays. Nothing is said of it, nor does it matter
    whether it succeeds.
    """
    if cores() < 2 or missing(listed()) < _WORTHWHILE:
        yield
        return
    # Finds modules where this process does, whatever lies in the folder at hand.
    work = f"import sys; sys.path[:] = {sys.path!r}; from flows.compiling import compile_listed; compile_listed()"
    nowhere = subprocess.DEVNULL
    helper = subprocess.Popen([sys.executable, "-c", work], stdin=nowhere, stdout=nowhere, stderr=nowhere)
    try:
        yield
    finally:
        helper.terminate()
        helper.wait()


def listed() -> Listed:
    """Kernels as "module:function", and the types of their arguments as text."""
    return [(name, signature) for name, signature in json.loads(LIST.read_text(encoding="utf-8"))]


def missing(kernels: Listed) -> int:
    """How many kernels of the modules that are imported already have no code on disk."""
    names = {name for name, _ in kernels if name.partition(":")[0] in sys.modules}
    return sum(not is_compiled(kernel_of(name)) for name in names)


def compile_listed() -> None:
    """Compile what is listed, the last first."""
    for name, signature in reversed(listed()):
        with contextlib.suppress(Exception):  # a line that is out of date
            kernel_of(name).compile(tuple(type_of(text) for text in signature))


def kernel_of(name: str) -> Any:
    """The kernel of "module:function"."""
    module, _, function = name.partition(":")
    return getattr(importlib.import_module(module), function)


def text_of(kind: Any) -> Any:
    """A numba type of a kernel's argument as JSON holds it: a name, or a list that begins with what it is a list of."""
    if isinstance(kind, types.Array):
        return f"{kind.dtype} {kind.ndim}{kind.layout}{'' if kind.mutable else ' readonly'}"
    if isinstance(kind, types.BaseTuple):
        named = getattr(kind, "instance_class", None)
        begin = f"{named.__module__}:{named.__qualname__}" if named else "tuple"
        members: Any = kind
        return [begin, *map(text_of, members)]
    if isinstance(kind, types.Omitted):
        return ["omitted", kind.value]
    return str(kind)


def type_of(text: Any) -> types.Type:
    """The type that `text_of` wrote."""
    if isinstance(text, str):
        name, *array = text.split()
        scalar: Any = types.boolean if name == "bool" else getattr(types, name)
        if not array:
            return scalar
        layout: Any = array[0][-1]
        return types.Array(scalar, int(array[0][:-1]), layout, readonly="readonly" in array)
    kind, *inner = text
    if kind == "omitted":
        return types.Omitted(inner[0])
    return _tuple_of(kind, [type_of(part) for part in inner])


def _tuple_of(kind: str, inner: Sequence[types.Type]) -> types.Type:
    if kind == "tuple":
        return types.BaseTuple.from_types(tuple(inner))
    return types.BaseTuple.from_types(tuple(inner), kernel_of(kind))

"""Python's pickles of arrays, numbers, lists and tables alone: calibrations are often kept so. Nothing is ever run.

A pickle is a program. Only the calls that rebuild NumPy's arrays are let through; whatever else a file asks for is
refused by its name.
"""

from __future__ import annotations

import io
import pickle
from typing import Any

import numpy as np

from metrology.errors import RigError

_ALLOWED = {
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    ("_codecs", "encode"),
    ("numpy.core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy.core.multiarray", "scalar"),
    ("numpy._core.multiarray", "scalar"),
    ("numpy.core.numeric", "_frombuffer"),
    ("numpy._core.numeric", "_frombuffer"),
}


class _Arrays(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ALLOWED:
            raise RigError(f"{module}.{name}, which is neither a number nor an array; save arrays")
        return super().find_class(module.replace("numpy.core", "numpy._core"), name)


def read_pickle(data: bytes) -> Any:
    """What a pickle of arrays and tables holds; RigError where it asks for more."""
    return _Arrays(io.BytesIO(data)).load()


def read_npy(data: bytes) -> Any:
    """An array of NumPy's own file format, or the one object that `np.save` was given."""
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, kind = read_header(file)
    if not kind.hasobject:
        return np.load(io.BytesIO(data), allow_pickle=False)
    held = read_pickle(data[file.tell() :])
    return held.item() if shape == () and isinstance(held, np.ndarray) else held

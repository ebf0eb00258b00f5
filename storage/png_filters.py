"""The last step of decoding a PNG: each byte was stored as its difference to what its neighbours predict.

Source: Portable Network Graphics Specification (Third Edition), section 9.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.jit import kernel

_NONE, _SUB, _UP, _AVERAGE, _PAETH = range(5)


@kernel
def unfilter(stored: NDArray[np.uint8], sample_bytes: int, rows: NDArray[np.uint8]) -> bool:  # pragma: no cover
    """Undo the filters of a grey picture's rows; returns whether every row has a known filter.

    Parameters
    ----------
    stored : (h, 1 + n) uint8
        Each row's filter, and its n filtered bytes.
    sample_bytes : int
        Bytes of a sample, 1 or 2: the distance to the left neighbour.
    rows : (h, n) uint8
        Filled with the bytes of the picture.
    """
    height, n = rows.shape
    above = np.zeros(n, np.uint8)
    for y in range(height):
        kind, given, row = stored[y, 0], stored[y, 1:], rows[y]
        if kind == _NONE:
            for x in range(n):
                row[x] = given[x]
        elif kind == _SUB:
            for x in range(sample_bytes):
                row[x] = given[x]
            for x in range(sample_bytes, n):
                row[x] = given[x] + row[x - sample_bytes]
        elif kind == _UP:
            for x in range(n):
                row[x] = given[x] + above[x]
        elif kind == _AVERAGE:
            for x in range(sample_bytes):
                row[x] = given[x] + (above[x] >> 1)
            for x in range(sample_bytes, n):
                row[x] = given[x] + ((np.int32(row[x - sample_bytes]) + np.int32(above[x])) >> 1)
        elif kind == _PAETH:
            for x in range(sample_bytes):
                row[x] = given[x] + above[x]
            for x in range(sample_bytes, n):
                left, up, corner = (
                    np.int32(row[x - sample_bytes]),
                    np.int32(above[x]),
                    np.int32(above[x - sample_bytes]),
                )
                by_left, by_up, by_corner = abs(up - corner), abs(left - corner), abs(left + up - 2 * corner)
                nearest = corner
                if by_left <= by_up and by_left <= by_corner:
                    nearest = left
                elif by_up <= by_corner:
                    nearest = up
                row[x] = given[x] + nearest
        else:
            return False
        above = row
    return True

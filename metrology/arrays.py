"""The usual types of arrays; shapes stand beside each in the docstrings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Float32 = NDArray[np.float32]
Ints = NDArray[np.intp]

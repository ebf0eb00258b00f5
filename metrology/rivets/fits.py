"""What has been fitted round one head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.rivets.patch import Patch
from metrology.surfaces import Polynomial


@dataclass(frozen=True)
class Fits:
    """The head's and the skin's surfaces in the frame of their patch, and which of its points they were fitted to."""

    patch: Patch
    inner: NDArray[np.bool_]
    outer: NDArray[np.bool_]
    head: Polynomial
    skin: Polynomial

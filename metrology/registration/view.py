"""What of a panel is in view of a rig."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.rig import Rig

_MARGIN_PX = 10.0


def in_view(rig: Rig, points: Array, radius_mm: float | Array = 0.0) -> NDArray[np.bool_]:
    """Which places (n, 3) of the rig frame all devices of a rig have in their field, with `radius_mm` around them."""
    seen = np.ones(len(points), bool)
    for device in rig.devices.values():
        depth = (points @ device.R.T + device.t)[:, 2]
        ahead = depth > 0
        pixels = device.project(np.where(ahead[:, None], points, device.centre + device.R[2]))
        margin = _MARGIN_PX + np.asarray(radius_mm) * device.K[0, 0] / np.maximum(depth, 1e-9)
        u, v = pixels[:, 0], pixels[:, 1]
        seen &= ahead & (u > margin) & (v > margin) & (u < device.width - margin) & (v < device.height - margin)
    return seen

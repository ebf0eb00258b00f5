"""Whether both cameras look at the same skin.

Phase alone does not tell: frames of another scan bear fringes of the same projector, and where the panel or the rig has
hardly moved in between, they fit the rig within a part of a pixel. Points are then those of no skin. But the rims that
one camera sees are not in the other's picture.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrology.cloud import Reconstruction
from metrology.results import RivetDetection
from metrology.texture_offset import correlations

LEAST_ALIKE = 0.6
"""Correlation of rims that the same skin gives at least: under changing sheen they keep 0.8, other skin leaves 0.4."""
_LEAST_RIMS = 12


def rims_alike(reconstruction: Reconstruction, detections: Sequence[RivetDetection]) -> float | None:
    """How alike both cameras see the rims that the left one sees: median correlation of the pictures there.

    None where too few rims are in both views.
    """
    right, below = np.array([0.5, 0.0]), np.array([0.0, 0.5])
    rims = [[d.u_px, d.v_px] + d.major_px * way for d in detections for way in (right, -right, below, -below)]
    found = correlations(reconstruction, np.rint(np.reshape(rims, (-1, 2))).astype(np.int64))
    return float(np.median(found)) if len(found) >= _LEAST_RIMS else None

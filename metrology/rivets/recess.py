"""Whether what lies below the skin is the recess of a head, and no hole: a head's flat top surrounds it."""

from __future__ import annotations

import numpy as np

from metrology.cloud import Reconstruction
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.geometry import nearby_plane

_OFF_MIDDLE = 0.3  # of the head's radius
_WIDEST = 0.6  # of the head's diameter is a recess
_BORDER_PX = (1.5, 4.0)  # inside the rim, where the top is looked at
_SUNK_MM = 0.2  # may a head's top lie
_CONE = 0.3  # or that times the distance from its rim: a countersink of 120° falls twice as fast


def is_recess(hole: Ellipse, ring: Ellipse, reconstruction: Reconstruction) -> bool:
    """Whether a ring is the rim of a head and a hole its recess."""
    off = np.hypot(hole.u - ring.u, hole.v - ring.v)
    if off > _OFF_MIDDLE * ring.b or hole.radius > _WIDEST * ring.radius:
        return False
    plane = nearby_plane(reconstruction, ring)
    if plane is None:
        return False
    reach = int(1.7 * ring.a) + 2
    height, width = reconstruction.points.shape[:2]
    part = np.s_[
        max(0, int(ring.v) - reach) : min(height, int(ring.v) + reach + 1),
        max(0, int(ring.u) - reach) : min(width, int(ring.u) + reach + 1),
    ]
    v, u = np.mgrid[part]
    away_px = (ring.level(u, v) - 1) * ring.b
    h = plane[0].local(reconstruction.points[part].astype(float))[..., 2]
    top = h[np.isfinite(h) & (away_px < -_BORDER_PX[0]) & (away_px > -_BORDER_PX[1])]
    skin = h[np.isfinite(h) & (away_px > _BORDER_PX[1]) & (away_px < 0.6 * ring.b)]
    if len(top) == 0 or len(skin) == 0:
        return False
    z = float(np.nanmedian(reconstruction.points[part][..., 2]))
    from_rim = float(np.mean(_BORDER_PX)) * z / float(reconstruction.rig.left.K[0, 0])
    return bool(np.median(skin) - np.median(top) < max(_SUNK_MM, _CONE * from_rim))

"""A rig with one of its devices turned after its calibration."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from metrology.rig import Rig


def turned(rig: Rig, device: str, degrees: float, axis: tuple[float, float, float] = (0.0, 1.0, 0.0)) -> Rig:
    """The rig with its right camera or projector turned about an axis of its own frame through its centre."""
    old = getattr(rig, device)
    turn = Rotation.from_rotvec(math.radians(degrees) * np.array(axis) / np.linalg.norm(axis)).as_matrix()
    return replace(rig, **{device: replace(old, R=turn @ old.R, t=turn @ old.t)})

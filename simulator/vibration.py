"""What a panel that moves against the rig between frames changes: to first order, from one trace of the panel at rest.

The pattern stands still in space: only a motion along the skin's normal shifts it on the skin, and by another amount in
each camera's view. What is painted on the skin moves with the panel across the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrology.arrays import Float32
from metrology.rig import Rig
from simulator.relief import Floats
from simulator.rig import aim_frame
from simulator.trace import Hits
from simulator.truth import Pose


@dataclass(frozen=True)
class Sway:
    """How a view changes with the panel's motion (x, y, z in the panel's frame, mm), at the rig's aim point."""

    pattern: Floats
    """(3,): by how many projector pixels the pattern's coordinate at a camera pixel grows, per mm."""
    image: Floats
    """(3, 2): by how many camera pixels (u, v) a place of the skin moves, per mm."""


def sway_of(rig: Rig, side: str, pose: Pose, axis: str) -> Sway:
    """The sway of one camera's view, the pattern varying along the projector's `axis`."""
    camera = rig.left if side == "left" else rig.with_right()
    aim = aim_frame(rig)[1]
    h = 1e-3
    image = np.array([(camera.project(aim + h * e) - camera.project(aim - h * e)) / (2 * h) for e in pose.R.T])
    normal = pose.R[:, 2]
    view = aim - camera.centre
    view /= np.linalg.norm(view)
    # A pixel sees the skin farther along its ray by the motion along the normal.
    along = view / (view @ normal)
    projector = rig.with_projector()
    run = (projector.project(aim + h * along) - projector.project(aim - h * along)) / (2 * h)
    column = float(run[0 if axis == "x" else 1])
    return Sway(np.array([0.0, 0.0, column]), image)


def moved_texture(light: Float32, hits: Hits, shifts_px: Floats) -> Float32:
    """Each frame with the skin's brightness moved by (frames, 2) pixels, to first order.

    Parameters
    ----------
    light : (frames, h, w) float32
    """
    counts = np.diff(hits.first)
    sums = np.add.reduceat(np.concatenate([hits.direct + hits.ambient, [0.0]]), hits.first[:-1])
    bright = np.log(np.maximum(sums / counts, 0.5)).reshape(hits.height, hits.width)
    down, across = np.gradient(bright)
    moved = [
        frame * np.clip(1 - across * du - down * dv, 0.5, 1.5).astype(np.float32)
        for frame, (du, dv) in zip(light, shifts_px, strict=True)
    ]
    return np.stack(moved)

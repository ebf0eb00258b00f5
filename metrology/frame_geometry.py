"""Which way the projector coordinate must run over a camera's image."""

from __future__ import annotations

import numpy as np

from metrology.arrays import Array
from metrology.fringe import Axis
from metrology.rig import Device


def expected_gradient(camera: Device, projector: Device | None, axis: Axis) -> Array | None:
    """(2,) direction in the image (u, v) along which the projector coordinate rises, for a skin that faces the camera.

    The skin is where both optical axes pass each other closest; only the direction counts. None without a projector.
    """
    if projector is None:
        return None
    centre = np.array([camera.width, camera.height]) / 2
    ray, beam = camera.rays(centre), projector.rays(np.array([projector.width, projector.height]) / 2)
    between = projector.centre - camera.centre
    across = float(ray @ beam)
    reach = float(between @ ray - (between @ beam) * across) / (1 - across**2 + 1e-9)
    distance = reach if reach > 0 else 1e3 * float(np.linalg.norm(between))
    step = camera.width / 100
    pixels = centre + step * np.array([[-1, 0], [1, 0], [0, -1], [0, 1]])
    rays = camera.rays(pixels)
    points = camera.centre + distance * rays / (rays @ ray)[:, None]
    seen = projector.project(points)[:, 0 if axis == "x" else 1]
    return np.array([seen[1] - seen[0], seen[3] - seen[2]]) / (2 * step)

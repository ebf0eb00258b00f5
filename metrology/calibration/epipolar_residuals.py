"""How far apart the two cameras see the same feature, across the epipolar line."""

from __future__ import annotations

import numpy as np

from metrology.arrays import Array
from metrology.calibration.calibrate import Calibration
from metrology.calibration.initial import to_board
from metrology.texture_offset import epipolar_directions


def epipolar_residuals(calibration: Calibration) -> tuple[Array, Array]:
    """Residuals of all features that both cameras saw in the same pose.

    Returns
    -------
    left_px : (n, 2) ndarray
        Raw left pixels.
    across_px : (n,) ndarray
        Signed distance of the right pixel from the epipolar line of the left one, right pixels.
    """
    state = calibration.adjusted.state
    left, right = state.devices["left"], state.devices["right"]
    of = {(s.pose, s.kind, s.device): s for s in calibration.sightings}
    places, distances = [], []
    for (pose, kind, device), seen in of.items():
        other = of.get((pose, kind, "right"))
        if device != "left" or other is None:
            continue
        _, mine, theirs = np.intersect1d(seen.index, other.index, return_indices=True)
        rotation, translation = state.rotations[pose], state.translations[pose]
        on_board = to_board(left, seen.pixels[mine], rotation, translation)
        points = on_board @ rotation[:, :2].T + translation
        direction = epipolar_directions(left, right, seen.pixels[mine], points[:, 2])
        off = other.pixels[theirs] - right.project(points)
        places.append(seen.pixels[mine])
        distances.append(off[:, 1] * direction[:, 0] - off[:, 0] * direction[:, 1])
    if not places:
        return np.empty((0, 2)), np.empty(0)
    return np.concatenate(places), np.concatenate(distances)

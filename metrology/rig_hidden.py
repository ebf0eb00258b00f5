"""What two cameras alone cannot tell of their calibration: errors that leave the epipolar lines where texture lies.

A yaw moves points along their lines and bends these by hundredths of a pixel; two focal lengths off alike do next to
nothing; the distance between the cameras does nothing. All of them change lengths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.rig import Device, Rig
from metrology.verification.board_lengths import triangulated

_SMALL = 1e-3
_MOST = 0.3  # radians, or share: more than any calibration is off
_PLACES = 500
_LEAST = 50


@dataclass(frozen=True)
class Hidden:
    """An error that a scan does not show."""

    name: str
    amount: float
    """Radians, or a share: from here on the scan would show it."""
    lengths: float
    """By what share lengths are off with it."""


def hidden_errors(cloud: Reconstruction, limit_px: float) -> list[Hidden]:
    """Errors of a rig of two cameras whose rays miss each other, at the places of a cloud's points, by a limit.

    Parameters
    ----------
    limit_px : float
        Root mean square from which a rig is warned of, pixels.
    """
    places = np.argwhere(cloud.valid)
    if len(places) < _LEAST:
        return []
    chosen = places[:: max(1, len(places) // _PLACES)]
    points = cloud.points[chosen[:, 0], chosen[:, 1]].astype(float)
    rig = replace(cloud.rig, projector=None)
    pixels = [device.project(points) for device in (rig.left, rig.with_right())]
    wrong: dict[str, Callable[[float], Rig]] = {
        "yaw": lambda amount: replace(rig, right=_yawed(rig.with_right(), amount)),
        "focal lengths": lambda amount: replace(
            rig, left=_zoomed(rig.left, amount), right=_zoomed(rig.with_right(), amount)
        ),
    }
    found = []
    for name, at in wrong.items():
        miss = triangulated(at(_SMALL), pixels)[1]
        amount = min(_SMALL * limit_px / max(miss, 1e-9), _MOST)
        lengths = [_spread(triangulated(at(sign * amount), pixels)[0]) / _spread(points) - 1 for sign in (-1, 1)]
        found.append(Hidden(name, amount, float(np.abs(lengths).max())))
    return found


def _yawed(device: Device, angle: float) -> Device:
    """A device turned about its image's vertical axis where it stands."""
    R = np.asarray(cv2.Rodrigues(np.array([0.0, angle, 0.0]))[0]) @ device.R
    return replace(device, R=R, t=-R @ device.centre)


def _zoomed(device: Device, share: float) -> Device:
    return replace(device, K=device.K * np.array([[1 + share, 1, 1], [1, 1 + share, 1], [1, 1, 1]]))


def _spread(points: Array) -> float:
    return float(np.sqrt(((points - points.mean(0)) ** 2).sum()))

"""Pinhole and lens in kernels: the viewing ray of any sub-pixel position, and the pixel of a point.

Written apart from `metrology.rig`, which the measurement uses; a test holds the two together.
"""

from __future__ import annotations

import numpy as np

from metrology.errors import RigError
from metrology.rig import Device
from simulator.compiled import kernel
from simulator.relief import Floats

_LENS_TERMS = 8


def pack_device(device: Device) -> Floats:
    """A device as one array for the kernels; RigError where its lens has a thin prism, which is not simulated."""
    if device.lens[_LENS_TERMS:].any():
        raise RigError("distortion: found terms of a thin prism, expected at most k1 to k6, p1 and p2 in a simulation")
    return np.concatenate([device.K.ravel(), device.lens[:_LENS_TERMS], device.R.ravel(), device.t])


def moved(device: Device, rotation: Floats, translation: Floats) -> Device:
    """The device as seen from another frame: a point p of that frame is at `rotation` p + `translation` in the rig."""
    return Device(device.width, device.height, device.K, device.distortion,
                  device.R @ rotation, device.R @ translation + device.t)  # fmt: skip


@kernel
def distort(p: Floats, x: float, y: float) -> tuple[float, float]:
    """Lens distortion of normalised coordinates (Brown's model with the rational denominator)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = p[9], p[10], p[11], p[12], p[13], p[14], p[15], p[16]
    r2 = x * x + y * y
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return u, v


@kernel
def ray(p: Floats, u: float, v: float, out: Floats) -> None:
    """Viewing direction (unit, in the frame of the packed pose) of the raw pixel (u, v), into `out`."""
    yd = (v - p[5]) / p[4]
    xd = (u - p[2] - p[1] * yd) / p[0]
    x, y = xd, yd
    # The distortion is mild, so the fixed point is reached in about eight rounds.
    for _ in range(60):
        dx, dy = distort(p, x, y)
        ex, ey = xd - dx, yd - dy
        x, y = x + ex, y + ey
        if ex * ex + ey * ey < 1e-24:
            break
    norm = 1.0 / np.sqrt(x * x + y * y + 1.0)
    for k in range(3):
        out[k] = (p[17 + k] * x + p[20 + k] * y + p[23 + k]) * norm


@kernel
def pixel(p: Floats, point: Floats) -> tuple[float, float]:
    """Raw pixel of a point; (−1e9, −1e9) behind the device."""
    x = p[17] * point[0] + p[18] * point[1] + p[19] * point[2] + p[26]
    y = p[20] * point[0] + p[21] * point[1] + p[22] * point[2] + p[27]
    z = p[23] * point[0] + p[24] * point[1] + p[25] * point[2] + p[28]
    if z <= 0.0:
        return -1e9, -1e9
    xd, yd = distort(p, x / z, y / z)
    return p[0] * xd + p[1] * yd + p[2], p[4] * yd + p[5]

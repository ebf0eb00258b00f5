"""Undistorted image coordinates of every pixel of a camera, by Newton's method from the pixel beside it.

OpenCV's own solver takes each pixel alone, by fixed-point iteration: some ten times as long.
"""

from __future__ import annotations

import numpy as np

from metrology.arrays import Array
from metrology.jit import kernel, over_rows
from metrology.rig import Device

_STEPS = 8  # a neighbour's answer leads here in two or three
_CLOSE = 1e-7  # of a focal length: of the step, whose square is about what is left


def pixel_directions(device: Device) -> Array:
    """(h, w, 2) x/z, y/z in the device's own frame of each of its pixels, as `Device.normalized` gives them."""
    directions = np.empty((device.height, device.width, 2))
    first = device.normalized(np.column_stack([np.zeros(device.height), np.arange(device.height)]))
    missed = np.zeros(device.height, np.bool_)
    focal = np.array([device.K[0, 0], device.K[1, 1], device.K[0, 2], device.K[1, 2]])

    def solve(start: int, end: int) -> None:
        _solve_rows(first, focal, device.lens, start, end, directions, missed)

    over_rows(solve, device.height)
    # Where the lens's polynomials turn back there is no answer, or two: OpenCV's is taken.
    for v in np.flatnonzero(missed):
        directions[v] = device.normalized(np.column_stack([np.arange(device.width), np.full(device.width, v)]))
    return directions


@kernel
def _solve_rows(first, focal, distortion, start, end, directions, missed):  # type: ignore[no-untyped-def]
    """Fill rows `start` to `end`: x such that the lens takes it to the pixel; or mark the row as missed."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = distortion
    fx, fy, cx, cy = focal
    for v in range(start, end):
        x, y = first[v]
        before_x, before_y = x, y
        to_y = (v - cy) / fy
        for u in range(directions.shape[1]):
            to_x = (u - cx) / fx
            guess_x, guess_y = 2.0 * x - before_x, 2.0 * y - before_y
            before_x, before_y = x, y
            x, y = guess_x, guess_y
            solved = False
            for _ in range(_STEPS):
                r2 = x * x + y * y
                up = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
                down = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
                radial = up / down
                # By r²; a derivative of r² by x is 2 x.
                slope = (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3) - radial * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))) / down
                off_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2) - to_x
                off_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + r2 * s4) - to_y
                prism_x, prism_y = 2.0 * (s1 + 2.0 * r2 * s2), 2.0 * (s3 + 2.0 * r2 * s4)
                mixed = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
                xx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x + prism_x * x
                xy = mixed + prism_x * y
                yx = mixed + prism_y * x
                yy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x + prism_y * y
                determinant = xx * yy - xy * yx
                if not (determinant > 0.0 and xx > 0.0 and down > 0.0):
                    break
                step_x = (yy * off_x - xy * off_y) / determinant
                step_y = (xx * off_y - yx * off_x) / determinant
                x -= step_x
                y -= step_y
                if abs(step_x) + abs(step_y) < _CLOSE:
                    solved = True
                    break
            if not solved:
                missed[v] = True
                break
            directions[v, u, 0], directions[v, u, 1] = x, y

"""Which side of a seam is side A and which is side B: said here, for measurements, the wind and drawings alike.

Side A is the one at smaller u for a seam nearer to vertical in the left image, at smaller v otherwise. The seam as a
whole decides, by the chord from one end to the other; along it the sides stay the same ones however it bends.
"""

from __future__ import annotations

import numpy as np

from metrology.arrays import Array


def is_upright(course_px: Array) -> bool:
    """Whether a seam (n, 2), left image, is nearer to vertical: side B then lies to its right, else below it."""
    chord = course_px[-1] - course_px[0]
    return bool(abs(chord[1]) >= abs(chord[0]))


def oriented(course_px: Array) -> Array:
    """The course in its direction of growing arc length: downwards where it is upright, else to the right."""
    chord = course_px[-1] - course_px[0]
    return course_px if chord[int(is_upright(course_px))] >= 0 else course_px[::-1]


def towards_b(direction: Array, place: Array, upright: bool) -> Array:
    """Unit vectors across a seam from side A to side B, rig frame.

    Parameters
    ----------
    direction : (..., 3) ndarray
        Of the seam, along its oriented course.
    place : (..., 3) ndarray
        Points of the seam; the left camera looks along them.
    upright : bool
        Whether the whole seam is, see `is_upright`.
    """
    # Seen by the camera the right hand of a course that runs to the right lies below it, of one that runs down left.
    (px, py, pz), (dx, dy, dz) = place.T, direction.T
    below = np.array([py * dz - pz * dy, pz * dx - px * dz, px * dy - py * dx]).T  # numpy's own cross is slow
    across = -below if upright else below
    return np.asarray(across / np.sqrt((across * across).sum(-1, keepdims=True)))

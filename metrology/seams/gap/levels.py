"""How the brightness of a gap's parts changes along its seam.

Profiles are relative to the skin beside each station. A chamfer, a wall and the floor are lit by the same lamp as the
skin, but do not shine with it: where a highlight makes the skin brighter, they look darker by as much. Such a course is
smooth; what a station's own level departs from it is grain. So levels are found about one level for the whole seam
first, with all that they may differ along it, and then about their course, to which a station keeps closely. The less
freedom a station's levels have, the less its noise passes for a border.
"""

from __future__ import annotations

import numpy as np

from metrology.arrays import Array
from metrology.robust import MAD
from metrology.seams.gap.model import DARK_FLOOR, DARK_WALL, LEVELS, SKIN_A, SKIN_B, SKY, SLOPE_A, SLOPE_B

# A polynomial of this degree takes one highlight along the seam; with fewer stations it would follow their noise.
_DEGREE, _LEAST_STATIONS = 5, 16
# Stations that depart so many robust standard deviations (a scratch, dirt) say nothing about the course.
_ASTRAY, _ROUNDS = 3.0, 3
# The skin's own levels are what the profiles are relative to.
_FOLLOWED = np.setdiff1d(np.arange(LEVELS), (SKIN_A, SKIN_B, SLOPE_A, SLOPE_B))


def courses(places: Array, away: Array) -> Array:
    """Smooth course along the seam of what levels are away from the usual ones.

    Parameters
    ----------
    places : (n,) ndarray
        −1 at the seam's beginning to 1 at its end.
    away : (n, k, LEVELS) ndarray
        Of each station in each camera.

    Returns
    -------
    (n, k, LEVELS) ndarray
        Nothing for the skin, and with few stations.
    """
    smooth = np.zeros_like(away)
    if len(places) < _LEAST_STATIONS:
        return smooth
    powers = np.vander(places, _DEGREE + 1)
    for camera in range(away.shape[1]):
        for level in _FOLLOWED:
            smooth[:, camera, level] = _course(powers, away[:, camera, level])
    return smooth


def _course(powers: Array, values: Array) -> Array:
    course, straying = np.zeros_like(values), np.inf
    for _ in range(_ROUNDS):
        kept = np.abs(values - course) <= straying
        course = powers @ np.linalg.lstsq(powers[kept], values[kept], rcond=None)[0]
        straying = _ASTRAY * MAD * float(np.median(np.abs(values - course))) + 1e-9
    return course


def _scatter(lit: float, dark: float) -> Array:
    scatter = np.full(LEVELS, lit)
    scatter[[DARK_WALL, DARK_FLOOR]] = dark
    scatter[[SKIN_A, SKIN_B]] = 0.05
    scatter[[SLOPE_A, SLOPE_B, SKY]] = 0.02
    return scatter


# (LEVELS,) how much a station's levels scatter about the seam's usual ones: course, grain, smudges.
LEVEL_SCATTER = _scatter(lit=0.05, dark=0.05)
# About their course there is grain alone: some hundredths, in the dark a share of little light.
COURSE_SCATTER = _scatter(lit=0.02, dark=0.01)

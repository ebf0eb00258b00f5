"""Sheets bent by straight lines across a seam: heights that depend on the place along the seam alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.defects.ruled_kernel import bin_medians, robust_polyline
from metrology.robust import MAD, median

Array = NDArray[np.float64]

BIN_MM = 2.0
_PER_BIN = 20  # points that a median needs
_COARSE_MM = 6.0  # of bins that tell whether there is anything
_BORNE_OUT = 2.0  # times what noise makes of it must a profile vary
_HELD = 1e-3  # of a full bin: its neighbours tell where no cell does
_MOST_TURN = 0.05  # rad, from the seam's chord as it was seen


@dataclass(frozen=True)
class Ruled:
    """Heights along a seam."""

    direction: Array
    """(2,): along the seam in the plate's frame."""
    start: float
    heights: Array
    """start, heights: float, (n,): mm; `BIN_MM` apart, linear between."""
    variance: Array
    """(n,): of the heights, mm²."""

    def places(self, x: Array, y: Array) -> Array:
        """Where points lie, in bins."""
        s = (x * self.direction[0] + y * self.direction[1] - self.start) / BIN_MM
        return np.asarray(np.clip(s, 0.0, len(self.heights) - 1.001))

    def at(self, x: Array, y: Array) -> Array:
        """Heights at points, mm."""
        return np.asarray(np.interp(self.places(x, y), np.arange(len(self.heights)), self.heights))

    def variance_at(self, x: Array, y: Array) -> Array:
        """Variance of the heights at points, mm²."""
        return np.asarray(self.variance[np.rint(self.places(x, y)).astype(int)])


def ruled_profiles(rest: Array, sd: Array, x: Array, y: Array, directions: Sequence[Array]) -> tuple[Ruled, ...]:
    """What heights over a smooth surface have in common across each seam.

    Parameters
    ----------
    rest, sd : (n,) ndarray
        Heights over the surface and their standard deviation for independent pixels, mm.
    x, y : (n,) ndarray
        mm.
    directions : sequence of (2,) ndarray
        About those of the seams.
    """
    found: list[Ruled] = []
    for direction in directions:
        left = rest - sum((profile.at(x, y) for profile in found), np.zeros_like(x))
        profile = _profile(left, sd, x, y, direction / np.linalg.norm(direction))
        found.append(_turned(profile, left, x, y))
    return tuple(found)


def bent_along(rest: Array, sd: Array, x: Array, y: Array, directions: Sequence[Array]) -> list[Array]:
    """Those of the seams along which heights change alike in the near half of a plate and in the far one.

    A dent lies in one of the halves, or in neither for the most part. Parameters as of `ruled_profiles`.
    """
    bent = []
    for direction in directions:
        direction = direction / np.linalg.norm(direction)
        s = x * direction[0] + y * direction[1]
        across = x * direction[1] - y * direction[0]
        low = ((s - s.min()) / _COARSE_MM).astype(int)
        count = int(low.max()) + 1
        far = across > median(across)
        near_heights, far_heights = (bin_medians(low[half], rest[half], count) for half in (~far, far))
        alike = np.where(near_heights * far_heights > 0, np.minimum(np.abs(near_heights), np.abs(far_heights)), 0.0)
        noise = MAD * median(np.abs(rest - bin_medians(low, rest, count)[low]))
        variance = np.pi * noise**2 / max(len(rest) / count, 1.0)
        if np.mean(alike**2) > _BORNE_OUT**2 * variance:
            bent.append(direction)
    return bent


def _profile(rest: Array, sd: Array, x: Array, y: Array, direction: Array) -> Ruled:
    """Robust means of heights over lines across a seam, linear between bins."""
    s = x * direction[0] + y * direction[1]
    start = float(s.min())
    place = (s - start) / BIN_MM
    count = int(place.max()) + 2
    low = place.astype(int)
    # A start that dents on a line do not lift; medians stand between two nodes.
    part = slice(None, None, max(1, len(rest) // (_PER_BIN * count)))
    medians = bin_medians(low[part], rest[part], count)
    heights = 0.5 * (medians + np.roll(medians, 1))
    heights[0] = medians[0]
    variance = robust_polyline(low, place - low, rest, sd, _HELD, heights)
    return Ruled(direction, start, heights, variance)


def _turned(profile: Ruled, rest: Array, x: Array, y: Array) -> Ruled:
    """The profile turned so that its lines fit the heights far from its seam too: one step of Gauss-Newton."""
    place = profile.places(x, y)
    slope = np.gradient(profile.heights, BIN_MM)[np.rint(place).astype(int)]
    across = -profile.direction[1] * x + profile.direction[0] * y
    lever = slope * (across - across.mean())
    residual = rest - profile.at(x, y)
    kept = np.abs(residual) < 3 * MAD * median(np.abs(residual))
    turn = float(np.sum(lever[kept] * residual[kept]) / max(np.sum(lever[kept] ** 2), 1e-12))
    turn = float(np.clip(turn, -_MOST_TURN, _MOST_TURN))
    c, s = np.cos(turn), np.sin(turn)
    direction = np.array([[c, -s], [s, c]]) @ profile.direction
    start = profile.start + float(across.mean() * turn)
    return Ruled(direction, start, profile.heights, profile.variance)

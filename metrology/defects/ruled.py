"""Sheets bent by straight lines across a seam: heights that depend on the place along the seam alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.defects.ruled_kernel import bin_medians
from metrology.robust import MAD, median

BIN_MM = 2.0
_PER_BIN = 20  # points that a median needs
_COARSE_MM = 6.0  # of bins that tell whether there is anything
_BORNE_OUT = 2.0  # times what noise makes of it must a profile vary
_MOST_TURN = 0.05  # rad, from the seam's chord as it was seen


@dataclass(frozen=True)
class Ruled:
    """Heights along a seam."""

    direction: Array
    """(2,): along the seam in the plate's frame."""
    start: float
    heights: Array
    """start, heights: float, (n,): mm; `BIN_MM` apart, linear between."""

    def places(self, x: Array, y: Array) -> Array:
        """Where points lie, in bins."""
        s = (x * self.direction[0] + y * self.direction[1] - self.start) / BIN_MM
        return np.asarray(np.clip(s, 0.0, len(self.heights) - 1.001))

    def at(self, x: Array, y: Array) -> Array:
        """Heights at points, mm."""
        return np.asarray(np.interp(self.places(x, y), np.arange(len(self.heights)), self.heights))

    def nodes(self, x: Array, y: Array) -> tuple[NDArray[np.int64], Array]:
        """(n,) number of the node before each point, and the share of the way from there to the next."""
        place = self.places(x, y)
        low = place.astype(np.int64)
        return low, place - low


def medians_along(rest: Array, x: Array, y: Array, directions: Sequence[Array]) -> tuple[Ruled, ...]:
    """A start that dents on a line do not lift: medians of what heights over a smooth surface have in common.

    Parameters
    ----------
    rest : (n,) ndarray
        Heights over the surface, mm.
    x, y : (n,) ndarray
        mm.
    directions : sequence of (2,) ndarray
        About those of the seams.
    """
    found: list[Ruled] = []
    for direction in directions:
        direction = direction / np.linalg.norm(direction)
        s = x * direction[0] + y * direction[1]
        start = float(s.min())
        place = (s - start) / BIN_MM
        count = max(int(place.max()) + 2, 3)
        part = slice(None, None, max(1, len(rest) // (_PER_BIN * count)))
        medians = bin_medians(place.astype(int)[part], rest[part], count)
        heights = 0.5 * (medians + np.roll(medians, 1))  # medians stand between two nodes
        heights[0] = medians[0]
        found.append(Ruled(direction, start, heights))
        rest = rest - found[-1].at(x, y)
    return tuple(found)


def bent_along(rest: Array, sd: Array, x: Array, y: Array, directions: Sequence[Array]) -> list[Array]:
    """Those of the seams along which heights change alike in the nearest third of a plate and in the farthest.

    A dent hardly reaches both. Parameters as of `ruled_profiles`.
    """
    bent = []
    for direction in directions:
        direction = direction / np.linalg.norm(direction)
        s = x * direction[0] + y * direction[1]
        across = x * direction[1] - y * direction[0]
        low = ((s - s.min()) / _COARSE_MM).astype(int)
        count = int(low.max()) + 1
        near, far = np.quantile(across, [1 / 3, 2 / 3])
        near_heights, far_heights = (
            bin_medians(low[part], rest[part], count) for part in (across < near, across > far)
        )
        alike = np.where(near_heights * far_heights > 0, np.minimum(np.abs(near_heights), np.abs(far_heights)), 0.0)
        noise = MAD * median(np.abs(rest - bin_medians(low, rest, count)[low]))
        variance = 1.5 * np.pi * noise**2 / max(len(rest) / count, 1.0)
        if np.mean(alike**2) > _BORNE_OUT**2 * variance:
            bent.append(direction)
    return bent


def turned(profile: Ruled, rest: Array, x: Array, y: Array) -> Ruled:
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
    return Ruled(direction, start, profile.heights)

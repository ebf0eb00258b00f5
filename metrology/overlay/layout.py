"""Where text goes: beside its feature, on the skin, inside the picture, and neither on other text nor on a feature."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrology.arrays import Array
from metrology.overlay.skin_map import SkinMap

_DISTANCES = np.array([5.0, 10.0, 16.0, 28.0, 44.0, 64.0, 90.0, 120.0])  # px from the feature
# Right, left, below, above first, then what lies between.
_DIRECTIONS = np.array(
    [
        [1, 0], [-1, 0], [0, 1], [0, -1], [0.8, 0.8], [0.8, -0.8], [-0.8, 0.8], [-0.8, -0.8],
        [1, 0.4], [1, -0.4], [-1, 0.4], [-1, -0.4], [0.4, 1], [-0.4, 1], [0.4, -1], [-0.4, -1],
    ],
    float,
)  # fmt: skip
_SPOTS = np.array([(x, y) for y in np.linspace(0, 1, 13) for x in np.linspace(0, 1, 17)])
_OUTSIDE_COST = 1e3  # per pixel beyond the picture
_OFF_SKIN_COST = 0.3  # per square pixel that has no skin to be seen on
_FREE = 1.0  # a cost up to this is nobody's harm


class Layout:
    """Occupied boxes in a frame that is turned so that text is upright for the operator.

    Parameters
    ----------
    width, height : int
        Size of the projector image, pixels.
    """

    def __init__(self, width: int, height: int, skin: SkinMap) -> None:
        cos, sin = np.cos(skin.angle), np.sin(skin.angle)
        self._turn = np.array([[cos, -sin], [sin, cos]])  # upright frame to projector
        self._size = np.array([width, height], float)
        self._skin = skin
        self._centres = np.empty((0, 2))
        self._halves = np.empty((0, 2))

    def to_projector(self, offset: Array) -> Array:
        """An offset of the upright frame in projector pixels."""
        return np.asarray(self._turn @ offset)

    def to_upright(self, offset: Array) -> Array:
        """An offset in projector pixels in the upright frame."""
        return np.asarray(offset @ self._turn)

    def extent(self, points: Array) -> Array:
        """Half size of the bounding box of points (n, 2), upright frame."""
        return np.asarray(np.ptp(points @ self._turn, axis=0) / 2)

    def occupy(self, points: Array, margin: float = 0.0) -> None:
        """Keep text off the bounding box of points (n, 2), projector pixels."""
        upright = points @ self._turn
        low, high = upright.min(0) - margin, upright.max(0) + margin
        self._add((low + high) / 2, (high - low) / 2)

    def place(self, anchor: Array, reach: Array, size: tuple[float, float], must: bool = True) -> Array | None:
        """Find a place for a line of text near a feature, and occupy it.

        Parameters
        ----------
        anchor : (2,) array
            The feature's centre, projector pixels.
        reach : (2,) array
            Half size of the feature in the upright frame, pixels.
        size : (width, height)
            Of the text, pixels.
        must : bool
            Whether the text must be shown.

        Returns
        -------
        (2,) ndarray or None
            The text's centre, projector pixels: the nearest free place; where none is free the one with the least
            overlap, or None where the text need not be shown.
        """
        half = np.array(size) / 2
        steps = reach + half + _DISTANCES[:, None]
        centres = anchor + (steps[:, None] * _DIRECTIONS).reshape(-1, 2) @ self._turn.T
        costs = self._costs(centres, half)
        free = np.flatnonzero(costs < _FREE)
        if len(free) == 0 and not must:
            return None
        best = centres[free[0] if len(free) else costs.argmin()]
        self._add(best @ self._turn, half)
        return np.asarray(best)

    def has_room(self, sizes: Sequence[tuple[float, float]], margin: float) -> bool:
        """Whether a block of one of the sizes fits somewhere without covering anything."""
        return self._best_block(sizes, margin)[2] < _FREE

    def place_block(self, sizes: Sequence[tuple[float, float]], margin: float) -> tuple[int, Array]:
        """A place for a block of text that may have one of several sizes, anywhere in the picture, rims first.

        Returns
        -------
        which : int
            The size that was taken: the first one that is free somewhere, or else the least harmful.
        centre : (2,) ndarray
            Projector pixels.
        """
        which, centre, _ = self._best_block(sizes, margin)
        self._add(centre @ self._turn, np.array(sizes[which]) / 2)
        return which, centre

    def _best_block(self, sizes: Sequence[tuple[float, float]], margin: float) -> tuple[int, Array, float]:
        """Which size, where (projector pixels), and at what cost."""
        best, best_cost = (0, self._size / 2), float("inf")
        for which, size in enumerate(sizes):
            half = np.array(size) / 2
            low, high = half + margin, self._size - half - margin
            centres = low + (high - low) * _SPOTS
            # Rims, the lower ones first: the middle is where people look.
            rank = 0.05 * (1 - np.abs(2 * _SPOTS - 1).max(1)) + 0.01 * (1 - _SPOTS[:, 1])
            costs = self._costs(centres, half) + rank
            k = int(costs.argmin())
            if costs[k] < best_cost:
                best, best_cost = (which, centres[k]), float(costs[k])
            if best_cost < _FREE:
                break
        return *best, best_cost

    def _add(self, centre: Array, half: Array) -> None:
        self._centres = np.vstack([self._centres, centre])
        self._halves = np.vstack([self._halves, half])

    def _costs(self, centres: Array, half: Array) -> Array:
        """(n,) overlap with what is there in pixels², and the price of what leaves the picture or the skin."""
        corners = centres[:, None] + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ self._turn.T
        beyond = (np.maximum(0, -corners) + np.maximum(0, corners - self._size)).sum((1, 2))
        bare = 1 - self._skin.share(corners.min(1), corners.max(1))
        apart = np.abs((centres @ self._turn)[:, None] - self._centres)
        overlap = np.maximum(0, half + self._halves - apart).prod(2).sum(1)
        return np.asarray(_OUTSIDE_COST * beyond + _OFF_SKIN_COST * bare * 4 * half.prod() + overlap)

"""Where labels go: beside their feature, inside the picture, and neither on each other nor on a feature."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Layout:
    """Occupied boxes in a frame that is turned so that text is upright for the operator.

    Parameters
    ----------
    width, height : int
        Size of the projector image, pixels.
    angle : float
        Direction of the text's base line in the projector image, radians.
    """

    def __init__(self, width: int, height: int, angle: float) -> None:
        self.angle = angle
        cos, sin = np.cos(angle), np.sin(angle)
        self._turn = np.array([[cos, -sin], [sin, cos]])  # upright frame to projector
        self._size = np.array([width, height], float)
        self._boxes: list[Array] = []  # (centre, half size) in the upright frame

    def occupy(self, points: Array, margin: float = 0.0) -> None:
        """Keep labels off the bounding box of points (n, 2), projector pixels."""
        upright = points @ self._turn
        low, high = upright.min(0) - margin, upright.max(0) + margin
        self._boxes.append(np.stack([(low + high) / 2, (high - low) / 2]))

    def place(self, anchor: Array, reach: Array, size: tuple[float, float]) -> Array:
        """Find a place for a label near a feature, and occupy it.

        Parameters
        ----------
        anchor : (2,) array
            The feature's centre, projector pixels.
        reach : (2,) array
            Half size of the feature in the upright frame, pixels.
        size : (width, height)
            Of the label, pixels.

        Returns
        -------
        (2,) ndarray
            The label's centre, projector pixels; the place with the least overlap where none is free.
        """
        half = np.array(size) / 2
        best, best_cost = anchor, np.inf
        for distance in (4.0, 12.0, 24.0, 40.0, 64.0, 96.0):
            for direction in _DIRECTIONS:
                offset = np.sign(direction) * np.abs(direction) * (reach + half + distance)
                centre = anchor + self._turn @ offset
                cost = self._cost(centre, half) + 1e-3 * distance
                if cost < best_cost:
                    best, best_cost = centre, cost
            if best_cost < 1:
                break
        self._boxes.append(np.stack([best @ self._turn, half]))
        return best

    def place_in_corner(self, size: tuple[float, float], margin: float) -> Array:
        """Centre for a block of that size where it hides least, corners first."""
        half = np.array(size) / 2
        low, high = half + margin, self._size - half - margin
        best, best_cost = self._size / 2, np.inf
        for k, (x, y) in enumerate((x, y) for y in (1.0, 0.0, 0.5) for x in (0.0, 1.0, 0.5, 0.25, 0.75)):
            centre = low + (high - low) * np.array([x, y])
            cost = self._cost(centre, half) + 1e-3 * k
            if cost < best_cost:
                best, best_cost = centre, cost
        self._boxes.append(np.stack([best @ self._turn, half]))
        return best

    def _cost(self, centre: Array, half: Array) -> float:
        """Overlap with what is there, in pixels², with a heavy price for what leaves the picture."""
        upright = centre @ self._turn
        corners = centre + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ self._turn.T
        outside = np.maximum(0, -corners).sum() + np.maximum(0, corners - self._size).sum()
        cost = 1e3 * outside
        for box_centre, box_half in self._boxes:
            overlap = np.maximum(0, half + box_half - np.abs(upright - box_centre))
            cost += overlap[0] * overlap[1]
        return float(cost)


# Right, left, below, above, then the diagonals.
_DIRECTIONS = np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [0.8, 0.8], [0.8, -0.8], [-0.8, 0.8], [-0.8, -0.8]], float)

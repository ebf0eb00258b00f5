"""What a seam's stations share, and what is known of it before any picture is seen.

All of it is wide: it decides only what the pictures leave open, and goes into the uncertainty as such.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.seams.gap_floor import Floor
from metrology.seams.gap_view import (
    CHAMFER_A,
    CHAMFER_B,
    DARK_FLOOR,
    DARK_WALL,
    LEVELS,
    LIT_FLOOR,
    LIT_WALL,
    SKIN_A,
    SKIN_B,
    SLOPE_A,
    SLOPE_B,
)

Array = NDArray[np.float64]

# What is shared, in this order: the chamfers' widths, the floor's depth (mm), the walls' lean in the middle of the seam
# and its change from there to the end (tangents), spill, each camera's lens (px), each camera's usual levels.
WIDTH_A, WIDTH_B, DEPTH, LEAN, LEAN_CHANGE, SPILL, LENSES = range(7)

# Means and standard deviations. Broken edges are tenths of a millimetre wide, substructure lies a few millimetres down,
# edges are cut square to the skin within two degrees, lenses blur by half a pixel, and a little light goes to a pixel's
# neighbours.
_BROKEN_EDGE_MM = (0.3, 0.5)
_GAP_DEPTH_MM = (2.0, 3.0)
_SQUARE = (0.0, 0.03)
_SPILL = (0.08, 0.1)
_LENS_PX = (0.45, 0.25)
# The floor's depth as the points show it varies and errs by this.
_FLOOR_SIGMA_MM = 0.2
# Both edges of a joint are broken by one tool, and both cameras have like lenses, to this standard deviation.
_ALIKE_EDGES_MM = 0.05
_ALIKE_LENSES_PX = 0.1
# Bounds, up to the lenses; and of the lenses.
_LOWEST = (0.0, 0.0, 0.0, -0.5, -0.5, 0.0)
_HIGHEST = (2.0, 2.0, 12.0, 0.5, 0.5, 0.24)
_LENS_BOUNDS_PX = (0.05, 2.0)
# What only open gaps have: sealant fills the chamfers too, and hides the walls.
_OF_OPEN_GAPS = (WIDTH_A, WIDTH_B, DEPTH, LEAN, LEAN_CHANGE)


class Knowledge:
    """Normal prior of what is shared.

    Parameters
    ----------
    ambient : (k,) ndarray
        Share of the skin's brightness in each camera that does not follow the fringes.
    floor : Floor
    fixed : tuple of int
        What is held fixed besides.
    """

    def __init__(self, ambient: Array, floor: Floor, fixed: tuple[int, ...] = ()) -> None:
        self.ambient, self.floor = ambient, floor
        spread = [_BROKEN_EDGE_MM, _BROKEN_EDGE_MM, _depth(floor), _SQUARE, _SQUARE, _SPILL]
        spread += [_LENS_PX] * len(ambient)
        spread += [level for share in ambient for level in _levels(float(share))]
        self.mean, sigma = np.array(spread, float).T
        self.precision = np.diag(sigma**-2.0)
        self._alike(WIDTH_A, WIDTH_B, _ALIKE_EDGES_MM)
        for camera in range(1, len(ambient)):
            self._alike(LENSES, LENSES + camera, _ALIKE_LENSES_PX)
        held = (*fixed, *(_OF_OPEN_GAPS if floor.sealed else ()))
        self.free = np.setdiff1d(np.arange(len(sigma)), held)

    def _alike(self, i: int, j: int, sigma: float) -> None:
        difference = np.zeros(len(self.mean))
        difference[[i, j]] = 1.0, -1.0
        self.precision += np.outer(difference, difference) / sigma**2

    def without_chamfers(self) -> Knowledge:
        """The same with both chamfers' widths held fixed."""
        return Knowledge(self.ambient, self.floor, (WIDTH_A, WIDTH_B))

    def cost(self, shared: Array) -> float:
        """Squared standard deviations from the mean."""
        away = shared - self.mean
        return float(away @ self.precision @ away)

    def gradient(self, shared: Array) -> Array:
        """Half the cost's slope downhill."""
        return np.asarray(self.precision @ (self.mean - shared))

    def within_bounds(self, shared: Array) -> Array:
        """What is shared, no value beyond what can be."""
        lenses = slice(LENSES, LENSES + len(self.ambient))
        bounded = shared.copy()
        bounded[:LENSES] = np.clip(shared[:LENSES], _LOWEST, _HIGHEST)
        bounded[lenses] = np.clip(shared[lenses], *_LENS_BOUNDS_PX)
        return bounded


def _depth(floor: Floor) -> tuple[float, float]:
    if floor.sealed:
        return max(floor.depth_mm or 0.0, 0.0), _FLOOR_SIGMA_MM
    return _GAP_DEPTH_MM if floor.depth_mm is None else (floor.depth_mm, _FLOOR_SIGMA_MM)


def _levels(ambient: float) -> list[tuple[float, float]]:
    """Of a seam's usual levels, relative to the skin's.

    Matt surfaces turned from the light, and shadows with a part of the sky: a wall sees half of it at most, the floor
    of a deep gap less.
    """
    known = {
        SKIN_A: (1.0, 0.1), SKIN_B: (1.0, 0.1), SLOPE_A: (0.0, 0.01), SLOPE_B: (0.0, 0.01),
        CHAMFER_A: (0.6, 0.3), CHAMFER_B: (0.6, 0.3), LIT_WALL: (0.3, 0.3), LIT_FLOOR: (0.4, 0.4),
        DARK_WALL: (0.5 * ambient, 0.5 * ambient), DARK_FLOOR: (0.25 * ambient, 0.25 * ambient),
    }  # fmt: skip
    return [known[level] for level in range(LEVELS)]


def _level_scatter() -> Array:
    scatter = np.full(LEVELS, 0.05)
    scatter[[SLOPE_A, SLOPE_B]] = 0.02
    return scatter


# (LEVELS,) how much a station's levels scatter about the seam's usual ones: grain, smudges, highlights.
LEVEL_SCATTER = _level_scatter()
